//! Who watches a cascade, and may stop it.

/// Hears how far a cascade is. Called from worker threads, in the order of the work.
pub trait Observer: Sync {
    /// The work is known: the number of points after each level, the target last.
    fn plan(&self, _sizes: &[usize]) {}

    /// A stage of a level (from 0) begins; the one before it has ended.
    fn begin(&self, _level: usize, _stage: Stage) {}

    /// `done` of `total` steps of the current stage are done.
    fn advance(&self, _done: usize, _total: usize) {}

    /// Asked before every batch and every stage; once true, the cascade ends with
    /// [`super::CascadeError::Cancelled`].
    fn cancelled(&self) -> bool {
        false
    }
}

/// Watches nothing and never stops.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Observer for Silent {}

/// The stages of one level, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Stage {
    /// Choosing patch centres by farthest point sampling.
    Seeds,
    /// Finding each patch's points, and each point's neighbours in the previous level.
    Patches,
    /// Running the network.
    Units,
    /// Farthest point sampling of the merged output to the level's size.
    Resample,
    /// After the last level, and not by the cascade: finding the new points' attributes.
    Attributes,
}

impl Stage {
    /// All stages, in their order.
    pub const ALL: [Self; 5] = [Self::Seeds, Self::Patches, Self::Units, Self::Resample, Self::Attributes];

    /// The name in logs and metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Seeds => "seeds",
            Self::Patches => "patches",
            Self::Units => "units",
            Self::Resample => "resample",
            Self::Attributes => "attributes",
        }
    }
}
