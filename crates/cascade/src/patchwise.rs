//! Levels run patch by patch: for runtimes whose unit takes one patch on the caller's thread.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::session::{Backend, Batch, Output, Session, SkipInput};
use crate::sphere::Sphere;
use crate::{
    BackendError, CascadeError, Demand, FeatureTable, LevelInput, LevelOutput, LevelRunner, MadePoint,
    Observer, UnitShape, check_count, filled,
};

/// A session and the buffers that its runs reuse: what a thread holds while it runs a patch.
pub struct Workspace {
    session: Box<dyn Session>,
    output: Output,
    points: Vec<f32>,
    skip_indices: Vec<i64>,
    skip_distances: Vec<f32>,
}

impl Workspace {
    /// Opens a session; its buffers grow with the first patch.
    ///
    /// # Errors
    /// What [`Backend::open`] gives.
    pub fn open(backend: &dyn Backend) -> Result<Self, BackendError> {
        Ok(Self {
            session: backend.open()?,
            output: Output::default(),
            points: Vec::new(),
            skip_indices: Vec::new(),
            skip_distances: Vec::new(),
        })
    }
}

/// Where [`Patchwise`] takes a workspace from, for one patch after another: the engine's are lent in turn to all its
/// requests.
pub trait Sessions: Send + Sync {
    /// Lends `work` a workspace. Nothing that waits for another thread may run inside.
    ///
    /// # Errors
    /// What [`Backend::open`] gives, where a session is opened for it.
    fn lend<R>(&self, work: impl FnOnce(&mut Workspace) -> R) -> Result<R, BackendError>;
}

/// Sessions for as many threads as ask at a time: one is opened where none is free, and kept.
pub struct OnDemand {
    backend: Arc<dyn Backend>,
    free: Mutex<Vec<Workspace>>,
}

impl OnDemand {
    fn lock(&self) -> MutexGuard<'_, Vec<Workspace>> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Sessions for OnDemand {
    fn lend<R>(&self, work: impl FnOnce(&mut Workspace) -> R) -> Result<R, BackendError> {
        let free = self.lock().pop();
        let mut workspace = match free {
            Some(workspace) => workspace,
            None => Workspace::open(&*self.backend)?,
        };
        let result = work(&mut workspace);
        self.lock().push(workspace);
        Ok(result)
    }
}

/// A [`LevelRunner`] over a [`Backend`]: patches side by side on the current rayon pool, each on a session of its own.
///
/// Features are rows in half precision, since they are what takes most memory. Each patch writes the rows of the points
/// that it owns, one run of the table, so that the table is filled in parallel without locks; a unit gathers the rows
/// that it needs from the whole table, so that nothing is copied a patch.
pub struct Patchwise<S> {
    backend: Arc<dyn Backend>,
    sessions: S,
}

impl Patchwise<OnDemand> {
    /// With as many sessions as threads run patches at a time.
    #[must_use]
    pub fn new(backend: Arc<dyn Backend>) -> Self {
        let sessions = OnDemand { backend: Arc::clone(&backend), free: Mutex::default() };
        Self { backend, sessions }
    }
}

impl<S: Sessions> Patchwise<S> {
    /// With sessions on `backend` from elsewhere.
    #[must_use]
    pub fn with_sessions(backend: Arc<dyn Backend>, sessions: S) -> Self {
        Self { backend, sessions }
    }
}

/// `[n, C]`: the feature table of a [`Patchwise`].
struct HalfRows(Vec<f16>);

/// One patch's share of the level's output.
struct PatchTask<'a> {
    patch: usize,
    /// Its points of the merged cloud, two for each place kept.
    dense: &'a mut [MadePoint],
    /// Rows of the points that the patch owns.
    features: &'a mut [f16],
}

impl<S: Sessions> LevelRunner for Patchwise<S> {
    fn shape(&self) -> UnitShape {
        self.backend.shape()
    }

