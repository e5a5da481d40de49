//! `densecloud clean`: what is no surface leaves a cloud, noise is smoothed, and what is too dense is thinned. No model.

use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args, ValueEnum};
use serde_json::json;

use super::options::ReadingArgs;
use super::{CliError, files};
use densecloud::clean::{Cleaned, Cleaning, Thinning, clean};
use densecloud_cloud::{Cloud, Position};
use densecloud_formats::{Format, Header};
use densecloud_geometry::Smoothing;

/// Leave out what is no surface, smooth noise, thin what is too dense
///
/// Without options: points that are not finite, exact duplicates, and points that stand alone are left out. Steps are taken in
/// the order of the options below. Points keep their order and attributes.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("thinning"),
    after_help = "\
Examples:
  densecloud clean scan.laz clean.laz --groups 20
  densecloud clean noisy.ply smooth.ply --smooth
  densecloud clean noisy.ply smooth.ply --smooth=wlop --statistical 2
  densecloud clean dense.e57 thin.e57 --voxel 0.05
  densecloud clean scan.ply - --dry-run"
)]
pub(super) struct CleanArgs {
    /// The cloud, in any format that is read; `-` for standard input
    input: PathBuf,

    /// The cleaned cloud, in any format that is written; `-` for standard output
    output: PathBuf,

    /// Keep points at the very place of an earlier one
    #[arg(long)]
    keep_duplicates: bool,

    /// Leave out points with fewer than --neighbours others within this distance, in the cloud's units
    #[arg(long, value_name = "LENGTH", value_parser = positive, requires = "neighbours")]
    radius: Option<f64>,

    /// How many others
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..1_000_000), requires = "radius")]
    neighbours: Option<u32>,

    /// Leave out points this many times further from others than these are from each other, or beside a surface by half as
    /// much
    #[arg(long, value_name = "FACTOR", default_value_t = Cleaning::OUTLIERS, value_parser = positive)]
    outliers: f64,

    /// Keep points that stand alone
    #[arg(long, conflicts_with = "outliers")]
    keep_outliers: bool,

    /// Leave out points whose mean distance to their 8 nearest is this many standard deviations above that of all: for clouds of
    /// one density, since it takes the thin parts of others
    #[arg(long, value_name = "DEVIATIONS", value_parser = positive)]
    statistical: Option<f64>,

    /// Leave out groups of fewer points, which gaps of three local spacings part from others
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    groups: Option<u32>,

    /// Move points onto the surface about them, where it is noisy: 20 to 640 neighbours by how noisy it is
    #[arg(long, value_enum, value_name = "METHOD", num_args = 0..=1, require_equals = true, default_missing_value = "mls")]
    smooth: Option<Method>,

    /// Points in places with less noise than this stay where they are; twice this and more, they move in full. In local
    /// spacings
    #[arg(long, value_name = "SPACINGS", default_value_t = Cleaning::GATE, value_parser = not_negative, requires = "smooth")]
    smooth_above: f64,

    /// Keep one point for each cube of this side, in the cloud's units: the one nearest to their mean
    #[arg(long, value_name = "LENGTH", value_parser = positive, group = "thinning")]
    voxel: Option<f64>,

    /// Keep points of which no two are nearer than this, in the cloud's units
    #[arg(long, value_name = "LENGTH", value_parser = positive, group = "thinning")]
    spacing: Option<f64>,

    /// Keep this many points, as far from each other as can be
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), group = "thinning")]
    points: Option<u32>,

    /// Write nothing, only say what would be done
    #[arg(long)]
    dry_run: bool,

    /// Say what was done as one JSON object on standard error
    #[arg(long)]
    json: bool,

    /// Say nothing but errors
    #[arg(short, long, conflicts_with = "json")]
    quiet: bool,

    #[command(flatten)]
    reading: ReadingArgs,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Method {
    /// Moving least squares, which gives outlying neighbours little weight
    Mls,
    /// The bilateral filter: milder, keeps creases
    Bilateral,
    /// Weighted locally optimal projection: evens the sampling out as well; ten times as long
    Wlop,
}

impl CleanArgs {
    fn cleaning(&self) -> Cleaning {
        let neighbours = self.neighbours.map_or(0, |count| count as usize);
        let thin = (self.voxel.map(Thinning::Voxel))
            .or(self.spacing.map(Thinning::Spacing))
            .or(self.points.map(|count| Thinning::Points(count as usize)));
        Cleaning {
            duplicates: !self.keep_duplicates,
            radius: self.radius.map(|radius| (radius, neighbours)),
            outliers: (!self.keep_outliers).then_some(self.outliers),
            statistical: self.statistical,
            groups: self.groups.map(|least| least as usize),
            smooth: self.smooth.map(|method| (method.smoothing(), self.smooth_above)),
            thin,
        }
    }
}

impl Method {
    fn smoothing(self) -> Smoothing {
        match self {
            Self::Mls => Smoothing::MovingLeastSquares,
            Self::Bilateral => Smoothing::Bilateral,
            Self::Wlop => Smoothing::Wlop,
        }
    }
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(number) if number > 0.0 && f64::is_finite(number) => Ok(number),
        _ => Err("a number above 0 is wanted".into()),
    }
}

fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(number) if number >= 0.0 && f64::is_finite(number) => Ok(number),
        _ => Err("a number that is not negative is wanted".into()),
    }
}

/// What is done before upsampling.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum Before {
    /// Duplicates, and points that stand alone or beside a surface, are left out
    Outliers,
    /// Also noise is smoothed, where there is some
    Smooth,
}

