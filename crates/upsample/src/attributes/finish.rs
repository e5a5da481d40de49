//! What is wanted of a result beside its points.

use super::plan::Plan;
use super::rules::{Rule, Rules};
use super::sure;
use densecloud_cloud::{Attribute, Cloud, Origin, Position};

/// What is done with the cascade's points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Finish {
    /// How new points come by the source's attributes.
    pub rules: Rules,
    /// Whether the source's finite points come first in the result, exactly, with exactly their attributes.
    /// Each takes the place of the new point nearest to it, so the result has as many points as without.
    pub keep_input: bool,
    /// Whether each point tells the row of the source point that it is, or that is nearest (`source_index`,
    /// counted from 0), and whether it is new (`is_generated`, 0 or 1).
    pub source_fields: bool,
    /// Whether each point tells how likely it lies within one spacing of the surface
    /// ([`confidence`](densecloud_cascade::confidence), from 0 to 1).
    pub confidence: bool,
    /// Points whose confidence is below this are left out, but for the source's own that are kept: the result then has
    /// fewer points than were asked for. 0 keeps all.
    pub min_confidence: f64,
    /// Whether `nx`, `ny` and `nz` are estimated from the result's points, rather than carried over. On the
    /// side of the source's normals, if it has some; else towards the sensor; else on an arbitrary one.
    /// Points of the source that are kept keep theirs.
    pub estimate_normals: bool,
    /// Where the sensor stood; `None` is where the source says, for each scan where it has several.
    pub sensor: Option<Position>,
}

impl Finish {
    /// Bytes that a result's point takes beside its position, where its source has these attributes.
    #[must_use]
    pub fn bytes_a_point(&self, source: &[Attribute]) -> u64 {
        let kept = source.iter().filter(|a| self.rules.set_for(&a.name) != Some(Rule::Drop));
        let kept: u64 = kept.map(|a| a.values.kind().size() as u64).sum();
        let own = 5 * u64::from(self.source_fields) + 4 * u64::from(self.confidence);
        kept + own + 12 * u64::from(self.estimate_normals)
    }

    /// What a result takes over of what the source's file tells of the whole, and a sentence about what it
    /// does not. Tables that refer to points by their numbers (faces) stay true only where all points are
    /// kept, and first in the result: those of a source that `is_finite`.
    #[must_use]
    pub fn origin(&self, source: &Origin, is_finite: bool) -> (Origin, Option<String>) {
        let mut origin = source.clone();
        if self.keep_input && is_finite {
            return (origin, None);
        }
        let dropped = origin.drop_references();
        let lost = (!dropped.is_empty())
            .then(|| format!("not carried over: {} (about the input's points)", dropped.join(", ")));
        (origin, lost)
    }

    /// Whether there is anything to do.
    pub fn is_needed(&self, source: &Cloud) -> bool {
        let added = self.source_fields || self.estimate_normals || self.asks_confidence();
        !source.attributes.is_empty() || self.keep_input || added
    }

    /// Whether the points' confidence has to be known.
    pub(super) fn asks_confidence(&self) -> bool {
        self.confidence || self.min_confidence > 0.0
    }

    /// What a person should know about the attributes that are added to a source's, a sentence each.
    pub(crate) fn warnings(&self, source: &[Attribute], plan: &Plan) -> Option<String> {
        let names: Vec<&str> = plan.kept().map(|i| source[i].name.as_str()).collect();
        let name = sure::name(&names);
        (self.confidence && name != sure::NAME).then(|| {
            format!(
                "the input has an attribute {:?} of its own, so the result's is called {name:?}",
                sure::NAME
            )
        })
    }
}
