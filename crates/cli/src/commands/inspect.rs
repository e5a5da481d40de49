//! `densecloud inspect`: what a cloud is like, and what upsampling it would take. No model.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::{Value, json};

use super::options::ReadingArgs;
use super::upsample::PROVENANCE;
use super::{CliError, files};
use densecloud::attributes::{Plan, Rule, Rules};
use densecloud::provenance;
use densecloud::survey::{Place, SAMPLE, Spread, Survey, strays};
use densecloud_cascade::Target;
use densecloud_cloud::{Cloud, FrameError, Kind, Position};
use densecloud_formats::Format;

/// Tell what a cloud is like, and what upsampling it would take.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud inspect scan.laz
  densecloud inspect scan.ply --json | jq .spacing.median")]
pub(super) struct InspectArgs {
    /// The cloud, in any format that is read; `-` for standard input
    input: PathBuf,

    /// One JSON object instead of text; lengths in the cloud's units, shares from 0 to 1
    #[arg(long)]
    json: bool,

    /// Points to measure; all of them where the cloud has no more
    #[arg(long, value_name = "N", default_value_t = SAMPLE)]
    sample: usize,

    /// The cloud that this one was made of: tells how many points are far from it
    #[arg(long, value_name = "FILE")]
    source: Option<PathBuf>,

    /// Points out for each point in, for the cost
    #[arg(short, long, value_name = "R", default_value_t = 4.0)]
    ratio: f64,

    #[command(flatten)]
    reading: ReadingArgs,
}

pub(super) fn run(args: &InspectArgs) -> Result<(), CliError> {
    if args.sample == 0 {
        return Err(CliError::Usage("--sample 0 measures nothing; give 1 or more".into()));
    }
    Target::Ratio(args.ratio).points_out(1).map_err(|e| CliError::Usage(e.to_string()))?;
    let reading = args.reading.reading()?;
    let (cloud, header) = files::read_cloud(&args.input, &reading)?;
    let inspection = Inspection::of(&cloud, header.format, args.sample);
    let mut inspection = inspection.map_err(|e| CliError::file(&args.input, e))?.made_of_file(&args.input);
    inspection.ratio = args.ratio;
    if let Some(path) = &args.source {
        let (source, _) = files::read_cloud(path, &reading)?;
        inspection = inspection.against(&source.positions).map_err(|e| CliError::file(path, e))?;
    }
    let text = if args.json { format!("{:#}\n", inspection.json()) } else { inspection.text() };
    files::print(&text)
}

/// What a cloud is like, and what upsampling it would take.
#[derive(Debug)]
pub struct Inspection<'a> {
    cloud: &'a Cloud,
    format: Format,
    survey: Survey,
    /// Where it was measured.
    places: Vec<Place>,
    /// What would become of its attributes.
    plan: Plan,
    /// Share of points further than [`FAR`] from the source.
    strays: Option<f64>,
    /// Provenance, a line each time that the cloud was upsampled.
    made: Vec<String>,
    /// Points out for each point in, for the cost; 4 where nobody says.
    pub ratio: f64,
}

/// Seconds on one thread for a point out, all levels together (BENCHMARKS.md).
const SECONDS_A_POINT: f64 = 2.2e-5;

/// Bytes at the peak for a point out (BENCHMARKS.md), beside those that the program itself takes.
const BYTES_A_POINT: f64 = 430.0;
const BYTES: f64 = 5e7;

/// Spacings of the source from which a point counts as far from it.
const FAR: f64 = 3.0;

impl<'a> Inspection<'a> {
    /// Measures a cloud that came in a format, on a sample of so many points. O(n).
    ///
    /// # Errors
    /// No point is finite.
    pub fn of(cloud: &'a Cloud, format: Format, sample: usize) -> Result<Self, FrameError> {
        let (survey, places) = Survey::with_places(&cloud.positions, sample)?;
        let plan = Plan::of(&cloud.attributes, &Rules::default());
        let made = provenance::of(&cloud.origin).map(str::to_owned).collect();
        Ok(Self { cloud, format, survey, places, plan, strays: None, made, ratio: 4.0 })
    }

