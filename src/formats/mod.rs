//! File formats: one file a format, header first, then points.
