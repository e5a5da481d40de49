//! One level: patches through one unit, merged and resampled.

use std::sync::Arc;

use super::globals::Globals;
use super::measured::{Measured, Reference};
use super::part::Within;
use super::patches::Patches;
use super::plan::Quality;
use super::polish::{Polish, Sizes};
use super::runner::{FeatureTable, LevelInput, LevelOutput, LevelRunner};
use super::share::{Neighbourhoods, Spread, sample};
use super::sites::Sites;
use super::skip::SkipNeighbours;
use super::strays::{StrayLimits, without_strays};
use super::{BackendError, CascadeError, CascadeOptions, Observer, Stage};
use densecloud_cloud::Point;
use densecloud_geometry::Rng;

/// The share of a level's size that is enough where a polish follows, which chooses among midpoints: the level does
/// without the rest rather than take the worst strays for it.
const ENOUGH: f64 = 0.75;
/// The share that the last level then has at least: its size may exceed twice the size of the one before it by a quarter.
const FEWEST: f64 = 0.5;

/// One level about to run.
struct Level {
    /// From 0.
    number: usize,
    /// Points of its result.
    size: usize,
    /// Whether nothing follows, so that features are not needed.
    last: bool,
}

/// What one level hands to the next.
pub(super) struct Handover {
    /// The level's result, distinct, in local coordinates.
    pub(super) sites: Arc<Sites>,
    /// For each point the spacing of the input there; none where the whole is to be equally dense.
    pub(super) local: Option<Vec<f32>>,
    /// Features for the next level; none before the first level.
    previous: Option<Previous>,
    /// The cascade's input, to measure strays against.
    reference: Reference,
}

impl Handover {
    /// The cascade's input, to its first level.
    pub(super) fn input(
        input: Measured,
        spread: Spread,
        globals: &mut Globals,
    ) -> Result<Self, CascadeError> {
        let field = globals.field.clone();
        let neighbourhoods = match spread {
            Spread::Neighbourhood => {
                Some(Neighbourhoods::of(&input, &mut globals.usual_point, field.as_deref())?)
            }
            Spread::Area => None,
        };
        let local = neighbourhoods.as_ref().map(|of| of.spacing.clone());
        let sites = Arc::clone(&input.sites);
        Ok(Self { sites, local, previous: None, reference: Reference::new(input, neighbourhoods, globals) })
    }
}

/// What a level gives.
enum Given {
    /// A level follows.
    Next(Handover),
    /// The result, distinct, in local coordinates; and points that lie just outside of what was wanted of a part.
    Last(Vec<Point>, Vec<Point>),
}

/// What a level leaves of its input: the points and their features.
struct Previous {
    sites: Arc<Sites>,
    /// Each point's row in the table.
    rows: Vec<u32>,
    features: FeatureTable,
}

/// What all levels of one run share.
pub(super) struct Run<'a> {
    pub(super) options: &'a CascadeOptions,
    pub(super) runner: &'a dyn LevelRunner,
    pub(super) observer: &'a dyn Observer,
    /// Where the input is a part of a cloud, which of it is wanted.
    pub(super) part: Option<&'a Within<'a>>,
}

/// Runs all levels on the cascade's input: the result, and points that lie just outside of what was wanted of a part.
pub(super) fn run_levels(
    mut handover: Handover,
    run: &Run<'_>,
    globals: &mut Globals,
) -> Result<(Vec<Point>, Vec<Point>), CascadeError> {
    let levels = globals.sizes.len();
    let mut number = 0;
    loop {
        let level = Level { number, size: globals.sizes[number], last: number + 1 == levels };
        match level.run(handover, run, globals)? {
            Given::Next(next) => handover = next,
            Given::Last(points, rim) => return Ok((points, rim)),
        }
        number += 1;
    }
}

