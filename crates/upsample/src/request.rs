//! What a caller wants done.

use densecloud_cascade::{CascadeOptions, Target};
use densecloud_cloud::Cloud;

use crate::attributes::Finish;

/// What a caller wants done.
#[derive(Debug, Clone)]
pub struct Request {
    /// The cloud, in its own coordinates.
    pub cloud: Cloud,
    /// How many points are wanted.
    pub target: Target,
    /// How to run the cascade.
    pub settings: CascadeOptions,
    /// What is done with the cascade's points.
    pub finish: Finish,
}

impl Request {
    /// Work and memory for each point, in multiples of what the default settings take; at least 1. Patches are run in
    /// proportion to the overlap, and so many of their points are merged as the overlap times the inner share.
    #[must_use]
    pub fn effort(&self) -> f64 {
        let (usual, CascadeOptions { overlap, inner, .. }) = (CascadeOptions::default(), self.settings);
        let (run, merged) = (overlap / usual.overlap, overlap * inner / (usual.overlap * usual.inner));
        run.max(merged).max(1.0)
    }
}
