//! A backend without a network, for tests of everything around the backend.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use crate::{Backend, BackendError, Batch, Output, Session, UnitShape};

/// Gives each point back and, beside it, the midpoint to its nearest neighbour in the patch; can
/// be slow and can fail on request. Features are the point's first coordinate, so that tests can
/// follow them across levels.
#[derive(Debug, Clone)]
pub struct Fake {
    /// The sizes it pretends to have.
    pub shape: UnitShape,
    /// How long each batch takes.
    pub delay: Duration,
    /// The batch, counted from 0 over all sessions, that fails.
    pub fails_at: Option<usize>,
    batches: Arc<AtomicUsize>,
}

impl Fake {
    /// Patches of 32 points, 4 channels, instant, never failing.
    #[must_use]
    pub fn new() -> Self {
        Self {
            shape: UnitShape { patch_size: 32, neighbours: 8, channels: 4 },
            delay: Duration::ZERO,
            fails_at: None,
            batches: Arc::default(),
        }
    }

    /// The same, but each batch takes `delay`.
    #[must_use]
    pub fn slow(delay: Duration) -> Self {
        Self { delay, ..Self::new() }
    }

    /// The same, but batch `number`, counted from 0 over all sessions, fails.
    #[must_use]
    pub fn failing_at(number: usize) -> Self {
        Self { fails_at: Some(number), ..Self::new() }
    }

    /// Batches run so far.
    #[must_use]
    pub fn batches(&self) -> usize {
        self.batches.load(Ordering::Relaxed)
    }
}

impl Default for Fake {
    fn default() -> Self {
        Self::new()
    }
}

impl Backend for Fake {
    fn shape(&self) -> UnitShape {
        self.shape
    }

    fn units(&self) -> usize {
        4
    }

    fn provider(&self) -> &str {
        "fake"
    }

    fn open(&self) -> Result<Box<dyn Session>, BackendError> {
        Ok(Box::new(self.clone()))
    }
}

impl Session for Fake {
    fn run(&mut self, unit: usize, batch: &Batch<'_>, output: &mut Output) -> Result<(), BackendError> {
        let number = self.batches.fetch_add(1, Ordering::Relaxed);
        std::thread::sleep(self.delay);
        if self.fails_at == Some(number) {
            return Err(BackendError::Run { unit: unit + 1, why: "asked to fail".into() });
        }
        output.dense.clear();
        output.features.clear();
        for patch in batch.points.chunks_exact(batch.patch_points * 3) {
            let points: Vec<[f32; 3]> = patch.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
            output.dense.extend(points.iter().flatten());
            for (i, p) in points.iter().enumerate() {
                let near = points
                    .iter()
                    .enumerate()
                    .filter(|(j, _)| *j != i)
                    .min_by(|(_, a), (_, b)| distance(p, a).total_cmp(&distance(p, b)))
                    .map_or(*p, |(_, q)| *q);
                output.dense.extend((0..3).map(|a| (p[a] + near[a]) / 2.0));
            }
            if batch.want_features {
                for p in &points {
                    output.features.extend(std::iter::repeat_n(p[0], self.shape.channels));
                }
            }
        }
        Ok(())
    }
}

fn distance(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum()
}
