//! `densecloud upsample --dry-run`: what a work would come to.

use std::time::Duration;

use densecloud::Prepared;
use densecloud::survey::Goal;
use densecloud_cascade::{CascadeError, Demand};
use densecloud_cloud::{Attribute, Position};
use densecloud_engine::{Cost, Engine};
use densecloud_tiles::Input;

use super::engine_args::Machine;
use super::events::{Estimate, Event};
use super::upsample::{UpsampleArgs, refused};
use super::{CliError, files, short, tiled};

/// Bytes of a point's position.
const POSITION: u64 = size_of::<Position>() as u64;

/// Reads the input, and tells of the work on it. Writes nothing.
pub(super) fn run(args: &UpsampleArgs, machine: &Machine<'_>) -> Result<(), CliError> {
    let estimate = estimate(args, machine)?;
    super::warn(&estimate.warnings, args.quiet);
    let (input, output) = (&*args.input, &*args.output);
    if !args.events.0 {
        return files::print(&format!("{} -> {}: {}\n", input.display(), output.display(), words(&estimate)));
    }
    args.events.tell(&Event::Estimate { input, output, estimate: &estimate })
}

fn estimate(args: &UpsampleArgs, machine: &Machine<'_>) -> Result<Estimate, CliError> {
    let options = args.settled()?;
    let reader = files::open(&args.input, &options.reading)?;
    let tile_points = args.tiles.size.points(&options, reader.header())?;
    match Input::read(reader, tile_points).map_err(|why| CliError::file(&args.input, why))? {
        Input::Small(mut cloud, header) => {
            if let Some(before) = args.clean {
                before.clean(&mut cloud, &args.input, args.quiet)?;
            }
            let fail = |why: CascadeError| CliError::file(&args.input, why);
            let held = held(cloud.positions.len(), &cloud.attributes);
            let model = machine.model()?;
            let prepared = Prepared::new(*cloud, header.format, options.clone(), &model.name());
            let Prepared { request, report } = prepared.map_err(|error| refused(&args.input, &error))?;
            let (positions, shape) = (&request.cloud.positions, model.shape());
            densecloud_cascade::check(positions, request.target, &options.cascade, shape).map_err(fail)?;
            let made = POSITION + options.finish.bytes_a_point(&request.cloud.attributes);
            let cost = Engine::cost(&request).map_err(|why| CliError::file(&args.input, why))?;
            Ok(Estimate {
                points_in: report.points_in,
                points_out: Some(report.points_out),
                seconds: seconds(machine, cost)?,
                bytes: cost.memory(Demand::default()) + held + report.points_out * made,
                in_tiles: false,
                warnings: report.warnings,
            })
        }
        Input::Large(large) => {
            args.refuse_in_tiles()?;
            let found = large.check(&options, tile_points).map_err(|why| tiled::failed(&args.input, why))?;
            let points_out = options.points_out(found.finite);
            let cost = Cost::new(found.finite, points_out).in_parts(tile_points).times(options.effort());
            let is_known = matches!(options.goal, Goal::Target(_));
            Ok(Estimate {
                points_in: found.points,
                points_out: is_known.then_some(points_out),
                seconds: if is_known { seconds(machine, cost)? } else { None },
                bytes: cost.memory(Demand::default()),
                in_tiles: true,
                warnings: vec![
                    "it is worked on in tiles; what else is to be known is told when these are cut".into(),
                ],
            })
        }
    }
}

/// Bytes of a cloud in memory.
fn held(points: usize, attributes: &[Attribute]) -> u64 {
    let attributes: u64 = attributes.iter().map(|one| one.values.kind().size() as u64).sum();
    points as u64 * (POSITION + attributes)
}

/// How long it takes on this machine, which is measured once.
fn seconds(machine: &Machine<'_>, cost: Cost) -> Result<Option<f64>, CliError> {
    let engine = machine.measured()?;
    Ok(engine.estimate(cost).as_ref().map(Duration::as_secs_f64))
}

fn words(estimate: &Estimate) -> String {
    let points =
        |points: Option<u64>| points.map_or("as many as the surface needs".to_owned(), |n| n.to_string());
    let time = estimate.seconds.map_or(String::new(), |seconds| format!(", about {} s", short(seconds)));
    let tiles = if estimate.in_tiles { ", in tiles" } else { "" };
    let (from, to) = (estimate.points_in, points(estimate.points_out));
    format!("{from} -> {to} points{time}, about {} MB of memory{tiles}", short(estimate.bytes as f64 / 1e6))
}
