//! `densecloud tiles`: the steps of a work in tiles one by one, for many machines over one folder.

use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args, Subcommand};
use densecloud::Options;
use densecloud_formats::Format;
use densecloud_tiles::{Folder, Input, TilesError, Tiling, plan};

use super::engine_args::EngineArgs;
use super::options::{GOALS, OptionArgs};
use super::tile_args::{SizeArgs, temp_files_in};
use super::tile_progress::TileProgress;
use super::tiles_away::{AwayArgs, Work};
use super::{CliError, files, places, tiled};

/// Work on a large cloud in tiles, step by step: plan, run each, join, remove.
#[derive(Debug, Args)]
#[command(after_help = "\
Tiles are numbered from 0. Each is run alone, in any order and by any number of programs at once; whatever is run again gives
the same. `densecloud upsample` takes the same steps, in a temporary folder.

Examples:
  tiles=$(densecloud tiles plan scan.laz work --for dense.laz --ratio 4)
  seq 0 $((tiles - 1)) | xargs -P 2 -n 1 densecloud tiles run work
  densecloud tiles join work dense.laz
  densecloud tiles remove work

FOLDER, and the clouds, may be addresses as well (s3://bucket/path): docs/tiles.md.")]
pub(super) struct TilesArgs {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    Plan(Box<PlanArgs>),
    Run(RunArgs),
    Join(JoinArgs),
    Remove(RemoveArgs),
}

/// Cut a cloud into tiles, and print how many there are
#[derive(Debug, Args)]
#[command(group = ArgGroup::new(GOALS), after_help = "\
Examples:
  densecloud tiles plan scan.laz work --for dense.laz --ratio 4
  densecloud tiles plan s3://clouds/city.laz s3://clouds/work --for dense.laz")]
struct PlanArgs {
    /// The sparse cloud, as of `densecloud upsample`; `-` for standard input
    input: PathBuf,

    /// A new or empty folder for the tiles, or an address such as s3://bucket/work
    folder: PathBuf,

    /// The name that the result will have, for its format; without it, the input's format
    #[arg(long = "for", value_name = "NAME")]
    name: Option<PathBuf>,

    #[command(flatten)]
    options: OptionArgs,

    #[command(flatten)]
    size: SizeArgs,

    #[command(flatten)]
    away: AwayArgs,

    /// Say nothing but errors
    #[arg(short, long)]
    quiet: bool,

    #[command(flatten)]
    engine: EngineArgs,
}

/// Make the parts of tiles
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud tiles run work
  densecloud tiles run work 0 1 2")]
struct RunArgs {
    /// The folder in which they are planned, or its address
    folder: PathBuf,

    /// The numbers of the tiles; without any, all that are not done
    tiles: Vec<u32>,

    #[command(flatten)]
    away: AwayArgs,

    #[command(flatten)]
    engine: EngineArgs,
}

/// Join the parts of all tiles
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud tiles join work dense.laz")]
struct JoinArgs {
    /// The folder in which they lie, or its address
    folder: PathBuf,

    /// The dense cloud, in the format that it was planned for; `-` for standard output
    output: PathBuf,

    #[command(flatten)]
    away: AwayArgs,

    /// Say nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

/// Remove what was planned, and all parts
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud tiles remove work")]
struct RemoveArgs {
    /// The folder in which they lie, or its address; what else lies there stays
    folder: PathBuf,

    #[command(flatten)]
    away: AwayArgs,
}

pub(super) fn run(args: &TilesArgs) -> Result<(), CliError> {
    match &args.step {
        Step::Plan(args) => plan_tiles(args),
        Step::Run(args) => run_tiles(args),
        Step::Join(args) => join_tiles(args),
        Step::Remove(args) => remove_tiles(args),
    }
}

fn plan_tiles(args: &PlanArgs) -> Result<(), CliError> {
    places::check(&[&args.input, args.name.as_deref().unwrap_or("-".as_ref())])?;
    let options = args.options.options()?;
    let format = match &args.name {
        Some(name) => files::wanted_from(&args.input, name, &options.reading)?,
        None => None,
    };
    let options = Options { format, ..options };
    let tiles = match Work::at(&args.folder, &args.away)? {
        Work::Here(path) => {
            let folder = Folder::new(&path).map_err(|why| tiled::failed(&path, why))?;
            planned(args, &options, &folder)?.len()
        }
        Work::Away(away) => {
            away.check_free()?;
            let tiling = planned(args, &options, away.folder())?;
            let tiles = tiling.len();
            away.put_plan(tiling)?;
            tiles
        }
    };
    files::print(&format!("{tiles}\n"))
}

/// Plans tiles in a folder.
fn planned(args: &PlanArgs, options: &Options, folder: &Folder) -> Result<Tiling, CliError> {
    let fail = |why: TilesError| tiled::failed(&args.input, why);
    temp_files_in(folder.path())?;
    let (model, progress) = (args.engine.model()?, TileProgress::new(args.quiet));
    let (name, runner) = (model.name(), args.engine.runner(model)?);
    let reader = files::open(&args.input, &options.reading)?;
    let tile_points = args.size.points(options, reader.header())?;
    // However few points there are, they are tiles here.
    let input = match Input::read(reader, 0).map_err(|why| CliError::file(&args.input, why))? {
        Input::Large(large) => *large,
        Input::Small(..) => return Err(CliError::file(&args.input, "there are no points")),
    };
    let work =
        densecloud_tiles::Work { options, model: &name, runner: &*runner, tile_points, watch: &progress };
    let tiling = plan(input, &work, folder).map_err(fail)?;
    progress.finish();
    super::warn(&tiling.report().warnings, args.quiet);
    Ok(tiling)
}

fn run_tiles(args: &RunArgs) -> Result<(), CliError> {
    let fail = |why: TilesError| tiled::failed(&args.folder, why);
    let work = Work::at(&args.folder, &args.away)?;
    let tiling = match &work {
        Work::Here(path) => Tiling::load(&Folder::at(path)).map_err(fail)?,
        Work::Away(away) => away.load()?,
    };
    let model = args.engine.model()?;
    tiling.check(&model.name()).map_err(fail)?;
    let runner = args.engine.runner(model)?;
    let tiles = match &work {
        _ if !args.tiles.is_empty() => args.tiles.clone(),
        Work::Here(_) => tiling.not_done().map_err(fail)?,
        Work::Away(away) => away.not_done(&tiling)?,
    };
    tiles.into_iter().try_for_each(|tile| match &work {
        Work::Here(_) => tiling.run(tile, &*runner, &densecloud_cascade::Silent).map(drop).map_err(fail),
        Work::Away(away) => away.run(&tiling, tile, &*runner),
    })
}

fn join_tiles(args: &JoinArgs) -> Result<(), CliError> {
    places::check(&[&args.output])?;
    let fail = |why: TilesError| tiled::failed(&args.folder, why);
    let work = Work::at(&args.folder, &args.away)?;
    let (tiling, temp) = match &work {
        Work::Here(path) => (Tiling::load(&Folder::at(path)).map_err(fail)?, path.as_path()),
        Work::Away(away) => (away.with_parts()?, away.folder().path()),
    };
    temp_files_in(temp)?;
    check_name(&args.output, tiling.report().format)?;
    let join = tiling.join().map_err(fail)?;
    super::warn(&join.report().warnings[tiling.report().warnings.len()..], args.quiet);
    tiled::write(join, &args.output)?;
    Ok(())
}

fn remove_tiles(args: &RemoveArgs) -> Result<(), CliError> {
    match Work::at(&args.folder, &args.away)? {
        Work::Away(away) => away.remove(),
        Work::Here(path) if !Folder::at(&path).has_plan() => {
            Err(CliError::file(&path, "no tiles are planned there"))
        }
        Work::Here(path) => Folder::at(&path).remove_plan().map_err(|why| tiled::failed(&path, why)),
    }
}

/// Refuses a name of another format than that of the result.
fn check_name(output: &Path, format: Format) -> Result<(), CliError> {
    match Format::of_output(output) {
        Ok(Some(named)) if !named.is_named_like(format) => Err(CliError::Usage(format!(
            "{}: the tiles are planned for {format}; plan them with `--for` and this name",
            output.display()
        ))),
        _ => Ok(()),
    }
}
