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
