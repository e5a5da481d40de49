//! The cascade on a whole cloud: plan, patches, units, merge, resample.
