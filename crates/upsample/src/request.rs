//! The work itself: a request, and what is made of it.

use densecloud_cascade::{
    CascadeError, CascadeOptions, LevelRunner, Observer, Quality, Stage, Target, upsample,
};
use densecloud_cloud::{Attribute, Cloud, Position};

use crate::attributes::{self, Finish, Plan};

/// What a caller wants done, with every default filled in: see [`Prepared`](crate::Prepared).
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
    /// What becomes of the cloud's attributes: [`Plan::of`] them and of the rules of `finish`.
    pub plan: Plan,
}

/// As [`Request::effort`], of these settings.
pub(crate) fn effort(settings: &CascadeOptions) -> f64 {
    let (usual, CascadeOptions { overlap, inner, quality, .. }) = (CascadeOptions::default(), *settings);
    let (run, merged) = (overlap / usual.overlap, overlap * inner / (usual.overlap * usual.inner));
    let levels = if quality == Quality::Best { 2.0 } else { 1.0 };
    levels * run.max(merged).max(1.0)
}

impl Request {
    /// A request whose plan is that of its cloud and its rules.
    #[must_use]
    pub fn new(cloud: Cloud, target: Target, settings: CascadeOptions, finish: Finish) -> Self {
        let plan = Plan::of(&cloud.attributes, &finish.rules);
        Self { cloud, target, settings, finish, plan }
    }

    /// Work and memory for each point, in multiples of what the default settings take; at least 1. The network's
    /// work grows with the overlap, and the points to merge with the overlap times the inner share; the larger growth counts.
    #[must_use]
    pub fn effort(&self) -> f64 {
        effort(&self.settings)
    }

    /// Runs the cascade and finishes what it made, on the current rayon pool. `observer` hears of the cascade's stages,
    /// and of [`Stage::Attributes`] where there is anything to finish.
    ///
    /// Cost: that of [`upsample`] and of [`attributes::finish`].
    ///
    /// # Errors
    /// [`CascadeError`]: the cloud or the target is impossible, the runner failed, or the observer stopped it.
    pub fn run(&self, runner: &dyn LevelRunner, observer: &dyn Observer) -> Result<Made, CascadeError> {
        let Self { cloud, target, settings, finish, plan } = self;
        let dense = upsample(&cloud.positions, *target, settings, runner, observer)?;
        let made = Made {
            positions: dense.positions,
            attributes: Vec::new(),
            dropped_non_finite: dense.dropped_non_finite,
            duplicates: dense.duplicates,
            apart: dense.apart,
            unsure: 0,
        };
        if !finish.is_needed(cloud) {
            return Ok(made);
        }
        observer.begin(dense.levels.saturating_sub(1), Stage::Attributes);
        let asked_for = made.positions.len();
        let finished = attributes::finish(cloud, made.positions, finish, plan, &|| observer.cancelled());
        let (positions, attributes) = finished.ok_or(CascadeError::Cancelled)?;
        if positions.is_empty() {
            return Err(CascadeError::NoneSure(finish.min_confidence));
        }
        let unsure = asked_for.saturating_sub(positions.len());
        Ok(Made { positions, attributes, unsure, ..made })
    }
}

/// What became of a request.
#[derive(Debug, Clone, PartialEq)]
pub struct Made {
    /// The dense cloud in the input's coordinates: exactly as many positions as were asked for, without those that are
    /// unsure.
    pub positions: Vec<Position>,
    /// The attributes of each point.
    pub attributes: Vec<Attribute>,
    /// Points left out because a coordinate was NaN or infinite.
    pub dropped_non_finite: usize,
    /// Points that coincided with an earlier one.
    pub duplicates: usize,
    /// Points that lie apart from all others, kept as they are.
    pub apart: usize,
    /// Points left out because their confidence is below the least that was asked for.
    pub unsure: usize,
}

impl Made {
    /// What a person should know about how the input was treated, a sentence each.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let sentences = [
            (self.dropped_non_finite, "points left out: NaN or infinite"),
            (self.duplicates, "points coincide with another; they count towards the size alone"),
            (
                self.apart,
                "points lie apart from all others (outliers?); they are kept as they are, and nothing is made of them",
            ),
            (self.unsure, "points of the result left out: their confidence is below the least asked for"),
        ];
        let some = sentences.into_iter().filter(|(count, _)| *count > 0);
        some.map(|(count, sentence)| format!("{count} {sentence}")).collect()
    }
}