impl Before {
    /// Cleans a cloud of a file, and says so; comments of the result tell of it.
    pub(super) fn clean(self, cloud: &mut Cloud, file: &Path, quiet: bool) -> Result<(), CliError> {
        let smooth = match self {
            Self::Outliers => None,
            Self::Smooth => Some((Smoothing::MovingLeastSquares, Cleaning::GATE)),
        };
        let cleaning = Cleaning { smooth, ..Cleaning::default() };
        let told = clean(cloud, &cleaning).map_err(|why| CliError::file(file, why))?;
        cloud.origin.comment(&line(&told, &cleaning));
        if !quiet {
            super::note(&format!("cleaned: {}", text(&told, &cleaning)));
        }
        Ok(())
    }
}

pub(super) fn run(args: &CleanArgs) -> Result<(), CliError> {
    let reading = args.reading.reading()?;
    let wanted = files::wanted_from(&args.input, &args.output, &reading)?;
    let (mut cloud, header) = files::read_cloud(&args.input, &reading)?;
    let cleaning = args.cleaning();
    let told = clean(&mut cloud, &cleaning).map_err(|why| CliError::file(&args.input, why))?;
    let format = result_format(wanted, &header, &cloud);
    let adaptation = header.format.adaptation(&cloud.attributes, &|i| facts(&cloud, i), format);
    adaptation.apply(&mut cloud.attributes);
    let lost = format.cannot_hold(&cloud.attributes, &cloud.origin);
    let mut warnings = cloud.warnings();
    warnings.extend(adaptation.told);
    if !lost.is_empty() {
        warnings.push(format!("the result's format has no place for {}", lost.join(", ")));
    }
    if told.moved > 0 && cloud.attributes.iter().any(|a| a.name.eq_ignore_ascii_case("nx")) {
        warnings.push("normals are those of the points before they were moved".into());
    }
    if !args.json {
        super::warn(&warnings, args.quiet);
    }
    if !args.dry_run {
        cloud.origin.comment(&line(&told, &cleaning));
        files::write_cloud(&args.output, format, &cloud.positions, &cloud.attributes, &cloud.origin)?;
    }
    if args.json {
        eprintln!("{}", as_json(&told, &warnings));
    } else if !args.quiet {
        super::note(&text(&told, &cleaning));
    }
    Ok(())
}

fn facts(cloud: &Cloud, i: usize) -> densecloud_cloud::Facts {
    densecloud_cloud::Facts::of(&cloud.attributes[i].values)
}

/// Fine enough for where points are now: those that moved may need more digits than the input had.
fn result_format(wanted: Option<Format>, header: &Header, cloud: &Cloud) -> Format {
    let format = Format::of_result(wanted, header.format, !cloud.attributes.is_empty());
    let bounds = bounds(&cloud.positions);
    let extent = (0..3).map(|a| bounds[1][a] - bounds[0][a]).fold(0.0, f64::max);
    format.fine_enough(bounds, extent / (cloud.positions.len() as f64).sqrt())
}

fn bounds(positions: &[Position]) -> [Position; 2] {
    let all = |fold: fn(f64, f64) -> f64, from: f64| -> Position {
        std::array::from_fn(|a| positions.iter().map(|p| p[a]).fold(from, fold))
    };
    [all(f64::min, f64::INFINITY), all(f64::max, f64::NEG_INFINITY)]
}

/// What was left out, by what; nothing where nothing was.
fn steps(told: &Cleaned) -> Vec<(usize, &'static str)> {
    let all = [
        (told.non_finite, "not finite"),
        (told.duplicates, "duplicates"),
        (told.sparse, "with few others in the radius"),
        (told.outliers, "alone or beside a surface"),
        (told.statistical, "further from others than most"),
        (told.groups, "in small groups"),
        (told.thinned, "thinned"),
    ];
    all.into_iter().filter(|(count, _)| *count > 0).collect()
}

fn text(told: &Cleaned, cleaning: &Cleaning) -> String {
    let steps: Vec<String> = steps(told).iter().map(|(count, what)| format!("{count} {what}")).collect();
    let mut text = format!("{} -> {} points", told.points_in, told.points_out);
    text += &if steps.is_empty() { ": none left out".to_owned() } else { format!(": {}", steps.join(", ")) };
    if let Some((_, gate)) = cleaning.smooth {
        text += &format!(
            "; noise of {:.2} spacings (median): {} points moved, {} lie within {gate} spacings of a surface, {} on none",
            told.noise, told.moved, told.smooth, told.no_surface
        );
    }
    text
}

/// What is written into the file: the same input and options give the same.
fn line(told: &Cleaned, cleaning: &Cleaning) -> String {
    format!("densecloud clean {}: {}", env!("CARGO_PKG_VERSION"), text(told, cleaning))
}

fn as_json(told: &Cleaned, warnings: &[String]) -> serde_json::Value {
    json!({
        "points_in": told.points_in,
        "points_out": told.points_out,
        "left_out": {
            "non_finite": told.non_finite,
            "duplicates": told.duplicates,
            "radius": told.sparse,
            "outliers": told.outliers,
            "statistical": told.statistical,
            "groups": told.groups,
            "thinned": told.thinned,
        },
        "moved": told.moved,
        "smooth": told.smooth,
        "no_surface": told.no_surface,
        "noise": if told.noise.is_finite() { json!(told.noise) } else { json!(null) },
        "warnings": warnings,
    })
}
