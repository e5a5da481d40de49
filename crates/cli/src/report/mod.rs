//! A report on a cloud and what was made of it: one page with pictures, or its numbers as JSON.

mod histogram;
mod page;
mod rings;
mod views;

use densecloud::survey::{Source, Survey};
use densecloud_cloud::{Cloud, FrameError, Position};
use densecloud_formats::Format;
use serde_json::{Value, json};

use crate::commands::Inspection;
use crate::evaluate::picture::{Axis, PictureError};
use histogram::Histogram;
use rings::Rings;
use views::Sight;

/// A point of the result further than this from the input is far, in the input's spacings there.
const FAR: f64 = 3.0;
/// Far points are worth a warning above this share of the result; so are points of the input that the result has lost.
const MANY: f64 = 0.001;
/// A point of the input that the result is further from than this has been lost, in the input's spacings there.
const LOST: f64 = 1.0;
/// A ring that has become so much less dense than the whole is worth a warning.
const BEHIND: f64 = 0.5;
/// What a result's confidence is called, and where the input has an attribute of that name.
const CONFIDENCE: &str = "confidence";
const CONFIDENCE_BESIDE: &str = "confidence_";

/// A cloud, the format that it came in, and its name.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Side<'a> {
    /// The cloud.
    pub(crate) cloud: &'a Cloud,
    /// Its file's format.
    pub(crate) format: Format,
    /// What a person calls it.
    pub(crate) name: &'a str,
}

/// What a work told that has just been done.
#[derive(Debug, Clone, serde::Serialize)]
pub(crate) struct Making {
    /// What a person should know, a sentence each.
    #[serde(skip)]
    pub(crate) warnings: Vec<String>,
    /// From the start of the program to the written result.
    pub(crate) seconds: f64,
    /// Stages of the work and the seconds of each.
    pub(crate) stages: Vec<(String, f64)>,
}

