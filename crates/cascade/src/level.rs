//! One level: patches through one unit, merged and resampled.

use super::globals::Globals;
use super::measured::Reference;
use super::part::Within;
use super::patches::Patches;
use super::plan::Quality;
use super::polish::{Polish, Sizes};
use super::runner::{FeatureTable, LevelInput, LevelOutput, LevelRunner};
use super::share::{Neighbourhoods, Spread, sample};
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
pub(super) struct Level {
    /// From 0.
    pub(super) number: usize,
    /// Points of its result.
    pub(super) size: usize,
    /// Whether nothing follows, so that features are not needed.
    pub(super) last: bool,
}

/// What one level hands to the next.
pub(super) struct Handover {
    /// The level's result, distinct, in local coordinates.
    pub(super) points: Vec<Point>,
    /// For each point the spacing of the input there; none before the first level, and where the whole is to be equally
    /// dense.
    pub(super) local: Option<Vec<f32>>,
    /// Features for the next level; none before the first level, and where there is none.
    pub(super) previous: Option<Previous>,
    /// The cascade's input, to measure strays against; none before the first level, whose input it is.
    pub(super) reference: Option<Reference>,
    /// Points of the last level's result that lie just outside of what was wanted of a part.
    pub(super) rim: Vec<Point>,
}

impl Handover {
    /// The cascade's input, to its first level.
    pub(super) fn input(points: Vec<Point>) -> Self {
        Self { points, local: None, previous: None, reference: None, rim: Vec::new() }
    }
}

/// What a level leaves of its input: the points and their features.
pub(super) struct Previous {
    points: Vec<Point>,
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

impl Level {
    /// Runs the level on what the one before it gave.
    pub(super) fn run(
        self,
        Handover { points, local, previous, reference, .. }: Handover,
        run: &Run<'_>,
        globals: &mut Globals,
    ) -> Result<Handover, CascadeError> {
        let Self { number, size, last } = self;
        let Run { options, runner, observer, part } = *run;
        let size = part.map_or(size, |part| part.size_of_level(points.len(), number, last));
        let neighbourhoods = match (&reference, options.spread) {
            (None, Spread::Neighbourhood) => {
                let field = globals.field.clone();
                Some(Neighbourhoods::of(&points, &mut globals.usual_point, field.as_deref())?)
            }
            _ => None,
        };
        let local = local.or_else(|| neighbourhoods.as_ref().map(|of| of.spacing.clone()));
        // Each level draws from its own stream, so that a ratio's levels do not depend on how many
        // follow.
        let mut random = Rng::new(options.seed.wrapping_add((number as u64) << 32));
        let patches = Patches::cover(
            &points,
            local.as_deref(),
            runner.shape().patch_size,
            options,
            &mut random,
            number,
            observer,
        )?;
        let skip =
            previous.as_ref().map(|p| SkipNeighbours::find(&p.points, &p.rows, &points)).transpose()?;

        observer.begin(number, Stage::Units);
        let unit = number.min(runner.units() - 1);
        let input = LevelInput {
            unit,
            points: &points,
            patches: &patches,
            skip: skip.as_ref(),
            want_features: !last,
        };
        let table = previous.as_ref().map(|p| &p.features);
        let LevelOutput { made, features } = runner.run_level(&input, table, observer)?;
        let (rows, spacing) = patches.into_rows_and_spacing();
        // The features that this level read are what takes most memory: gone before sampling begins.
        drop((previous, skip));
        let reference =
            reference.unwrap_or_else(|| Reference::new(&points, spacing, neighbourhoods, globals));
        let doubled = 2 * points.len();
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
            let why = "it made points that are not finite; the model is unusable".into();
            return Err(BackendError::Run { unit: unit + 1, why }.into());
        }
        let previous = features.map(|features| Previous { points, rows, features });

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
            return Ok(Handover { rim, ..Handover::input(points) });
        }
        let local = reference.local(&merged.nearest);
        if let (Some(part), true) = (part, last) {
            let (points, rim) = part.choose(&merged.points, local)?;
            return Ok(Handover { rim, ..Handover::input(points) });
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
        let merged = merged.points;
        let local = local.map(|local| kept.iter().map(|&i| local[i as usize]).collect());
        let points = kept.iter().map(|&i| merged[i as usize]).collect();
        Ok(Handover { local, previous, reference: (!last).then_some(reference), ..Handover::input(points) })
    }
}