    fn units(&self) -> usize {
        self.backend.units()
    }

    fn provider(&self) -> &str {
        self.backend.provider()
    }

    fn demand(&self) -> Demand {
        self.backend.demand()
    }

    /// Runs every patch, each into its own part of the merged cloud, two points for each place that
    /// [`Patches::kept`](crate::Patches::kept) names, and of the feature table.
    fn run_level(
        &self,
        level: &LevelInput<'_>,
        previous: Option<&FeatureTable>,
        observer: &dyn Observer,
    ) -> Result<LevelOutput, CascadeError> {
        let foreign = || BackendError::Run {
            unit: level.unit + 1,
            why: "the features of the level before are another runner's".into(),
        };
        let previous = previous.map(|table| table.get::<HalfRows>().ok_or_else(foreign)).transpose()?;
        let patches = level.patches;
        let channels = if level.want_features { self.shape().channels } else { 0 };
        let kept: usize = (0..patches.count()).map(|p| patches.kept(p).count()).sum();
        check_count(2 * kept)?;
        let mut merged = filled(MadePoint::default(), 2 * kept)?;
        let mut features = filled(f16::ZERO, level.points.len() * channels)?;

        let mut tasks = Vec::with_capacity(patches.count());
        let (mut points, mut rows) = (&mut merged[..], &mut features[..]);
        for patch in 0..patches.count() {
            let (dense, features);
            (dense, points) = points.split_at_mut(2 * patches.kept(patch).count());
            (features, rows) = rows.split_at_mut(patches.rows_of(patch).len() * channels);
            tasks.push(PatchTask { patch, dense, features });
        }
        let (done, total) = (AtomicUsize::new(0), tasks.len());
        tasks.into_par_iter().try_for_each(|task| {
            if observer.cancelled() {
                return Err(CascadeError::Cancelled);
            }
            self.sessions.lend(|workspace| workspace.run(level, previous, task))??;
            observer.advance(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok(())
        })?;
        let features = level.want_features.then(|| FeatureTable::new(HalfRows(features)));
        Ok(LevelOutput { made: merged, features })
    }
}

impl Workspace {
    fn run(
        &mut self,
        level: &LevelInput<'_>,
        previous: Option<&HalfRows>,
        task: PatchTask<'_>,
    ) -> Result<(), BackendError> {
        let members = level.patches.members(task.patch);
        let sphere = Sphere::around(members.iter().map(|&i| level.points[i as usize]));
        self.points.clear();
        self.points.extend(members.iter().flat_map(|&i| sphere.normalise(level.points[i as usize])));
        self.skip_indices.clear();
        self.skip_distances.clear();
        if let Some(skip) = level.skip {
            for &i in members {
                self.skip_indices.extend(skip.rows(i as usize).iter().copied().map(i64::from));
                self.skip_distances.extend_from_slice(skip.distances(i as usize));
            }
        }
        let batch = Batch {
            patches: 1,
            patch_points: members.len(),
            points: &self.points,
            skip: previous.map(|previous| SkipInput {
                features: &previous.0,
                indices: &self.skip_indices,
                distances: &self.skip_distances,
            }),
            want_features: level.want_features,
        };
        self.session.run(level.unit, &batch, &mut self.output)?;

        for (pair, place) in task.dense.chunks_exact_mut(2).zip(level.patches.kept(task.patch)) {
            for (copy, point) in pair.iter_mut().enumerate() {
                let made = &self.output.dense[(copy * members.len() + place) * 3..][..3];
                *point = level.made(sphere.restore([made[0], made[1], made[2]]), members[place] as usize);
            }
        }
        if level.want_features {
            let channels = self.output.features.len() / members.len();
            for (row, place) in task.features.chunks_exact_mut(channels).zip(level.patches.owned(task.patch))
            {
                row.convert_from_f32_slice(&self.output.features[place * channels..][..channels]);
            }
        }
        Ok(())
    }
}
