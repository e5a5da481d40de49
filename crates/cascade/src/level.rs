//! One level: patches through one unit, merged and resampled.

use std::sync::atomic::{AtomicUsize, Ordering};

use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use super::measured::Measured;
use super::patches::Patches;
use super::polish::polish;
use super::strays::{Made, without_strays};
use super::{CascadeError, CascadeOptions, Observer, Stage, filled};
use crate::backend::{BackendError, Batch, SKIP_NEIGHBOURS, SkipInput};
use crate::workers::{Worker, Workers};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Rng, Walk, farthest_point_sampling};

/// The share of a level's size that is enough where a polish follows, which chooses among midpoints: rather than take the
/// worst strays for the rest, the level goes without.
const ENOUGH: f64 = 0.75;
/// What the last level then has at least: the size asked of it may exceed twice the size of the one before it by a quarter.
const FEWEST: f64 = 0.5;

/// One level about to run.
pub(super) struct Level {
    /// From 0.
    pub(super) number: usize,
    /// The unit that runs it, from 0.
    pub(super) unit: usize,
    /// Whether nothing follows, so that features are not needed.
    pub(super) last: bool,
    /// Its input, P_{l-1}: distinct, in local coordinates.
    pub(super) points: Vec<Point>,
    /// What the level before it left; none at the first.
    pub(super) previous: Option<Previous>,
    /// The cascade's input, to measure strays against; none at the first, whose input it is.
    pub(super) measured: Option<Measured>,
}

/// What a level gives.
pub(super) struct Done {
    pub(super) points: Vec<Point>,
    /// For the next level, unless there is none.
    pub(super) previous: Option<Previous>,
    pub(super) measured: Option<Measured>,
}

/// What a level leaves to the next: its input points and their features.
pub(super) struct Previous {
    points: Vec<Point>,
    /// `[n, C]`, one row a point.
    features: Vec<f16>,
    /// Each point's row.
    rows: Vec<u32>,
}

/// For each point of a level, its nearest points in the previous level's input.
struct SkipNeighbours {
    /// `[n, 5]` rows of the previous feature table.
    rows: Vec<i64>,
    /// `[n, 5]` squared distances.
    distances: Vec<f32>,
}

impl Level {
    /// Runs the level and resamples to `size` points.
    pub(super) fn run(
        self,
        size: usize,
        settings: &CascadeOptions,
        workers: &Workers,
        observer: &dyn Observer,
    ) -> Result<Done, CascadeError> {
        // Each level draws from its own stream, so that a ratio's levels do not depend on how many
        // follow.
        let mut random = Rng::new(settings.seed.wrapping_add((self.number as u64) << 32));
        let patch_size = workers.shape().patch_size;
        let patches = Patches::cover(&self.points, patch_size, settings, &mut random, self.number, observer)?;
        let skip = match &self.previous {
            Some(previous) => Some(SkipNeighbours::find(previous, &self.points)?),
            None => None,
        };

        observer.begin(self.number, Stage::Units);
        let (merged, features) = self.run_units(&patches, skip.as_ref(), workers, observer)?;
        let Patches { rows, spacing, .. } = patches;
        // The features that this level read are what takes most memory: gone before sampling begins.
        let Self { number, unit, last, points, previous, measured } = self;
        drop((previous, skip));
        let measured = measured.unwrap_or_else(|| Measured::new(&points, spacing));
        let limits = (settings.max_displacement as f32, settings.max_distance as f32);
        let doubled = 2 * points.len();
        let share = |polished: f64| if settings.polish { (polished * size as f64) as usize } else { size };
        let wanted = if settings.polish { doubled } else { doubled.max(size) };
        let merged = without_strays(merged, wanted, share(ENOUGH), limits.0, limits.1, &measured);
        if merged.len() < share(FEWEST) {
            let why = "it made points that are not finite; the model is unusable".into();
            return Err(BackendError::Run { unit: unit + 1, why }.into());
        }
        let previous = (!last).then_some(Previous { points, features, rows });

        observer.begin(number, Stage::Resample);
        if observer.cancelled() {
            return Err(CascadeError::Cancelled);
        }
        let points = if last && settings.polish {
            polish(&merged, doubled.max(size), size, &measured, &mut random, observer)?
        } else {
            let first = random.below(merged.len() as u64) as usize;
            let mut kept = farthest_point_sampling(&merged, size.min(merged.len()), first);
            if !last {
                // The order means nothing to the next level, and patch by patch neighbours are near in memory.
                kept.sort_unstable();
            }
            kept.iter().map(|&i| merged[i as usize]).collect()
        };
        Ok(Done { points, previous, measured: (!last).then_some(measured) })
    }

