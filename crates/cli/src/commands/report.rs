//! `densecloud report`: what a result is like beside its input, on one page.

use std::path::{Path, PathBuf};

use clap::Args;
use densecloud::position;
use densecloud::survey::SAMPLE;
use densecloud_cloud::{Cloud, Position};
use densecloud_formats::Format;

use super::options::ReadingArgs;
use super::upsample::PROVENANCE;
use super::{CliError, available_memory, files, places};
use crate::commands::render::AxisName;
use crate::report::{Making, Report, ReportError, Side, Wanted};

/// Bytes that a report takes for a point of either cloud, at the peak: both, their trees, and what is drawn
/// (docs/report.md).
const BYTES_A_POINT: u64 = 250;

/// Show what a result is like beside its input, on one page
///
/// Pictures before and after, histograms, density by distance, warnings with what to do, and where it comes from: one
/// HTML file that needs nothing else.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud report scan.laz dense.laz -o report.html
  densecloud report scan.ply dense.ply -o report.html --json report.json --up y
  densecloud report scan.ply dense.ply --json - | jq .warnings
  densecloud report city.copc.laz dense.copc.laz -o part.html --bounds 636000,849000,636500,849500")]
pub(super) struct ReportArgs {
    /// The cloud before, in any format that is read
    input: PathBuf,

    /// The cloud after
    output: PathBuf,

    /// The page, an HTML file; `-` for standard output
    #[arg(short = 'o', long = "out", value_name = "HTML", required_unless_present = "json")]
    out: Option<PathBuf>,

    /// The numbers as one JSON object; `-` for standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,

    /// Where the sensor stood, for the density by distance, where the input does not tell
    #[arg(long, value_name = "X,Y,Z", value_parser = position, allow_hyphen_values = true)]
    sensor: Option<Position>,

    /// The axis that points up
    #[arg(long, value_enum, default_value_t = AxisName::Z)]
    up: AxisName,

    /// Points of each cloud to measure
    #[arg(long, value_name = "N", default_value_t = SAMPLE, value_parser = sample)]
    sample: usize,

    #[command(flatten)]
    reading: ReadingArgs,
}

pub(super) fn run(args: &ReportArgs) -> Result<(), CliError> {
    places::check(&[&args.input, &args.output])?;
    if let Some(out) = &args.out {
        check_name(out)?;
    }
    if files::is_stream(&args.input) && files::is_stream(&args.output) {
        return Err(CliError::Usage("only one of the clouds can come from standard input".into()));
    }
    if [&args.out, &args.json].iter().all(|file| file.as_deref().is_some_and(files::is_stream)) {
        return Err(CliError::Usage("only one of the page and the numbers can go to standard output".into()));
    }
    let reading = args.reading.reading()?;
    let mut held = 0;
    let mut read = |path: &Path| {
        let reader = files::open(path, &reading)?;
        held += reader.header().points.unwrap_or_default();
        check_memory(held)?;
        let format = reader.header().format;
        let cloud = reader.read().map_err(|why| CliError::file(path, why))?;
        Ok::<_, CliError>((with_provenance(cloud, path), format))
    };
    let ((input, before), (output, after)) = (read(&args.input)?, read(&args.output)?);
    let wanted = Wanted { sensor: args.sensor, up: args.up.axis(), sample: args.sample };
    let (from, to) = (name(&args.input), name(&args.output));
    let input = Side { cloud: &input, format: before, name: &from };
    let output = Side { cloud: &output, format: after, name: &to };
    let report = Report::of(input, output, &wanted, None).map_err(failed)?;
    if let Some(json) = &args.json {
        files::write(json, |sink| Ok(writeln!(sink, "{:#}", report.json())?))?;
    }
    args.out.as_deref().map_or(Ok(()), |out| write(&report, out))
}

/// Makes the page of a result that was just made, where it is asked for.
pub(super) fn write_of(
    path: &Path,
    (input, input_format, input_name): (&Cloud, Format, &Path),
    (output, output_format, output_name): (&Cloud, Format, &Path),
    making: Making,
) -> Result<(), CliError> {
    let (from, to) = (name(input_name), name(output_name));
    let input = Side { cloud: input, format: input_format, name: &from };
    let output = Side { cloud: output, format: output_format, name: &to };
    let wanted = Wanted { sensor: None, up: AxisName::Z.axis(), sample: SAMPLE };
    write(&Report::of(input, output, &wanted, Some(making)).map_err(failed)?, path)
}

fn write(report: &Report<'_>, path: &Path) -> Result<(), CliError> {
    files::write(path, |sink| Ok(sink.write_all(report.html().as_bytes())?))
}

/// Refuses what would not be opened as a page.
pub(super) fn check_name(out: &Path) -> Result<(), CliError> {
    match out.extension() {
        Some(extension) if !["html", "htm"].iter().any(|known| extension.eq_ignore_ascii_case(known)) => {
            Err(CliError::Usage(format!("{}: reports are HTML pages; name it .html", out.display())))
        }
        _ => Ok(()),
    }
}

fn check_memory(points: u64) -> Result<(), CliError> {
    let needed = points.saturating_mul(BYTES_A_POINT);
    match available_memory() {
        Some(left) if needed > left => Err(CliError::Failed(format!(
            "a report holds both clouds: {points} points take about {} MB, and {} MB are left; make it of a part, by \
             --bounds",
            needed >> 20,
            left >> 20
        ))),
        _ => Ok(()),
    }
}

/// With the provenance that lies beside a file whose format has no place for it.
fn with_provenance(mut cloud: Cloud, file: &Path) -> Cloud {
    let beside = std::fs::read_to_string(files::beside(file, PROVENANCE)).unwrap_or_default();
    cloud.origin.comments.extend(beside.lines().map(str::to_owned));
    cloud
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).display().to_string()
}

fn failed(why: ReportError) -> CliError {
    CliError::Failed(why.to_string())
}

fn sample(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| *n > 0).ok_or_else(|| "give 1 point or more".into())
}
