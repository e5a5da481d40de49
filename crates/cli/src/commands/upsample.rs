//! `densecloud upsample` of one file: a denser file out.

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::{ArgGroup, Args};
use densecloud::{Options, PrepareError, Prepared, Report};
use densecloud_cloud::{Cloud, Origin};
use densecloud_engine::{EngineError, Outcome, Pending, ProgressHandle, StageTimes};
use densecloud_tiles::Input;
use indicatif::{ProgressBar, ProgressStyle};

use super::clean::Before;
use super::engine_args::{EngineArgs, Machine};
use super::events::{Events, Made};
use super::options::{GOALS, OptionArgs};
use super::tile_args::TileArgs;
use super::{CliError, files, mesh, report, tiled, upsample_remote};
use crate::report::Making;

/// A work on one input, and all options of it.
#[derive(Debug, Clone, Args)]
#[command(group = ArgGroup::new(GOALS))]
pub(super) struct UpsampleArgs {
    /// The sparse cloud
    #[arg(skip)]
    pub(super) input: PathBuf,

    /// The dense cloud
    #[arg(skip)]
    pub(super) output: PathBuf,

    /// Where it is told how the work goes
    #[arg(skip)]
    pub(super) events: Events,

    #[command(flatten)]
    pub(super) options: OptionArgs,

    /// Say nothing but errors
    #[arg(short, long)]
    pub(super) quiet: bool,

    /// Have a server do the work; it has its own model and threads
    #[arg(long, value_name = "URL")]
    pub(super) server: Option<String>,

    /// The key that opens the server, where it asks for one
    #[arg(long, env = "DENSECLOUD_KEY", hide_env_values = true, value_name = "KEY")]
    pub(super) key: Option<String>,

    #[command(flatten)]
    pub(super) tiles: TileArgs,

    /// Clean the cloud first, as `densecloud clean` does
    #[arg(long, value_enum, value_name = "STEPS", num_args = 0..=1, require_equals = true,
        default_missing_value = "outliers", conflicts_with = "server")]
    pub(super) clean: Option<Before>,

    /// Write a page that shows the result beside the input, an HTML file: as `densecloud report` does
    #[arg(long, value_name = "HTML", conflicts_with = "server")]
    pub(super) report: Option<PathBuf>,

    /// Write the surface of the result as triangles, too, to a .ply, .obj, .glb or .stl: as `densecloud mesh` does
    #[arg(long, value_name = "MESH", conflicts_with = "server")]
    pub(super) mesh: Option<PathBuf>,

    /// Go on where a work on the same input, with the same options, was stopped or killed; what is done stays in the
    /// temporary folder for that
    #[arg(long, conflicts_with = "server")]
    pub(super) resume: bool,

    #[command(flatten)]
    pub(super) engine: EngineArgs,
}

/// What is added to the name of a result whose format has no place for comments.
pub const PROVENANCE: &str = ".provenance.txt";

impl UpsampleArgs {
    /// Refuses what names one file, where there are several inputs.
    pub(super) fn refuse_one_for_all(&self) -> Result<(), CliError> {
        match self {
            Self { report: Some(_), .. } => {
                Err(CliError::Usage("--report is a page of one result; give one input".into()))
            }
            Self { mesh: Some(_), .. } => {
                Err(CliError::Usage("--mesh is a file of one result; give one input".into()))
            }
            _ => Ok(()),
        }
    }

    /// Refuses what needs the whole cloud at once.
    pub(super) fn refuse_in_tiles(&self) -> Result<(), CliError> {
        match self {
            Self { report: Some(_), .. } => Err(no_report(&self.input)),
            Self { clean: Some(_), .. } => Err(unclean(&self.input)),
            Self { mesh: Some(_), .. } => Err(no_mesh(&self.input)),
            _ => Ok(()),
        }
    }

    /// The options, with the format that the output's name asks for. Temporary files go to their folder from then on.
    pub(super) fn settled(&self) -> Result<Options, CliError> {
        let options = self.options.options()?;
        let format = files::wanted_from(&self.input, &self.output, &options.reading)?;
        self.tiles.settle()?;
        Ok(Options { format, ..options })
    }
}

