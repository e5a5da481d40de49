//! From what is known of a cloud without its points to all that is decided before the work.

use densecloud_backends::ModelName;
use densecloud_cascade::Target;
use densecloud_cloud::{Attribute, Facts, Origin};
use densecloud_formats::{Adaptation, Format};

use crate::attributes::Plan;
use crate::options::Options;
use crate::prepared::Report;
use crate::provenance::{self, Causes};
use crate::survey::Survey;

/// What is to be known of a whole cloud before the work: little enough for a cloud that no memory holds.
pub struct Outline<'a> {
    /// The attributes as they were read; of their values the types alone matter.
    pub attributes: &'a [Attribute],
    /// What the values of each are like, by its place.
    pub facts: &'a dyn Fn(usize) -> Facts,
    /// What the file tells of the whole.
    pub origin: &'a Origin,
    /// What a person should know about how the cloud was read, a sentence each.
    pub told: Vec<String>,
    /// How many points there are, those that are not finite included.
    pub points: u64,
    /// Whether all are finite.
    pub is_finite: bool,
    /// How many points are wanted.
    pub target: Target,
    /// What the cloud is like; none where it is too bad to tell.
    pub survey: Option<Survey>,
    /// The most points of a tile, where the cloud is worked on in tiles.
    pub tile_points: Option<u64>,
}

/// What is decided for a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Outlined {
    /// What is told of the result.
    pub report: Report,
    /// The types that attributes get before anything is made of them.
    pub adaptation: Adaptation,
    /// What becomes of them.
    pub plan: Plan,
}

impl Outline<'_> {
    /// Decides. `input` is the format that the cloud came in, `model` the one that will be used. O(1) an attribute.
    #[must_use]
    pub fn outlined(&self, input: Format, options: &Options, model: &ModelName) -> Outlined {
        let Options { goal: _, cascade: settings, finish, reading, tile_points: _, format: wanted } = options;
        let mut warnings = self.told.clone();
        let mut format = Format::of_result(*wanted, input, !self.attributes.is_empty());
        let mut points_out = 0;
        if let Some(survey) = &self.survey {
            warnings.extend(survey.warnings(input.scalar()));
            // Where it is impossible, the cascade says so.
            points_out = self.target.points_out(survey.finite as u64).unwrap_or_default();
            format = format.fine_enough(survey.bounds, survey.result_spacing(points_out));
        }
        let adaptation = input.adaptation(self.attributes, self.facts, format);
        warnings.extend(adaptation.told.clone());
        let (mut origin, lost) = finish.origin(self.origin, self.is_finite);
        warnings.extend(lost);
        let adapted = adapted(self.attributes, &adaptation);
        let plan = Plan::by_facts(&adapted, &finish.rules, self.facts);
        warnings.extend_from_slice(plan.warnings());
        warnings.extend(finish.warnings(&adapted, &plan));
        let causes = Causes {
            input: self.origin.sha256,
            points: self.points,
            target: self.target,
            settings,
            finish,
            reading,
            tile_points: self.tile_points,
        };
        let provenance = provenance::line(model, &causes);
        origin.comments.push(provenance.clone());
        let report = Report { format, origin, provenance, points_in: self.points, points_out, warnings };
        Outlined { report, adaptation, plan }
    }
}

/// The names of attributes, and the types that they get, without values.
fn adapted(attributes: &[Attribute], adaptation: &Adaptation) -> Vec<Attribute> {
    let bare = |a: &Attribute| a.without_values();
    let mut bare: Vec<Attribute> = attributes.iter().map(bare).collect();
    adaptation.apply(&mut bare);
    bare
}
