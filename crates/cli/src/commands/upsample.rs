//! `densecloud upsample`: a file in, a denser file out.

use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{ArgGroup, Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use super::cascade_args::CascadeArgs;
use super::engine_args::EngineArgs;
use super::{CliError, files, upsample_remote};
use densecloud::Request;
use densecloud::attributes::{Finish, Rules};
use densecloud::provenance;
use densecloud::survey::{self, Goal, GoalError, Survey};
use densecloud_cascade::Target;
use densecloud_cloud::Position;
use densecloud_engine::{EngineError, Outcome, Pending, ProgressHandle};
use densecloud_formats::Format;

/// Make a cloud denser.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("target"), after_help = "\
Examples:
  densecloud upsample scan.ply dense.ply --ratio 4
  densecloud upsample scan.xyz dense.ply --points 1000000
  densecloud upsample scan.laz dense.ply --spacing 0.05 --keep-input
  densecloud upsample scan.ply dense.ply --ratio 8 --server http://big-machine:8080
  cat scan.ply | densecloud upsample - - --ratio 2.5 > dense.ply")]
pub(super) struct UpsampleArgs {
    /// The sparse cloud: PLY, LAS, LAZ, E57, PCD, NumPy, OFF, OBJ or text, recognised by its content; `-` for standard
    /// input
    pub(super) input: PathBuf,

    /// The dense cloud: .ply, .las, .laz, .e57, .pcd, .npy or text such as .xyz (another or no extension: as the input);
    /// `-` for standard output
    pub(super) output: PathBuf,

    /// Points out for each point in, any number from 1 to 64 [default: 4]
    #[arg(short, long, value_name = "R", group = "target")]
    pub(super) ratio: Option<f64>,

    /// Points out, exactly: 1 to 64 times the points in
    #[arg(short = 'n', long, value_name = "N", group = "target")]
    pub(super) points: Option<u64>,

    /// Mean distance from a point to its nearest neighbour, in the cloud's units
    #[arg(long, value_name = "D", group = "target")]
    pub(super) spacing: Option<f64>,

    /// Points a square unit of surface
    #[arg(long, value_name = "N", group = "target")]
    pub(super) density: Option<f64>,

    /// Keep the input's points exactly, before the new ones; each takes the place of one of these
    #[arg(long)]
    pub(super) keep_input: bool,

    /// Add `source_index` (the row of the input's point that is nearest) and `is_generated` to each point
    #[arg(long)]
    pub(super) source_fields: bool,

    /// `estimate`: normals from the dense cloud itself, on the side of the input's, or of the sensor
    #[arg(long, value_name = "HOW")]
    pub(super) normals: Option<Normals>,

    /// Where the sensor stood, for the side of estimated normals [default: as the file says]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_position, allow_hyphen_values = true, requires = "normals")]
    pub(super) sensor: Option<Position>,

    /// Chooses among equally good results; the same seed gives the same bytes
    #[arg(long, default_value_t = 0)]
    pub(super) seed: u64,

    #[command(flatten)]
    cascade: CascadeArgs,

    /// How new points come by their attributes, by name: mean (of the nearest), nearest or drop, such as
    /// `label:nearest,curvature:drop` [default: by name and type]
    #[arg(long, value_name = "NAME:RULE,...")]
    pub(super) attributes: Option<Rules>,

    /// Say nothing but errors
    #[arg(short, long)]
    pub(super) quiet: bool,

    /// Have a server do the work; it has its own model and threads
    #[arg(long, value_name = "URL", conflicts_with_all = CascadeArgs::ALL)]
    server: Option<String>,

    /// The key that opens the server, where it asks for one
    #[arg(long, env = "DENSECLOUD_KEY", hide_env_values = true, value_name = "KEY")]
    pub(super) key: Option<String>,

    #[command(flatten)]
    pub(super) engine: EngineArgs,
}

/// Where the normals of new points come from.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum Normals {
    Estimate,
}

fn parse_position(text: &str) -> Result<Position, String> {
    let numbers: Vec<f64> =
        text.split(',').map(|n| n.trim().parse()).collect::<Result<_, _>>().map_err(|_| "not X,Y,Z")?;
    let position: Position = numbers.try_into().map_err(|_| "not three numbers X,Y,Z")?;
    if position.iter().all(|c| c.is_finite()) {
        Ok(position)
    } else {
        Err("not three finite numbers".to_owned())
    }
}

/// What is added to the name of a result whose format has no place for comments.
pub(super) const PROVENANCE: &str = ".provenance.txt";

