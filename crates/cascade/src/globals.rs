//! Statistics of a whole cloud, which a part of it cannot compute alone.
//!
//! Each new point depends on the points around it, and on a few numbers of the whole cloud: the usual spacing, the usual
//! distance of strays, how clean the input is. All of those numbers, and the functions that compute them, are in this file.
//! A level that is given a filled [`Globals`] computes none of them anew.
//!
//! Three more things depend on the whole cloud and are not numbers; they stay with their algorithms: the order in which
//! farthest point sampling chooses, the random choice of its first points, and the exact sizes of levels.

use std::sync::Arc;

use crate::apart::PASSES;
use crate::part::Field;
use densecloud_cloud::{Frame, Point};

/// Every statistic of a whole cloud that the cascade uses. Each is `None` until its first use, which computes it; later
/// uses take it as it is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Globals {
    /// Between the file's coordinates and the local ones: [`Frame::fit`] over all finite points.
    pub(crate) frame: Frame,
    /// Points after each level, the target last: [`Plan`](crate::plan::Plan).
    pub(crate) sizes: Vec<usize>,
    /// The cloud's usual spacing, for each pass that looks for outliers: [`usual_spacing`].
    pub(crate) usual_spacings: [Option<f32>; PASSES],
    /// How even the input is: [`evenness`].
    pub(crate) evenness: Option<f32>,
    /// The logarithm of the area that an input point usually has: [`usual_logarithm`].
    pub(crate) usual_point: Option<f32>,
    /// How dense the whole is, coarsely: for parts of it alone.
    pub(crate) field: Option<Arc<Field>>,
    /// What each level made, from the first.
    pub(crate) levels: Vec<LevelGlobals>,
    /// What the polish of the last level goes by.
    pub(crate) polish: PolishGlobals,
}

/// Statistics of what one level's unit made.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct LevelGlobals {
    /// The distance from the input that most points keep: [`usual_distance`].
    pub(crate) usual_distance: Option<f32>,
    /// How far a point may stray, in multiples of its limits: [`most_strayed`].
    pub(crate) most_strayed: Option<f32>,
}

/// Statistics of the last level's polish.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct PolishGlobals {
    /// From 0, where the input is noisy, to 1, where it is clean: [`trust`].
    pub(crate) trust: Option<f32>,
    /// Input points for each point of the sample whose midpoints are the candidates.
    pub(crate) input_a_sample: Option<f32>,
    /// Midpoints of that sample.
    pub(crate) midpoints: Option<usize>,
    /// The logarithm of the area that an input point usually has on the surface that the units made: [`usual_logarithm`].
    pub(crate) usual_point: Option<f32>,
    /// The usual area of an input point's surroundings: [`median`].
    pub(crate) usual_area: Option<f32>,
    /// The usual number of points chosen for its share of the area: [`median`].
    pub(crate) usual_density: Option<f32>,
}

impl Globals {
    /// Before the first level: nothing is known but the frame.
    pub(crate) fn new(frame: Frame) -> Self {
        Self {
            frame,
            sizes: Vec::new(),
            usual_spacings: [None; PASSES],
            evenness: None,
            usual_point: None,
            field: None,
            levels: Vec::new(),
            polish: PolishGlobals::default(),
        }
    }

    /// Takes the sizes of the levels.
    pub(crate) fn plan(&mut self, sizes: Vec<usize>) {
        self.levels.resize(sizes.len(), LevelGlobals::default());
        self.sizes = sizes;
    }
}

/// A statistic: the one that is known, or else `computed` once.
pub(crate) fn once<T: Copy>(known: &mut Option<T>, computed: impl FnOnce() -> T) -> T {
    *known.get_or_insert_with(computed)
}

/// The spacing that half of the points are below.
pub(crate) fn usual_spacing(spacings: &[f32]) -> f32 {
    nth(&mut spacings.to_vec(), spacings.len() / 2)
}