    /// Runs every patch, each into its own part of the merged cloud (two points for each one that
    /// [`Patches::kept`] names) and of the feature table `[n, C]` (empty at the last level).
    fn run_units(
        &self,
        patches: &Patches,
        skip: Option<&SkipNeighbours>,
        workers: &Workers,
        observer: &dyn Observer,
    ) -> Result<(Vec<Made>, Vec<f16>), CascadeError> {
        let channels = if self.last { 0 } else { workers.shape().channels };
        let kept: usize = (0..patches.len()).map(|p| patches.kept(p).count()).sum();
        let mut merged = filled(Made::default(), 2 * kept)?;
        let mut features = filled(f16::ZERO, self.points.len() * channels)?;

        let mut tasks = Vec::with_capacity(patches.len());
        let (mut points, mut rows) = (&mut merged[..], &mut features[..]);
        for patch in 0..patches.len() {
            let owned = patches.row_starts[patch + 1] - patches.row_starts[patch];
            let (dense, features);
            (dense, points) = points.split_at_mut(2 * patches.kept(patch).count());
            (features, rows) = rows.split_at_mut(owned * channels);
            tasks.push(PatchTask { patch, dense, features });
        }
        let (done, total) = (AtomicUsize::new(0), tasks.len());
        tasks.into_par_iter().try_for_each(|task| {
            if observer.cancelled() {
                return Err(CascadeError::Cancelled);
            }
            workers.with_worker(|worker| self.run_patch(task, patches, skip, worker))?;
            observer.advance(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok(())
        })?;
        Ok((merged, features))
    }

    fn run_patch(
        &self,
        task: PatchTask<'_>,
        patches: &Patches,
        skip: Option<&SkipNeighbours>,
        worker: &mut Worker,
    ) -> Result<(), CascadeError> {
        let members = patches.members(task.patch);
        let sphere = Sphere::around(members.iter().map(|&i| self.points[i as usize]));
        worker.points.clear();
        worker.points.extend(members.iter().flat_map(|&i| sphere.normalise(self.points[i as usize])));
        worker.skip_indices.clear();
        worker.skip_distances.clear();
        if let Some(skip) = skip {
            for &i in members {
                let five = i as usize * SKIP_NEIGHBOURS..(i as usize + 1) * SKIP_NEIGHBOURS;
                worker.skip_indices.extend_from_slice(&skip.rows[five.clone()]);
                worker.skip_distances.extend_from_slice(&skip.distances[five]);
            }
        }
        let batch = Batch {
            patches: 1,
            patch_points: members.len(),
            points: &worker.points,
            skip: self.previous.as_ref().map(|previous| SkipInput {
                features: &previous.features,
                indices: &worker.skip_indices,
                distances: &worker.skip_distances,
            }),
            want_features: !self.last,
        };
        worker.session.run(self.unit, &batch, &mut worker.output)?;

        for (pair, place) in task.dense.chunks_exact_mut(2).zip(patches.kept(task.patch)) {
            for (copy, point) in pair.iter_mut().enumerate() {
                let made = &worker.output.dense[(copy * members.len() + place) * 3..][..3];
                let at = sphere.restore([made[0], made[1], made[2]]);
                let source = members[place] as usize;
                let moved = (0..3).map(|a| (at[a] - self.points[source][a]).powi(2)).sum::<f32>().sqrt();
                *point = Made { at, displacement: moved / patches.spacing[source] };
            }
        }
        if !self.last {
            let channels = worker.output.features.len() / members.len();
            for (row, place) in task.features.chunks_exact_mut(channels).zip(patches.owned(task.patch)) {
                row.convert_from_f32_slice(&worker.output.features[place * channels..][..channels]);
            }
        }
        Ok(())
    }
}

/// One patch's share of the level's output.
struct PatchTask<'a> {
    patch: usize,
    /// Its points of the merged cloud, two for each place kept.
    dense: &'a mut [Made],
    /// Rows of the points that the patch owns.
    features: &'a mut [f16],
}

impl SkipNeighbours {
    fn find(previous: &Previous, points: &[Point]) -> Result<Self, CascadeError> {
        let tree = KdTree::new(&previous.points);
        let mut rows = filled(0, points.len() * SKIP_NEIGHBOURS)?;
        let mut distances = filled(0.0, points.len() * SKIP_NEIGHBOURS)?;
        rows.par_chunks_exact_mut(SKIP_NEIGHBOURS)
            .zip(distances.par_chunks_exact_mut(SKIP_NEIGHBOURS))
            .zip(points)
            .for_each_init(Walk::default, |walk, ((rows, distances), &point)| {
                tree.nearest_next(point, SKIP_NEIGHBOURS, walk);
                for (k, neighbour) in walk.found.iter().enumerate() {
                    rows[k] = i64::from(previous.rows[neighbour.index as usize]);
                    distances[k] = neighbour.distance_squared;
                }
            });
        Ok(Self { rows, distances })
    }
}

/// The unit sphere of a patch: its centroid and the largest distance to it.
struct Sphere {
    centre: [f64; 3],
    radius: f64,
}

impl Sphere {
    fn around(points: impl Iterator<Item = Point> + Clone) -> Self {
        let mut centre = [0.0; 3];
        let mut count = 0.0;
        for p in points.clone() {
            count += 1.0;
            for a in 0..3 {
                centre[a] += f64::from(p[a]);
            }
        }
        centre = centre.map(|c| c / count);
        let squared = |p: Point| (0..3).map(|a| (f64::from(p[a]) - centre[a]).powi(2)).sum::<f64>();
        let radius = points.map(squared).fold(0.0, f64::max).sqrt();
        // Points that all coincide have no radius; any other value leaves them where they are.
        Self { centre, radius: if radius > 0.0 { radius } else { 1.0 } }
    }

    fn normalise(&self, p: Point) -> Point {
        std::array::from_fn(|a| ((f64::from(p[a]) - self.centre[a]) / self.radius) as f32)
    }

    fn restore(&self, p: Point) -> Point {
        std::array::from_fn(|a| (f64::from(p[a]) * self.radius + self.centre[a]) as f32)
    }
}