pub(super) fn run(args: &UpsampleArgs) -> Result<(), CliError> {
    let goal = match (args.ratio, args.points, args.spacing, args.density) {
        (_, Some(points), ..) => Goal::Target(Target::Points(points)),
        (_, _, Some(spacing), _) => Goal::Spacing(spacing),
        (_, _, _, Some(density)) => Goal::Density(density),
        (ratio, ..) => Goal::Target(Target::Ratio(ratio.unwrap_or(4.0))),
    };
    // What no cloud could meet is told before a long read.
    match goal {
        Goal::Target(ratio @ Target::Ratio(_)) => {
            ratio.points_out(1).map_err(|e| CliError::Usage(e.to_string()))?;
        }
        Goal::Target(Target::Points(0)) => {
            return Err(CliError::Usage("--points 0 is none; give 1 to 64 times the points in".into()));
        }
        _ => {}
    }
    let wanted = Format::from_extension(&args.output);
    if wanted.is_some_and(|wanted| wanted.written() != wanted) {
        let why = "OFF and OBJ are read, not written; write PLY (.ply), which holds every attribute";
        return Err(CliError::Usage(why.into()));
    }
    if let Some(url) = &args.server {
        return upsample_remote::run(args, url, wanted);
    }
    let start = Instant::now();
    let (cloud, header) = files::read_cloud(&args.input)?;
    let note = |text: String| {
        if !args.quiet {
            super::note(&text);
        }
    };
    for warning in cloud.warnings() {
        note(format!("warning: {warning}"));
    }

    let points_in = cloud.positions.len();
    let target = goal.target(&cloud.positions).map_err(|e| match e {
        GoalError::NotPositive { .. } => CliError::Usage(e.to_string()),
        // As with --points, it depends on the cloud whether that is wrong.
        GoalError::OutOfRange { .. } | GoalError::Cloud(_) => CliError::file(&args.input, e),
    })?;
    let mut format = Format::of_result(wanted, header.format, !cloud.attributes.is_empty());
    if let Ok(survey) = Survey::of(&cloud.positions, survey::GLANCE) {
        for warning in survey.warnings() {
            note(format!("warning: {warning}"));
        }
        let points = target.points_out(survey.finite as u64).unwrap_or_default();
        format = format.fine_enough(survey.bounds, survey.result_spacing(points));
    }
    let settings = args.cascade.settings(args.seed);
    let model = args.engine.model()?;
    let name = model.name();
    let engine = args.engine.engine(model)?;
    let fail = |e: EngineError| CliError::file(&args.input, e);
    let rules = args.attributes.clone().unwrap_or_default();
    let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    if let Some(unknown) = rules.unknown(&names).next() {
        let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        return Err(CliError::Usage(format!(
            "--attributes: no attribute {unknown:?}; the input has {known}"
        )));
    }
    let finish = Finish {
        rules,
        keep_input: args.keep_input,
        source_fields: args.source_fields,
        estimate_normals: args.normals.is_some(),
        sensor: args.sensor,
    };
    let (mut origin, lost) = finish.origin(&cloud);
    if let Some(lost) = lost {
        note(format!("warning: {lost}"));
    }
    let request = Request { cloud, target, settings, finish };
    let provenance = provenance::line(&name, &request);
    origin.comments.push(provenance.clone());
    let job = engine.submit(request).map_err(fail)?;
    let outcome = wait(job, args.quiet).map_err(fail)?;
    for warning in outcome.warnings() {
        note(format!("warning: {warning}"));
    }
    let lost = format.cannot_hold(&outcome.attributes, &origin);
    if !lost.is_empty() {
        note(format!("warning: the output's format has no place for {}", lost.join(", ")));
    }
    files::write_cloud(&args.output, format, &outcome.positions, &outcome.attributes, &origin)?;
    if !format.holds_comments() && files::is_kept(&args.output) {
        let beside = files::beside(&args.output, PROVENANCE);
        files::write(&beside, |sink| Ok(writeln!(sink, "{provenance}")?))?;
    }
    note(format!(
        "{points_in} -> {} points in {:.1} s ({})",
        outcome.positions.len(),
        start.elapsed().as_secs_f64(),
        shares(&outcome),
    ));
    Ok(())
}

/// Waits with a progress bar on standard error if that is a terminal.
fn wait(job: Pending, quiet: bool) -> Result<Outcome, EngineError> {
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
    let share = |(stage, time): (densecloud_cascade::Stage, Duration)| {
        format!("{} {:.0} %", stage.name(), 100.0 * time.as_secs_f64() / total)
    };
    outcome.stages.iter().filter(|(_, time)| !time.is_zero()).map(share).collect::<Vec<_>>().join(", ")
}