    /// Adds the provenance that lies beside a file whose format has no place for it.
    #[must_use]
    pub fn made_of_file(mut self, file: &Path) -> Self {
        if let Ok(beside) = std::fs::read_to_string(files::beside(file, PROVENANCE)) {
            let lines = beside.lines().filter_map(|line| line.strip_prefix(provenance::MARK));
            self.made.extend(lines.map(str::to_owned));
        }
        self
    }

    /// Measures how much of it lies far from the cloud that it was made of. O(n log m).
    ///
    /// # Errors
    /// The source has no finite point, or no extent.
    pub fn against(self, source: &[Position]) -> Result<Self, FrameError> {
        let share = strays(source, &self.cloud.positions, FAR)?;
        Ok(Self { strays: Some(share), ..self })
    }
}

impl Inspection<'_> {
    /// What was measured.
    pub(crate) fn survey(&self) -> &Survey {
        &self.survey
    }

    /// Where, and what the cloud is like there.
    pub(crate) fn places(&self) -> &[Place] {
        &self.places
    }

    /// Names, types, and the rules by which new points would come by them.
    fn attributes(&self) -> impl Iterator<Item = (&str, &'static str, Rule)> {
        let attributes = self.cloud.attributes.iter().zip(self.plan.rules());
        attributes.map(|(a, rule)| (a.name.as_str(), kind(a.values.kind()), *rule))
    }

    fn points_out(&self) -> u64 {
        Target::Ratio(self.ratio).points_out(self.survey.finite as u64).unwrap_or_default()
    }

    /// What a person should know before upsampling it, a sentence each.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let mut warnings = self.cloud.warnings();
        warnings.extend(self.survey.warnings(self.format.scalar()));
        warnings.extend_from_slice(self.plan.warnings());
        warnings
    }

    fn text(&self) -> String {
        let s = &self.survey;
        let mut lines: Vec<(&str, String)> = Vec::new();
        lines.push(("format", self.format.to_string()));
        let mut points = format!("{}", s.finite);
        if s.non_finite > 0 {
            points += &format!(" (and {} NaN or infinite)", s.non_finite);
        }
        if s.duplicates > 0 {
            points += &format!(" ({} of them duplicates)", s.duplicates);
        }
        lines.push(("points", points));
        for (a, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let [lo, hi] = [s.bounds[0][a], s.bounds[1][a]];
            lines.push((axis, format!("{lo} to {hi}  ({})", short(hi - lo))));
        }
        let range = |spread: Spread| {
            format!(
                "{}  (1 % below {}, 1 % above {})",
                short(spread.median),
                short(spread.low),
                short(spread.high)
            )
        };
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        if s.measured == 0 {
            lines.push(("spacing", "too few points to measure".into()));
        } else {
            lines.extend(self.measures(range, percent));
        }
        if let Some(share) = self.strays {
            lines.push((
                "strays",
                format!("{:.4} % further than {FAR} spacings from every point of the source", 100.0 * share),
            ));
        }
        let crs = self.cloud.origin.crs.as_ref().map_or("not told".to_owned(), |crs| crs.name());
        lines.push(("coordinates", crs));
        let attributes: Vec<String> =
            (self.attributes()).map(|(name, kind, rule)| format!("{name} ({kind}, {rule})")).collect();
        lines.push(("attributes", if attributes.is_empty() { "none".into() } else { attributes.join(", ") }));
        let cost = format!(
            "{} points, about {} s on one thread of BENCHMARKS.md's machine, {} MB",
            self.points_out(),
            short(self.seconds()),
            short(self.bytes() / 1e6)
        );
        let at = format!("at {}x", self.ratio);
        lines.push((&at, cost));
        lines.extend(self.made.iter().map(|made| ("made by", format!("densecloud {made}"))));
        lines.extend(self.warnings().into_iter().map(|warning| ("warning", warning)));
        lines.into_iter().map(|(name, value)| format!("{name:<12} {value}\n")).collect()
    }

    /// What was measured, a line each.
    fn measures(
        &self,
        range: impl Fn(Spread) -> String,
        percent: impl Fn(f64) -> String,
    ) -> Vec<(&'static str, String)> {
        let s = &self.survey;
        let mut lines = vec![("spacing", range(s.spacing))];
        lines.push(("density", format!("{} a square unit", range(s.density))));
        lines.push(("surface", format!("about {} square units", short(s.area))));
        let uneven = match s.unevenness {
            u if u < 0.25 => "even, as by Poisson-disk sampling",
            u if u < 0.42 => "between even and random",
            u if u < 0.6 => "as random as by chance",
            _ => "more uneven than by chance",
        };
        lines.push(("unevenness", format!("{:.2}  ({uneven})", s.unevenness)));
        let spacings = s.noise / s.spacing.median.max(f64::MIN_POSITIVE);
        lines.push(("noise", format!("{}  ({spacings:.2} spacings)", short(s.noise))));
        lines.push(("isolated", percent(s.isolated)));
        lines.push(("off surface", percent(s.off_surface)));
        lines.push(("on lines", percent(s.on_lines)));
        lines
    }

    /// All of it as one object: lengths in the cloud's units, shares from 0 to 1.
    #[must_use]
    pub fn json(&self) -> Value {
        let s = &self.survey;
        // Nothing is not zero.
        let known = |x: f64| if s.measured > 0 { json!(x) } else { Value::Null };
        let spread =
            |x: Spread| json!({ "p01": known(x.low), "median": known(x.median), "p99": known(x.high) });
        let attributes: Vec<Value> = (self.attributes())
            .map(|(name, kind, rule)| json!({ "name": name, "type": kind, "rule": rule.to_string() }))
            .collect();
        json!({
            "format": self.format.to_string(),
            "sha256": self.cloud.origin.sha256.map(hex::encode),
            "points": s.finite,
            "non_finite": s.non_finite,
            "duplicates": s.duplicates,
            "bounds": s.bounds,
            "spacing": spread(s.spacing),
            "mean_spacing": known(s.mean_spacing),
            "density": spread(s.density),
            "area": known(s.area),
            "unevenness": known(s.unevenness),
            "noise": known(s.noise),
            "isolated": known(s.isolated),
            "off_surface": known(s.off_surface),
            "on_lines": known(s.on_lines),
            "strays": self.strays,
            "crs": self.cloud.origin.crs.as_ref().map(ToString::to_string),
            "sensor": self.cloud.origin.sensor,
            "attributes": attributes,
            "comments": self.cloud.origin.comments,
            "provenance": self.made,
            "warnings": self.warnings(),
            "upsampling": {
                "ratio": self.ratio,
                "points": self.points_out(),
                "seconds_on_one_thread": self.seconds(),
                "bytes": self.bytes(),
            },
        })
    }

    fn seconds(&self) -> f64 {
        self.points_out() as f64 * SECONDS_A_POINT
    }

    fn bytes(&self) -> f64 {
        BYTES + self.points_out() as f64 * BYTES_A_POINT
    }
}

/// Three digits, whatever the size.
pub(crate) fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = 2 - value.abs().log10().floor() as i32;
    match digits {
        ..=0 => format!("{value:.0}"),
        1..=6 => format!("{value:.*}", digits as usize),
        _ => format!("{value:.2e}"),
    }
}

fn kind(kind: Kind) -> &'static str {
    match kind {
        Kind::I8 => "int8",
        Kind::U8 => "uint8",
        Kind::I16 => "int16",
        Kind::U16 => "uint16",
        Kind::I32 => "int32",
        Kind::U32 => "uint32",
        Kind::I64 => "int64",
        Kind::U64 => "uint64",
        Kind::F32 => "float32",
        Kind::F64 => "float64",
    }
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn numbers_keep_three_digits() {
        for (value, text) in [
            (0.0, "0"),
            (1234.5, "1234"),
            (12.345, "12.3"),
            (0.01234, "0.0123"),
            (1.5e-9, "1.50e-9"),
            (-2.0, "-2.00"),
        ] {
            assert_eq!(short(value), text);
        }
    }
}