impl Level {
    /// Runs the level on what the one before it gave.
    fn run(
        self,
        Handover { sites, local, previous, reference }: Handover,
        run: &Run<'_>,
        globals: &mut Globals,
    ) -> Result<Given, CascadeError> {
        let Self { number, size, last } = self;
        let Run { options, runner, observer, part } = *run;
        let size = part.map_or(size, |part| part.size_of_level(sites.points.len(), number, last));
        // Each level draws from its own stream, so that a ratio's levels do not depend on how many
        // follow.
        let mut random = Rng::new(options.seed.wrapping_add((number as u64) << 32));
        let patches = Patches::cover(
            &sites,
            local.as_deref(),
            runner.shape().patch_size,
            options,
            &mut random,
            number,
            observer,
        )?;
        let find = |p: &Previous| SkipNeighbours::find(&p.sites, &p.rows, &sites.points);
        let skip = previous.as_ref().map(find).transpose()?;

        observer.begin(number, Stage::Units);
        let unit = number.min(runner.units() - 1);
        let input = LevelInput {
            unit,
            points: &sites.points,
            patches: &patches,
            skip: skip.as_ref(),
            want_features: !last,
        };
        let table = previous.as_ref().map(|p| &p.features);
        let LevelOutput { made, features } = runner.run_level(&input, table, observer)?;
        let rows = patches.into_rows();
        // The features that this level read are what takes most memory: gone before sampling begins.
        drop((previous, skip));
        let doubled = 2 * sites.points.len();
        let share = |polished: f64| if options.polish { (polished * size as f64) as usize } else { size };
        let wanted = match options.quality {
            // Twice as many as are kept: none of the strayed need make up for what lacks.
            Quality::Best if last => size,
            _ if options.polish => doubled,
            _ => doubled.max(size),
        };
        let limits = StrayLimits {
            displacement: options.max_displacement as f32,
            distance: options.max_distance as f32,
            wanted,
            least: share(ENOUGH),
        };
        let mut merged = without_strays(&made, &limits, &reference, &mut globals.levels[number]);
        drop((made, local));
        if merged.points.len() < share(FEWEST) {
            if let Some(part) = part {
                part.suffices(merged.points.len())?;
            }
            let why = "it made points that are not finite; the model is unusable".into();
            return Err(BackendError::Run { unit: unit + 1, why }.into());
        }
        let previous = features.map(|features| Previous { sites, rows, features });

        observer.begin(number, Stage::Resample);
        if observer.cancelled() {
            return Err(CascadeError::Cancelled);
        }
        if let (Some(part), true) = (part, last) {
            part.trim(&mut merged, &reference.input.spacing, number + 1);
        }
        if last && options.polish {
            let sizes = Sizes { full: doubled.max(size), size: part.map_or(size, |part| part.unsettled()) };
            let polish = Polish { sizes, part, observer };
            let (points, rim) = polish.run(merged, reference, &mut globals.polish, &mut random)?;
            return Ok(Given::Last(points, rim));
        }
        let local = reference.local(&merged.nearest);
        if let (Some(part), true) = (part, last) {
            let (points, rim) = part.choose(&merged.points, local)?;
            return Ok(Given::Last(points, rim));
        }
        let first = random.below(merged.points.len() as u64) as usize;
        let mut kept = sample(&merged.points, local.as_deref(), size.min(merged.points.len()), first);
        if !last {
            // The order means nothing to the next level, and patch by patch neighbours are near in memory.
            kept.sort_unstable();
        }
        if let Some(part) = part {
            part.keep_near(&mut kept, &merged, &reference.input.spacing, number + 1);
        }
        let points: Vec<Point> = kept.iter().map(|&i| merged.points[i as usize]).collect();
        drop(merged);
        if last {
            return Ok(Given::Last(points, Vec::new()));
        }
        let local = local.map(|local| kept.iter().map(|&i| local[i as usize]).collect());
        Ok(Given::Next(Handover { sites: Arc::new(Sites::new(points)), local, previous, reference }))
    }
}