/// Works on one input.
pub(super) fn run(args: &UpsampleArgs, machine: &Machine<'_>) -> Result<Made, CliError> {
    if let Some(page) = &args.report {
        report::check_name(page)?;
    }
    if let Some(file) = &args.mesh {
        mesh::check_name(file)?;
    }
    let options = args.settled()?;
    if let Some(url) = &args.server {
        return upsample_remote::run(args, &options, url);
    }
    let start = Instant::now();
    let model = machine.model()?;
    let reader = files::open(&args.input, &options.reading)?;
    let tile_points = args.tiles.size.points(&options, reader.header())?;
    let read = Input::read(reader, tile_points).map_err(|why| CliError::file(&args.input, why))?;
    let (mut cloud, header) = match read {
        Input::Small(cloud, header) => (*cloud, header),
        Input::Large(large) => {
            args.refuse_in_tiles()?;
            return tiled::run(args, &options, *large, tile_points, model, start);
        }
    };
    let before = args.report.as_ref().map(|page| (page, cloud.clone(), header.format));
    if let Some(before) = args.clean {
        before.clean(&mut cloud, &args.input, args.quiet)?;
    }
    let prepared = Prepared::new(cloud, header.format, options, &model.name());
    let Prepared { request, mut report } = prepared.map_err(|error| refused(&args.input, &error))?;
    let warn = |warnings: &[String]| super::warn(warnings, args.quiet);
    warn(&report.warnings);
    let told = report.warnings.len();
    let fail = |e: EngineError| CliError::file(&args.input, e);
    let job = machine.engine()?.submit(request).map_err(fail)?;
    let outcome = wait(job, args).map_err(fail)?;
    report.complete(&outcome.made);
    warn(&report.warnings[told..]);
    files::write_cloud(
        &args.output,
        report.format,
        &outcome.made.positions,
        &outcome.made.attributes,
        &report.origin,
    )?;
    write_provenance(&report, &args.output)?;
    let (seconds, Outcome { made, stages, .. }) = (start.elapsed().as_secs_f64(), outcome);
    let told = Made {
        stages: self::stages(&stages)
            .map(|(name, time)| (name.to_owned(), time.as_secs_f64().into()))
            .collect(),
        ..Made::of(&report)
    };
    let after = Cloud {
        positions: made.positions,
        attributes: made.attributes,
        // The file that was written has another.
        origin: Origin { sha256: None, ..report.origin },
        ..Cloud::default()
    };
    if let Some((page, cloud, format)) = before {
        let making = Making {
            warnings: report.warnings,
            seconds,
            stages: self::stages(&stages).map(|(name, time)| (name.to_owned(), time.as_secs_f64())).collect(),
        };
        let before = (&cloud, format, args.input.as_path());
        report::write_of(page, before, (&after, report.format, &args.output), making)?;
    }
    if let Some(file) = &args.mesh {
        mesh::write_of(file, (&after, &args.output), args.quiet)?;
    }
    if !args.quiet {
        let shares = shares(&stages);
        let (from, to) = (report.points_in, report.points_out);
        super::note(&format!("{from} -> {to} points in {seconds:.1} s ({shares})"));
    }
    Ok(told)
}

/// Writes where a result comes from beside it, where its format has no place for that.
pub(super) fn write_provenance(report: &Report, output: &Path) -> Result<(), CliError> {
    if report.format.holds_comments() || !files::is_kept(output) {
        return Ok(());
    }
    files::write(&files::beside(output, PROVENANCE), |sink| Ok(writeln!(sink, "{}", report.provenance)?))
}

/// What the options and the cloud together have wrong.
pub(super) fn refused(input: &Path, error: &PrepareError) -> CliError {
    match error {
        PrepareError::UnknownAttribute { .. } => CliError::Usage(format!("--attributes: {error}")),
        // As with --points, it depends on the cloud whether that is wrong.
        error => CliError::file(input, error),
    }
}

/// Waits with a progress bar on standard error if that is a terminal, and tells of progress where that is wanted.
fn wait(job: Pending, args: &UpsampleArgs) -> Result<Outcome, EngineError> {
    let is_shown = !args.quiet && io::stderr().is_terminal();
    if !is_shown && !args.events.0 {
        return job.wait();
    }
    let handle = job.progress_handle();
    let waiter = std::thread::spawn(move || job.wait());
    let bar = if is_shown { ProgressBar::new(1000) } else { ProgressBar::hidden() };
    let mut told = 0.0;
    if let Ok(style) = ProgressStyle::with_template("{msg:28} [{bar:30}] {percent:>3} %  {eta} left") {
        bar.set_style(style.progress_chars("=> "));
    }
    while !waiter.is_finished() {
        show(&bar, &handle);
        args.events.progress(&args.input, handle.progress().fraction, &mut told);
        std::thread::sleep(Duration::from_millis(50));
    }
    bar.finish_and_clear();
    waiter.join().unwrap_or(Err(EngineError::Cancelled))
}

fn show(bar: &ProgressBar, handle: &ProgressHandle) {
    let progress = handle.progress();
    if let Some(stage) = progress.stage {
        bar.set_message(format!("level {} of {}: {}", progress.level, progress.levels, stage.name()));
    }
    bar.set_position((progress.fraction * 1000.0) as u64);
}

/// A report holds both clouds, and this one is too large for that.
fn no_report(input: &Path) -> CliError {
    CliError::file(
        input,
        "it is worked on in tiles, and --report needs all of it at once; upsample it without, then make a report of a \
         part: densecloud report IN OUT -o HTML --bounds X0,Y0,X1,Y1",
    )
}

/// A mesh is made of a whole cloud, and this one is too large for that.
fn no_mesh(input: &Path) -> CliError {
    CliError::file(
        input,
        "it is worked on in tiles, and --mesh needs all of it at once; upsample it without, then make a mesh of a part: densecloud \
         mesh OUT MESH --bounds X0,Y0,X1,Y1",
    )
}

/// Cleaning looks at a whole cloud, and this one is too large for that.
fn unclean(input: &Path) -> CliError {
    CliError::file(
        input,
        "it is worked on in tiles, and --clean needs all of it at once; clean it first (densecloud clean IN OUT), and upsample what \
         that makes",
    )
}

/// The stages that took any time, by name.
fn stages(times: &StageTimes) -> impl Iterator<Item = (&'static str, Duration)> {
    times.iter().filter(|(_, time)| !time.is_zero()).map(|(stage, time)| (stage.name(), time))
}

fn shares(times: &StageTimes) -> String {
    let total = times.total().as_secs_f64().max(f64::MIN_POSITIVE);
    let share =
        |(name, time): (&str, Duration)| format!("{name} {:.0} %", 100.0 * time.as_secs_f64() / total);
    stages(times).map(share).collect::<Vec<_>>().join(", ")
}
