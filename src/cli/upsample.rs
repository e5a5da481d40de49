//! `densecloud upsample`: a file in, a denser file out.

use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{ArgGroup, Args};
use indicatif::{ProgressBar, ProgressStyle};

use super::engine_args::EngineArgs;
use super::{CliError, files};
use crate::attributes::Rules;
use crate::cascade::{Settings, Target};
use crate::engine::{EngineError, Job, Outcome, ProgressHandle, Request};
use crate::formats::{Format, FormatError};

/// Make a cloud denser.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("target"), after_help = "\
Examples:
  densecloud upsample scan.ply dense.ply --ratio 4
  densecloud upsample scan.xyz dense.ply --points 1000000
  cat scan.ply | densecloud upsample - - --ratio 2.5 > dense.ply")]
pub(super) struct UpsampleArgs {
    /// The sparse cloud: PLY, LAS, LAZ, E57, PCD, NumPy, OFF, OBJ or text, recognised by its content; `-` for standard
    /// input
    input: PathBuf,

    /// The dense cloud: .ply, .xyz, .e57 or .npy (another or no extension: as the input, or PLY for formats that are only read);
    /// `-` for standard output
    output: PathBuf,

    /// Points out for each point in, any number from 1 to 64 [default: 4]
    #[arg(short, long, value_name = "R", group = "target")]
    ratio: Option<f64>,

    /// Points out, exactly: 1 to 64 times the points in
    #[arg(short = 'n', long, value_name = "N", group = "target")]
    points: Option<u64>,

    /// Chooses among equally good results; the same seed gives the same bytes
    #[arg(long, default_value_t = 0)]
    seed: u64,

    /// How many patches each point lies in, on average: more is slower
    #[arg(long, value_name = "X", default_value_t = Settings::default().overlap)]
    overlap: f64,

    /// Share of each patch, around its centre, whose points are kept: 1 keeps all
    #[arg(long, value_name = "X", default_value_t = Settings::default().inner)]
    inner: f64,

    /// Leave out points moved further than this many spacings from their source; `inf` keeps all
    #[arg(long, value_name = "X", default_value_t = Settings::default().max_displacement)]
    max_displacement: f64,

    /// Leave out points further from the input than this many times what nine in ten keep to; `inf` keeps all
    #[arg(long, value_name = "X", default_value_t = Settings::default().max_distance)]
    max_distance: f64,

    /// Keep what the network made as it is: less even, less smooth, and each point an output of the network
    #[arg(long)]
    no_polish: bool,

    /// How new points come by their attributes, by name: mean (of the nearest), nearest or drop, such as
    /// `label:nearest,curvature:drop` [default: by name and type]
    #[arg(long, value_name = "NAME:RULE,...")]
    attributes: Option<Rules>,

    /// Say nothing but errors
    #[arg(short, long)]
    quiet: bool,

    #[command(flatten)]
    engine: EngineArgs,
}

pub(super) fn run(args: &UpsampleArgs) -> Result<(), CliError> {
    let target = match (args.ratio, args.points) {
        (None, Some(points)) => Target::Points(points),
        (ratio, _) => Target::Ratio(ratio.unwrap_or(4.0)),
    };
    // A bad ratio should be told before a long read.
    if let Target::Ratio(_) = target {
        target.points_out(1).map_err(|e| CliError::Usage(e.to_string()))?;
    }
    let wanted = Format::from_extension(&args.output);
    if wanted.is_some_and(|wanted| wanted.written() != wanted) {
        return Err(CliError::Usage(FormatError::NotWritten.to_string()));
    }
    let start = Instant::now();
    let (cloud, header) = files::read_cloud(&args.input)?;
    let format = Format::of_result(wanted, header.format, !cloud.attributes.is_empty());
    let mut origin = cloud.origin.clone();
    let note = |text: String| {
        if !args.quiet {
            eprintln!("densecloud: {text}");
        }
    };
    for warning in cloud.warnings() {
        note(format!("warning: {warning}"));
    }
    let references = origin.drop_references();
    if !references.is_empty() {
        note(format!("warning: not carried over: {} (about the input's points)", references.join(", ")));
    }

    let points_in = cloud.positions.len();
    let settings = Settings {
        overlap: args.overlap,
        inner: args.inner,
        max_displacement: args.max_displacement,
        max_distance: args.max_distance,
        polish: !args.no_polish,
        seed: args.seed,
    };
    let engine = args.engine.engine()?;
    let fail = |e: EngineError| CliError::file(&args.input, e);
    let rules = args.attributes.clone().unwrap_or_default();
    let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    if let Some(unknown) = rules.unknown(&names).next() {
        let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        return Err(CliError::Usage(format!(
            "--attributes: no attribute {unknown:?}; the input has {known}"
        )));
    }
    let job = engine.submit(Request { cloud, target, settings, rules }).map_err(fail)?;
    let outcome = wait(job, args.quiet).map_err(fail)?;
    for warning in outcome.warnings() {
        note(format!("warning: {warning}"));
    }
    let lost = format.cannot_hold(&outcome.attributes, &origin);
    if !lost.is_empty() {
        note(format!("warning: the output's format has no place for {}", lost.join(", ")));
    }
    files::write_cloud(&args.output, format, &outcome.positions, &outcome.attributes, &origin)?;
    note(format!(
        "{points_in} -> {} points in {:.1} s ({})",
        outcome.positions.len(),
        start.elapsed().as_secs_f64(),
        shares(&outcome),
    ));
    Ok(())
}

/// Waits with a progress bar on standard error if that is a terminal.
fn wait(job: Job, quiet: bool) -> Result<Outcome, EngineError> {
    if quiet || !io::stderr().is_terminal() {
        return job.wait();
    }
    let handle = job.progress_handle();
    let waiter = std::thread::spawn(move || job.wait());
    let bar = ProgressBar::new(1000);
    if let Ok(style) = ProgressStyle::with_template("{msg:28} [{bar:30}] {percent:>3} %  {eta} left") {
        bar.set_style(style.progress_chars("=> "));
    }
    while !waiter.is_finished() {
        show(&bar, &handle);
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

fn shares(outcome: &Outcome) -> String {
    let total = outcome.stages.total().as_secs_f64().max(f64::MIN_POSITIVE);
    let share = |(stage, time): (crate::cascade::Stage, Duration)| {
        format!("{} {:.0} %", stage.name(), 100.0 * time.as_secs_f64() / total)
    };
    outcome.stages.iter().filter(|(_, time)| !time.is_zero()).map(share).collect::<Vec<_>>().join(", ")
}
