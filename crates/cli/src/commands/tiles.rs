//! `densecloud tiles`: the steps of a work in tiles one by one, for many machines over one folder.

use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args, Subcommand};
use densecloud::Options;
use densecloud_formats::Format;
use densecloud_tiles::{Folder, Input, TilesError, Tiling, Work, plan};

use super::engine_args::EngineArgs;
use super::options::{GOALS, OptionArgs};
use super::tile_args::{SizeArgs, temp_files_in};
use super::tile_progress::TileProgress;
use super::{CliError, files, tiled};

/// Work on a large cloud in tiles, step by step: plan, run each, join.
#[derive(Debug, Args)]
#[command(after_help = "\
Tiles are numbered from 0. Each is run alone, in any order and by any number of programs at once; whatever is run again gives
the same. `densecloud upsample` takes the same steps, in a temporary folder.

Example:
  tiles=$(densecloud tiles plan scan.laz work --for dense.laz --ratio 4)
  seq 0 $((tiles - 1)) | xargs -P 2 -n 1 densecloud tiles run work
  densecloud tiles join work dense.laz")]
pub(super) struct TilesArgs {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    Plan(Box<PlanArgs>),
    Run(RunArgs),
    Join(JoinArgs),
}

/// Cut a cloud into tiles, and print how many there are
#[derive(Debug, Args)]
#[command(group = ArgGroup::new(GOALS))]
struct PlanArgs {
    /// The sparse cloud, as of `densecloud upsample`; `-` for standard input
    input: PathBuf,

    /// A new or empty folder for the tiles
    folder: PathBuf,

    /// The name that the result will have, for its format; without it, the input's format
    #[arg(long = "for", value_name = "NAME")]
    name: Option<PathBuf>,

    #[command(flatten)]
    options: OptionArgs,

    #[command(flatten)]
    size: SizeArgs,

    /// Say nothing but errors
    #[arg(short, long)]
    quiet: bool,

    #[command(flatten)]
    engine: EngineArgs,
}

/// Make the parts of tiles
#[derive(Debug, Args)]
struct RunArgs {
    /// The folder in which they are planned
    folder: PathBuf,

    /// The numbers of the tiles; without any, all that are not done
    tiles: Vec<u32>,

    #[command(flatten)]
    engine: EngineArgs,
}

/// Join the parts of all tiles
#[derive(Debug, Args)]
struct JoinArgs {
    /// The folder in which they lie
    folder: PathBuf,

    /// The dense cloud, in the format that it was planned for; `-` for standard output
    output: PathBuf,

    /// Say nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

pub(super) fn run(args: &TilesArgs) -> Result<(), CliError> {
    match &args.step {
        Step::Plan(args) => plan_tiles(args),
        Step::Run(args) => run_tiles(args),
        Step::Join(args) => join_tiles(args),
    }
}

fn plan_tiles(args: &PlanArgs) -> Result<(), CliError> {
    let options = args.options.options()?;
    let format = match &args.name {
        Some(name) => files::wanted_from(&args.input, name, &options.reading)?,
        None => None,
    };
    let options = Options { format, ..options };
    let fail = |why: TilesError| tiled::failed(&args.input, why);
    let folder = Folder::new(&args.folder).map_err(fail)?;
    temp_files_in(&args.folder)?;
    let (model, progress) = (args.engine.model()?, TileProgress::new(args.quiet));
    let (name, runner) = (model.name(), args.engine.runner(model)?);
    let reader = files::open(&args.input, &options.reading)?;
    let tile_points = args.size.points(&options, reader.header())?;
    // However few points there are, they are tiles here.
    let input = match Input::read(reader, 0).map_err(|why| CliError::file(&args.input, why))? {
        Input::Large(large) => *large,
        Input::Small(..) => return Err(CliError::file(&args.input, "there are no points")),
    };
    let work = Work { options: &options, model: &name, runner: &*runner, tile_points, watch: &progress };
    let tiling = plan(input, &work, &folder).map_err(fail)?;
    progress.finish();
    super::warn(&tiling.report().warnings, args.quiet);
    files::print(&format!("{}\n", tiling.len()))
}

fn run_tiles(args: &RunArgs) -> Result<(), CliError> {
    let fail = |why: TilesError| tiled::failed(&args.folder, why);
    let folder = Folder::at(&args.folder);
    let tiling = Tiling::load(&folder).map_err(fail)?;
    let model = args.engine.model()?;
    tiling.check(&model.name()).map_err(fail)?;
    let runner = args.engine.runner(model)?;
    let tiles = if args.tiles.is_empty() { tiling.not_done().map_err(fail)? } else { args.tiles.clone() };
    for tile in tiles {
        tiling.run(tile, &*runner, &densecloud_cascade::Silent).map_err(fail)?;
    }
    Ok(())
}

fn join_tiles(args: &JoinArgs) -> Result<(), CliError> {
    let fail = |why: TilesError| tiled::failed(&args.folder, why);
    let folder = Folder::at(&args.folder);
    let tiling = Tiling::load(&folder).map_err(fail)?;
    temp_files_in(&args.folder)?;
    check_name(&args.output, tiling.report().format)?;
    let join = tiling.join().map_err(fail)?;
    super::warn(&join.report().warnings[tiling.report().warnings.len()..], args.quiet);
    tiled::write(join, &args.output)?;
    Ok(())
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
