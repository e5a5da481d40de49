//! From a cloud of any size to tiles: two passes, the second over the disk.

mod measure;
mod places;
mod route;
mod sample;
mod sizes;
mod space;
mod spill;

use densecloud::survey::{Goal, SAMPLE, Survey};
use densecloud::{Outline, Outlined, check_rules, survey};
use densecloud_cascade::{CascadeError, Spread, Target, Whole, halo};
use densecloud_cloud::{Attribute, Facts, Frame, FrameError, Position};
use densecloud_geometry::Partition;

use crate::chunk::KindName;
use crate::disk::write_whole;
use crate::input::{Large, check_format, empty, kept};
use crate::manifest::{Causes, Column, Manifest, Tile, nodes};

use crate::tiling::Tiling;
use crate::{Folder, Step, TilesError, Work, origin};
use measure::{Measured, measure};
use places::Places;
use route::Router;
use sample::Spacings;
use spill::Spilled;

/// The first points of a result are wanted soon: the first tile is halved so often at most, and to no fewer points.
const GRADES: u32 = 3;
const FIRST: u64 = 25_000;

/// Bytes of a point in our files beside its attributes: its coordinates and its row.
pub(crate) const BARE: u64 = 28;

/// Plans the tiles of a cloud in a folder, which is empty or holds what is left of another plan. The plan depends on the
/// cloud's points, their order, the options, the model and the points of a tile; not on the number of threads, nor on how
/// the input comes.
///
/// Cost: reading the cloud, writing it to the disk twice and reading it back; upsampling some places of it. Memory: some
/// hundred megabytes at most.
///
/// # Errors
/// [`TilesError`].
pub fn plan(input: Large<'_>, work: &Work<'_>, folder: &Folder) -> Result<Tiling, TilesError> {
    check_format(&input.header, work.options, work.tile_points)?;
    folder.clear()?;
    space::check_before(&input, work, folder)?;
    folder.prepare()?;
    work.watch.step(Step::Read);
    let spilled = Spilled::read(input, folder, work.watch)?;
    let attributes = empty(&spilled.ending.columns);
    check_rules(work.options, &attributes)?;
    // Before the sample, which has an extent where this has none.
    if spilled.finite == 0 {
        return Err(CascadeError::from(FrameError::NotFinite).into());
    }
    work.watch.step(Step::Cut);
    let ratio = likely_ratio(work, &spilled)?;
    space::check_after(&spilled, &attributes, ratio, work, folder)?;
    let cells = spilled.finite.div_ceil(work.tile_points.max(1)) as usize;
    let each = spilled.finite / cells as u64;
    let grades = (1..=GRADES).rev().find(|grades| (each >> grades) >= FIRST).unwrap_or(0);
    let partition = Partition::graded(rounded(&spilled)?, cells, grades);
    let mut places = Places::choose(&spilled.sample, spilled.finite);
    spilled.each(folder, false, |_, block| {
        places.see(&block.positions);
        Ok(())
    })?;
    let places = places.positions();
    let survey = |ratio: f64| {
        let (bounds, finite) = (spilled.bounds, spilled.finite);
        let survey =
            densecloud_cascade::Survey { bounds, finite, sample: &spilled.sample, places: &places, ratio };
        Whole::survey(&survey, &work.options.cascade, work.runner, work.watch)
    };
    let whole = survey(ratio)?;
    let spacings = Spacings::of(&spilled.sample, spilled.finite).map_err(CascadeError::from)?;
    let columns = &spilled.ending.columns;
    let mut router = Router::new(folder, &partition, columns, &spacings, halo(&whole));
    spilled.each(folder, true, |first, block| {
        if work.watch.cancelled() {
            return Err(CascadeError::Cancelled.into());
        }
        router.add(first, block)
    })?;
    let counts = router.finish()?;
    drop(spacings);
    let decided = Decided::of(work, &spilled, &attributes, folder, &counts)?;
    let exact = decided.total as f64 / spilled.finite as f64;
    let whole = if exact == ratio { whole } else { survey(exact)? };
    let manifest = manifest(work, &spilled, &attributes, &partition, &decided, &counts);
    store(folder, &spilled, &attributes, &decided, &whole, &manifest)?;
    Tiling::of(folder, manifest, whole, decided.outlined.report.origin)
}

/// The sample as the cascade has it, in 32 bits of the local frame: boxes whose faces are such numbers have the same points
/// before and after that.
fn rounded(spilled: &Spilled) -> Result<Vec<Position>, CascadeError> {
    let frame = Frame::fit(&spilled.bounds)?;
    Ok(spilled.sample.iter().map(|p| frame.to_world(frame.to_local(*p))).collect())
}

/// Points out for each finite point in, as far as is known before there are tiles: a spacing or a density is about that.
fn likely_ratio(work: &Work<'_>, spilled: &Spilled) -> Result<f64, TilesError> {
    let finite = spilled.finite;
    let of = |target: Target| target.points_out(finite).map(|points| points as f64 / finite as f64);
    match work.options.goal {
        Goal::Target(target) => Ok(of(target)?),
        goal => {
            // Of the surface that the sample shows, but of all points.
            let survey = || {
                let survey = Survey::of(&spilled.sample, SAMPLE)?;
                Ok::<_, FrameError>(Survey { finite: finite as usize, ..survey })
            };
            match goal.target_by(survey) {
                Ok(target) => Ok(of(target)?),
                Err(survey::GoalError::OutOfRange { points, .. }) => {
                    Ok((points / finite as f64).clamp(1.0, f64::from(densecloud_cascade::MAX_RATIO)))
                }
                Err(why) => Err(densecloud::PrepareError::from(why).into()),
            }
        }
    }
}

