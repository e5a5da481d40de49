//! The scores of many shapes and methods.

use serde::Serialize;

use super::metrics::{Corrected, Published, Scores};

/// Everything that an evaluation gives; JSON holds it whole, with raw values (not times 1000).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Report {
    /// How it came about.
    pub(crate) settings: Settings,
    /// Shape by shape, and within a shape method by method.
    pub(crate) rows: Vec<Row>,
    /// For each method, the plain mean over the shapes.
    pub(crate) means: Vec<Mean>,
}

/// What a report was made from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Settings {
    /// The program's version.
    pub(crate) version: String,
    /// Where the predictions came from; none when the cascade made them.
    pub(crate) predictions: Option<String>,
    /// Where the inputs came from.
    pub(crate) inputs: Option<String>,
    /// Where the references came from.
    pub(crate) references: String,
    /// Where the meshes came from.
    pub(crate) meshes: Option<String>,
    /// How the cascade was run; none when predictions were read.
    pub(crate) cascade: Option<CascadeSettings>,
    /// The seed of the cascade and the floor.
    pub(crate) seed: u64,
    /// The F-score's tolerance, in radii of the reference.
    pub(crate) tolerance: f64,
}

/// How the cascade made the predictions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct CascadeSettings {
    /// The model's name.
    pub(crate) model: String,
    /// Its weights.
    pub(crate) model_sha256: String,
    /// Points out for each point in.
    pub(crate) ratio: f64,
    /// Patches that a point lies in, on average.
    pub(crate) overlap: f64,
    /// Share of each patch that was merged.
    pub(crate) inner: f64,
    /// How far points may be moved, in spacings.
    pub(crate) max_displacement: f64,
    /// How far from the input points may lie, against what nine in ten keep to.
    pub(crate) max_distance: f64,
    /// Whether the last level was made even and smooth.
    pub(crate) polish: bool,
    /// Where the points went: by neighbourhood, or by area.
    pub(crate) spread: String,
    /// Whether a level more was run.
    pub(crate) quality: String,
}

/// What was scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Method {
    /// The clouds in question.
    Prediction,
    /// [`floor`](super::controls::floor)
    Floor,
    /// [`repeat`](super::controls::repeat)
    Repeat,
    /// [`midpoints`](super::controls::midpoints)
    Midpoints,
}

/// One cloud's scores.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Row {
    /// The shape's name.
    pub(crate) shape: String,
    /// What made the cloud.
    pub(crate) method: Method,
    /// Points of the sparse input, where it is known.
    pub(crate) points_in: Option<usize>,
    /// Points of the scored cloud.
    pub(crate) points: usize,
    /// Points of the reference.
    pub(crate) reference_points: usize,
    /// The scores.
    #[serde(flatten)]
    pub(crate) scores: Scores,
}

/// One method's mean scores.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Mean {
    /// What made the clouds.
    pub(crate) method: Method,
    /// How many shapes.
    pub(crate) shapes: usize,
    /// The mean of each score; none where a shape lacks it.
    #[serde(flatten)]
    pub(crate) scores: Scores,
}

impl Report {
    /// Adds the means to the rows.
    #[must_use]
    pub(crate) fn new(settings: Settings, rows: Vec<Row>) -> Self {
        let means = Method::ALL
            .into_iter()
            .filter_map(|method| {
                let scores: Vec<Scores> =
                    rows.iter().filter(|r| r.method == method).map(|r| r.scores).collect();
                (!scores.is_empty()).then(|| Mean { method, shapes: scores.len(), scores: mean(&scores) })
            })
            .collect();
        Self { settings, rows, means }
    }
}

impl Method {
    /// All, in the order of tables.
    pub(crate) const ALL: [Self; 4] = [Self::Prediction, Self::Floor, Self::Repeat, Self::Midpoints];

    /// The name in tables.
    #[must_use]
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Prediction => "prediction",
            Self::Floor => "floor",
            Self::Repeat => "repeat",
            Self::Midpoints => "midpoints",
        }
    }
}

fn mean(scores: &[Scores]) -> Scores {
    let of = |value: &dyn Fn(&Scores) -> f64| scores.iter().map(value).sum::<f64>() / scores.len() as f64;
    let of_known = |value: &dyn Fn(&Scores) -> Option<f64>| {
        scores.iter().map(value).sum::<Option<f64>>().map(|sum| sum / scores.len() as f64)
    };
    Scores {
        published: Published {
            chamfer: of(&|s| s.published.chamfer),
            hausdorff: of(&|s| s.published.hausdorff),
            point_to_face: of_known(&|s| s.published.point_to_face),
        },
        corrected: Corrected {
            chamfer: of(&|s| s.corrected.chamfer),
            hausdorff: of(&|s| s.corrected.hausdorff),
            hausdorff_95: of(&|s| s.corrected.hausdorff_95),
            to_surface: of_known(&|s| s.corrected.to_surface),
            from_surface: of(&|s| s.corrected.from_surface),
            f_score: of(&|s| s.corrected.f_score),
            spacing_variation: of(&|s| s.corrected.spacing_variation),
        },
    }
}
