//! `densecloud upsample` of a cloud that is too large for one tile.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use densecloud::{Options, Report};
use densecloud_backends::Model;
use densecloud_tiles::{Folder, Join, Large, TilesError, Tiling, Work, plan};

use super::events::Made;
use super::tile_progress::TileProgress;
use super::upsample::{UpsampleArgs, refused, write_provenance};
use super::{CliError, files};

pub(super) fn run(
    args: &UpsampleArgs,
    options: &Options,
    input: Large<'static>,
    tile_points: u64,
    model: Arc<Model>,
    start: Instant,
) -> Result<Made, CliError> {
    let (parent, name) = (args.tiles.parent(), model.name());
    let fail = |why| failed(&args.input, why);
    let folder = if args.resume {
        Folder::kept(&parent, &absolute(&args.output)).map_err(fail)?
    } else {
        Folder::temporary(&parent).map_err(fail)?
    };
    let (runner, progress) =
        (args.engine.runner(model)?, TileProgress::new(args.quiet).told(args.events, &args.input));
    let work = Work { options, model: &name, runner: &*runner, tile_points, watch: &progress };
    let tiling = match folder.has_plan() {
        true => Tiling::resumed(input, &work, &folder),
        false => plan(input, &work, &folder),
    };
    let tiling = tiling.map_err(fail)?;
    super::warn(&tiling.report().warnings, args.quiet);
    let (told, tiles) = (tiling.report().warnings.len(), tiling.len());
    let report = flow(&Arc::new(tiling), &work, args)?;
    progress.finish();
    super::warn(&report.warnings[told..], args.quiet);
    write_provenance(&report, &args.output)?;
    // What is gone on with stays until it is done.
    if args.resume {
        folder.remove().map_err(fail)?;
    }
    if !args.quiet {
        let (from, to, seconds) = (report.points_in, report.points_out, start.elapsed().as_secs_f64());
        super::note(&format!("{from} -> {to} points in {seconds:.1} s ({tiles} tiles)"));
    }
    Ok(Made { tiles: Some(tiles as usize), ..Made::of(&report) })
}

/// Runs the tiles, and writes the result as it comes.
fn flow(tiling: &Arc<Tiling>, work: &Work<'_>, args: &UpsampleArgs) -> Result<Report, CliError> {
    let (mut report, mut failure) = (None, None);
    let written = files::write(&args.output, |sink| {
        match tiling.run_into(work, sink) {
            Ok(made) => report = Some(made),
            // Of what is written: the input has been read.
            Err(TilesError::Format(why)) => return Err(why.into()),
            Err(why) => failure = Some(failed(&args.input, why)),
        }
        failure.as_ref().map_or(Ok(()), |_| Err("there is no result".into()))
    });
    failure.map_or(written, Err)?;
    report.ok_or_else(|| CliError::Failed("there is no result".into()))
}

/// Writes what is joined, and where it comes from beside it if need be.
pub(super) fn write(join: Join<'_>, output: &Path) -> Result<Report, CliError> {
    let report = join.report().clone();
    files::write(output, |sink| Ok(join.write(sink).map(drop)?))?;
    write_provenance(&report, output)?;
    Ok(report)
}

/// What went wrong with tiles of this input.
pub(super) fn failed(input: &Path, why: TilesError) -> CliError {
    match why {
        TilesError::Prepare(why) => refused(input, &why),
        // They name their own files.
        TilesError::File { .. }
        | TilesError::Broken { .. }
        | TilesError::NoSpace { .. }
        | TilesError::Differs { .. }
        | TilesError::Busy(_)
        | TilesError::NotEmpty(_) => CliError::Failed(why.to_string()),
        TilesError::NotInParts { .. } | TilesError::NoTile { .. } => CliError::Usage(why.to_string()),
        why => CliError::file(input, why),
    }
}

/// An output's name, whatever folder a program is started in.
fn absolute(output: &Path) -> String {
    if let Some(name) = output.to_str().filter(|name| *name == "-" || name.contains("://")) {
        return name.to_owned();
    }
    std::path::absolute(output).unwrap_or_else(|_| output.to_owned()).display().to_string()
}