/// The logarithm of the mean of some areas.
pub(crate) fn usual_logarithm(areas: &[f32]) -> f32 {
    ((areas.iter().copied().map(f64::from).sum::<f64>() / areas.len() as f64) as f32).ln()
}

/// Variation of the distances to the nearest other, in the spacing there: even samples have 0.07 to 0.1, random ones 0.39
/// to 0.44.
const EVEN: f32 = 0.15;
const RANDOM: f32 = 0.35;

/// How even a sample is, from 0, as a random one, to 1: by the coefficient of variation of its points' distances to the
/// nearest other, in the spacing there.
pub(crate) fn evenness(nearest: impl Iterator<Item = f32>) -> f32 {
    let (mut count, mut sum, mut squares) = (0.0_f64, 0.0, 0.0);
    for distance in nearest.map(f64::from) {
        count += 1.0;
        sum += distance;
        squares += distance * distance;
    }
    let mean = sum / count;
    let variation = (squares / count - mean * mean).max(0.0).sqrt() / mean;
    let variation = if variation.is_finite() { variation as f32 } else { 0.0 };
    1.0 - ((variation - EVEN) / (RANDOM - EVEN)).clamp(0.0, 1.0)
}

/// The share of a level's points that is taken to lie where it should.
const SOUND: f64 = 0.9;

/// The distance from the input, in its spacing, that [`SOUND`] of a level's points keep; 0 where no point is finite.
pub(crate) fn usual_distance(distances: impl Iterator<Item = f32>) -> f32 {
    let mut sorted: Vec<f32> = distances.filter(|d| d.is_finite()).collect();
    let sound = (SOUND * sorted.len() as f64) as usize;
    if sound < sorted.len() { nth(&mut sorted, sound) } else { 0.0 }
}

/// A point that strays by more than this multiple of a limit is no near miss.
const WORSE: f32 = 1.5;

/// How far points may stray, in multiples of their limits: 1 where that leaves `size` points. Else as far as the `size`
/// least strayed do, but no further than [`WORSE`], unless that leaves fewer than `least`.
pub(crate) fn most_strayed(strayed: &[f32], size: usize, least: usize) -> f32 {
    if strayed.iter().filter(|s| **s <= 1.0).count() >= size {
        return 1.0;
    }
    // NaN comes last, and is below no limit.
    let mut sorted = strayed.to_vec();
    let mut nth_of = |size: usize| match sorted.get(size - 1) {
        Some(_) => nth(&mut sorted, size - 1).min(f32::INFINITY),
        None => f32::INFINITY,
    };
    nth_of(size).min(nth_of(least).max(WORSE))
}

/// Root mean square distance of clean input from the surface that the units make of it, in its spacing:
/// 0.01 to 0.036 on held-out shapes, even or random. Noise of 1 % of the shape leaves 0.055 and more.
const CLEAN: f32 = 0.035;

/// How far the input is to be trusted, from 0 to 1: by the `offsets` of its points from the surface that the units made of
/// them, in their spacing.
pub(crate) fn trust(offsets: &[Point], spacing: &[f32]) -> f32 {
    let square =
        |(o, spacing): (&Point, &f32)| f64::from(o.iter().map(|c| (c / spacing).powi(2)).sum::<f32>());
    // In f32 the sum over millions of points would stand still.
    let squares: f64 = offsets.iter().zip(spacing).map(square).sum();
    let share = CLEAN * CLEAN / ((squares / offsets.len() as f64) as f32).max(f32::MIN_POSITIVE);
    // Steep, since noise that is no larger than the units' own errors is rare.
    share.powi(4).min(1.0)
}

/// The value that half of some values are below.
pub(crate) fn median(values: &[f32]) -> f32 {
    nth(&mut values.to_vec(), values.len() / 2)
}

/// The `n`th least, from 0.
pub(crate) fn nth(values: &mut [f32], n: usize) -> f32 {
    *values.select_nth_unstable_by(n, f32::total_cmp).1
}