/// How a result is drawn, and what it is measured from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    /// Where the sensor stood, where the input's file does not tell it or tells it wrong.
    pub(crate) sensor: Option<Position>,
    /// The axis that points up in the pictures.
    pub(crate) up: Axis,
    /// Points of each cloud that are measured.
    pub(crate) sample: usize,
}

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ReportError {
    /// A cloud has nothing to measure.
    #[error("{0}: {1}")]
    Frame(String, FrameError),
    /// A cloud has nothing to show.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// All that a report tells.
#[derive(Debug)]
pub(crate) struct Report<'a> {
    names: [&'a str; 2],
    input: Value,
    output: Value,
    /// Distances to the nearest neighbour.
    spacing: Option<Histogram>,
    /// How far the result's points are from the nearest of the input, in the input's spacings there.
    displacement: Histogram,
    far: f64,
    /// How far the input's points are from the nearest of the result, in the input's spacings there.
    coverage: Histogram,
    lost: f64,
    confidence: Option<Histogram>,
    rings: Rings,
    warnings: Vec<String>,
    making: Option<Making>,
    sights: Vec<Sight>,
}

impl<'a> Report<'a> {
    /// Measures and draws both. O(n log n), and seconds for each million points.
    ///
    /// # Errors
    /// One of them has no two different finite points.
    pub(crate) fn of(
        input: Side<'a>,
        output: Side<'a>,
        wanted: &Wanted,
        making: Option<Making>,
    ) -> Result<Self, ReportError> {
        let measured = |side: Side<'a>| {
            let unmeasured = |why| ReportError::Frame(side.name.to_owned(), why);
            let inspection = Inspection::of(side.cloud, side.format, wanted.sample).map_err(unmeasured)?;
            Ok::<_, ReportError>((inspection, Source::new(&side.cloud.positions).map_err(unmeasured)?))
        };
        let ((before, source), (after, result)) = (measured(input)?, measured(output)?);
        let displaced = source.distances(&output.cloud.positions);
        let missed = source.distances_to(&result, &input.cloud.positions);
        let spacings = |i: &Inspection<'_>| i.places().iter().map(|p| p.spacing).collect::<Vec<f64>>();
        let sensor = wanted.sensor.or(input.cloud.origin.sensor);
        let bounds = before.survey().bounds;
        let mut report = Self {
            names: [input.name, output.name],
            input: before.json(),
            output: after.json(),
            spacing: Histogram::logarithmic(&spacings(&before), &spacings(&after)),
            far: share(&displaced, FAR),
            displacement: Histogram::even(0.0, FAR, None, Some(&displaced)),
            lost: share(&missed, LOST),
            coverage: Histogram::even(0.0, LOST, Some(&missed), None),
            confidence: confidence(input.cloud, output.cloud),
            rings: Rings::of(sensor, bounds, before.places(), after.places()),
            warnings: before.warnings(),
            making,
            sights: views::sights(input.cloud, output.cloud, usual(&before), wanted.up)?,
        };
        report.warnings.extend(report.remarks(before.survey(), after.survey()));
        let told = report.making.iter_mut().flat_map(|making| std::mem::take(&mut making.warnings));
        let new: Vec<String> = told.filter(|warning| !report.warnings.contains(warning)).collect();
        report.warnings.extend(new);
        Ok(report)
    }

    /// What a person should know of the result, a sentence each, with what to do about it.
    fn remarks(&self, before: &Survey, after: &Survey) -> Vec<String> {
        let mut remarks = Vec::new();
        if self.far > MANY {
            remarks.push(format!(
                "{:.2} % of the result is further than {FAR} spacings from the input: look there; --min-confidence 0.5 \
                 leaves out most of such points, --max-distance keeps them nearer",
                100.0 * self.far
            ));
        }
        if self.lost > MANY {
            remarks.push(format!(
                "{:.2} % of the input's points have none of the result within a spacing: parts of it are missing; \
                 --keep-input keeps each",
                100.0 * self.lost
            ));
        }
        let whole = after.density.median / before.density.median;
        for ring in self.rings.rings.iter().filter(|r| r.ratio().is_some_and(|ratio| ratio < BEHIND * whole))
        {
            remarks.push(format!(
                "from {:.3} to {:.3} {}, the result is {:.1} times denser, where the whole is {whole:.1} times: the \
                 input does not show enough of the surface there to fill it; scan it from nearer, or take --quality best",
                ring.near,
                ring.far,
                self.place(),
                ring.ratio().unwrap_or_default()
            ));
        }
        remarks
    }

    /// What distances are measured from.
    fn place(&self) -> &'static str {
        if self.rings.is_sensor { "from the sensor" } else { "from the middle of the input" }
    }

    /// All numbers as one object: lengths in the cloud's units, shares from 0 to 1.
    #[must_use]
    pub(crate) fn json(&self) -> Value {
        json!({
            "version": env!("CARGO_PKG_VERSION"),
            "input": { "name": self.names[0], "inspection": self.input },
            "output": { "name": self.names[1], "inspection": self.output },
            "spacing": self.spacing,
            "displacement": self.displacement,
            "far": self.far,
            "coverage": self.coverage,
            "lost": self.lost,
            "confidence": self.confidence,
            "density_by_distance": self.rings,
            "warnings": self.warnings,
            "timing": self.making,
        })
    }

    /// The page: HTML that needs no other file and no network.
    #[must_use]
    pub(crate) fn html(&self) -> String {
        page::page(self)
    }
}

/// The share of values above a limit.
fn share(values: &[f64], limit: f64) -> f64 {
    values.iter().filter(|v| **v > limit).count() as f64 / values.len().max(1) as f64
}

/// Where the cloud is as dense as it usually is.
fn usual(inspection: &Inspection<'_>) -> Option<Position> {
    let mut places = inspection.places().to_vec();
    places.sort_unstable_by(|a, b| a.density.total_cmp(&b.density));
    places.get(places.len() / 2).map(|place| place.at)
}

/// How sure the result is of its points, where it tells. What the input called by that name has kept it.
fn confidence(before: &Cloud, after: &Cloud) -> Option<Histogram> {
    let find = |cloud: &Cloud, name: &str| cloud.attributes.iter().position(|a| a.name == name);
    let own = || find(after, CONFIDENCE).filter(|_| find(before, CONFIDENCE).is_none());
    let column = &after.attributes[find(after, CONFIDENCE_BESIDE).or_else(own)?].values;
    let values: Vec<f64> = (0..column.len()).map(|i| column.get(i)).collect();
    Some(Histogram::even(0.0, 1.0, None, Some(&values)))
}