/// What is decided once there are tiles.
struct Decided {
    outlined: Outlined,
    sizes: Vec<u64>,
    total: u64,
}

impl Decided {
    fn of(
        work: &Work<'_>,
        spilled: &Spilled,
        attributes: &[Attribute],
        folder: &Folder,
        counts: &[[u64; 2]],
    ) -> Result<Self, TilesError> {
        let options = work.options;
        let by_area = options.cascade.spread == Spread::Area;
        let needs_area = by_area || !matches!(options.goal, Goal::Target(_));
        let sample = if needs_area { SAMPLE } else { survey::GLANCE };
        let Measured { survey, areas } = measure(folder, counts, spilled, sample, needs_area)?;
        let target = options.goal.target_by(|| Ok(survey.clone()));
        let target = target.map_err(densecloud::PrepareError::from)?;
        let total = target.points_out(spilled.finite)?;
        let own: Vec<u64> = counts.iter().map(|count| count[0]).collect();
        let sizes = match by_area {
            true => sizes::by_area(&own, &areas, total),
            false => sizes::by_points(&own, total),
        };
        let facts = facts(spilled);
        let outline = Outline {
            attributes,
            facts: &|i| facts[i],
            origin: &spilled.ending.origin,
            told: told(spilled),
            points: spilled.points,
            is_finite: spilled.finite == spilled.points,
            target,
            survey: Some(survey),
            // One tile is worked on as a cloud that is in none.
            tile_points: (counts.len() > 1).then_some(work.tile_points),
        };
        let mut outlined = outline.outlined(spilled.header.format, options, work.model);
        // Kept points are not the first of the result then, so whatever counts them is of no use.
        let lost = if counts.len() > 1 { outlined.report.origin.drop_references() } else { Vec::new() };
        if !lost.is_empty() {
            let lost = format!("not carried over: {} (about the input's points)", lost.join(", "));
            outlined.report.warnings.push(lost);
        }
        Ok(Self { outlined, sizes, total })
    }
}

/// What the numbers of each attribute are like.
fn facts(spilled: &Spilled) -> Vec<Facts> {
    let pairs = spilled.facts.iter().zip(&spilled.ending.columns);
    pairs.filter(|(_, column)| column.is_some()).map(|(seen, _)| seen.facts()).collect()
}

/// What a person should know about how the cloud was read.
fn told(spilled: &Spilled) -> Vec<String> {
    let (dropped_properties, notes) =
        (spilled.ending.dropped_properties.clone(), spilled.ending.notes.clone());
    densecloud_cloud::Cloud { dropped_properties, notes, ..Default::default() }.warnings()
}

fn manifest(
    work: &Work<'_>,
    spilled: &Spilled,
    attributes: &[Attribute],
    partition: &Partition,
    decided: &Decided,
    counts: &[[u64; 2]],
) -> Manifest {
    let Outlined { report, adaptation, .. } = &decided.outlined;
    let column = |(attribute, facts): (&Attribute, Facts)| Column {
        name: attribute.name.clone(),
        kind: KindName(attribute.values.kind()),
        repeats: facts.repeats,
        is_flag: facts.is_flag,
    };
    let tile = |(count, size): (&[u64; 2], &u64)| Tile { own: count[0], around: count[1], size: *size };
    Manifest {
        causes: causes(work, spilled.ending.origin.sha256),
        points: spilled.points,
        finite: spilled.finite,
        columns: attributes.iter().zip(facts(spilled)).map(column).collect(),
        adapted: adaptation.columns.iter().map(|(place, kind, by)| (*place, KindName(*kind), *by)).collect(),
        cells: nodes(partition),
        tiles: counts.iter().zip(&decided.sizes).map(tile).collect(),
        format: report.format,
        provenance: report.provenance.clone(),
        warnings: report.warnings.clone(),
    }
}

/// What decides a plan for an input of that hash.
pub(crate) fn causes(work: &Work<'_>, input: Option<[u8; 32]>) -> Causes {
    Causes {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        model: [work.model.name.clone(), work.model.sha256.clone()],
        options: densecloud::Options { format: None, ..work.options.clone() },
        wanted: work.options.format,
        tile_points: work.tile_points,
        input: input.map(hex::encode),
    }
}

/// Writes what another program needs: the manifest last, since that is what makes a plan.
fn store(
    folder: &Folder,
    spilled: &Spilled,
    attributes: &[Attribute],
    decided: &Decided,
    whole: &Whole,
    manifest: &Manifest,
) -> Result<(), TilesError> {
    write_whole(&folder.whole(), &whole.to_bytes())?;
    let example = &spilled.example;
    let values = kept(example.columns.clone(), &spilled.ending.columns);
    let of = |(attribute, values): (&Attribute, _)| Attribute { name: attribute.name.clone(), values };
    let attributes: Vec<Attribute> = attributes.iter().zip(values).map(of).collect();
    let origin = &decided.outlined.report.origin;
    origin::store(folder, origin, spilled.header.format, (example, &attributes))?;
    let path = folder.manifest();
    let json =
        serde_json::to_vec_pretty(manifest).map_err(|why| TilesError::broken(&path, why.to_string()))?;
    write_whole(&path, &json)
}
