//! The last step, without learning: even coverage, and points on the surface they suggest.
//!
//! Farthest point sampling can only be as even as its candidates allow, and it prefers the
//! candidates that stand off the surface. So the last level's sample is only the start: the
//! midpoints of its neighbours, which average two errors and lie in its gaps, are sampled again
//! (each region by the area of its surface), points that are too near push each other apart, and each
//! is projected onto the moving least squares surface of all that the unit made, and drawn to the
//! input where that is clean. Coarser levels go without: there a chord cuts a curve that the next
//! unit would follow.

mod candidates;
mod relax;
mod rings;

pub(crate) use rings::{midpoints, rings};

use rayon::prelude::*;

use super::anchors::Anchors;
use super::balance::{SURPLUS, Shares, balanced};
use super::globals::PolishGlobals;
use super::measured::Reference;
use super::part::Within;
use super::share::sample;
use super::strays::Kept;
use super::{CascadeError, Observer, check_count};
use candidates::{Candidates, Sample, Surface};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Rng, project_to_surface};
use relax::relax;

/// How many points a polish gives, and from how many.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    /// Points of the sample whose midpoints the result is chosen from: farthest point sampling thins out what exceeds
    /// it by more than a tenth. (Less is not worth its time: the midpoints are thinned out anyway.)
    pub(super) full: usize,
    /// Points of the result.
    pub(super) size: usize,
}

/// A polish about to run.
#[derive(Clone, Copy)]
pub(super) struct Polish<'a> {
    pub(super) sizes: Sizes,
    /// Where the input is a part of a cloud, which of it is wanted.
    pub(super) part: Option<&'a Within<'a>>,
    pub(super) observer: &'a dyn Observer,
}

impl Polish<'_> {
    /// Chooses points spread over what the unit made, evenly in the spacing of the input at each where that has
    /// neighbourhoods, ordered as by farthest point sampling; of a part, also those just outside of what is wanted of it.
    /// Takes what it is given, to free each part when its last use is over.
    pub(super) fn run(
        self,
        Kept { points: mut made, mut nearest }: Kept,
        Reference { input, borders, neighbourhoods }: Reference,
        globals: &mut PolishGlobals,
        random: &mut Rng,
    ) -> Result<(Vec<Point>, Vec<Point>), CascadeError> {
        let Sizes { full, size } = self.sizes;
        // From here on neighbours in space are neighbours in memory.
        let (tree, sorted, order) = KdTree::sorted(&made);
        nearest = order.iter().map(|&i| nearest[i as usize]).collect();
        drop((std::mem::replace(&mut made, sorted), order));
        let anchors = Anchors::new(&input, &made, &tree, &mut globals.trust);
        let surface = Surface { input: &input, borders: &borders, trust: anchors.trust };
        let mut candidates = if made.len() > full + full / 10 {
            let first = random.below(made.len() as u64) as usize;
            let local = neighbourhoods.as_ref().map(|of| of.spacing_at(&nearest));
            let mut kept = sample(&made, local.as_deref(), full, first);
            drop(local);
            kept.par_sort_unstable();
            let points: Vec<Point> = kept.iter().map(|&i| made[i as usize]).collect();
            nearest = kept.iter().map(|&i| nearest[i as usize]).collect();
            let sample = Sample { tree: &KdTree::new(&points), points: &points, nearest: &nearest };
            Candidates::of(sample, size, surface, neighbourhoods, globals)
        } else {
            let sample = Sample { tree: &tree, points: &made, nearest: &nearest };
            Candidates::of(sample, size, surface, neighbourhoods, globals)
        };
        drop((nearest, borders));
        if let Some(part) = self.part {
            candidates.keep_wanted(part)?;
        }
        check_count(candidates.points.len())?;
        self.go_on()?;
        let settled = self.part.map_or_else(Vec::new, Within::settled);
        let local = candidates.local.take();
        let shares =
            Shares { input: &input, areas: &candidates.areas, trust: anchors.trust, part: self.part };
        let order = self.choose(&candidates.points, local, shares, globals, random);

        let mut chosen = order.clone();
        chosen.par_sort_unstable();
        let mut dense: Vec<Point> = chosen.par_iter().map(|&i| candidates.points[i as usize]).collect();
        dense.extend_from_slice(&settled);
        let count = candidates.points.len();
        drop(candidates);
        self.go_on()?;
        relax(&mut dense);
        self.go_on()?;
        project_to_surface(&mut dense, &made, &tree);
        anchors.draw(&mut dense);

        let settled = dense.split_off(chosen.len());
        let mut place_of = vec![0; count];
        chosen.iter().zip(0_u32..).for_each(|(&i, place)| place_of[i as usize] = place);
        let points: Vec<Point> = order.par_iter().map(|&i| dense[place_of[i as usize] as usize]).collect();
        Ok(match self.part {
            Some(part) => part.joined(points, settled),
            None => (points, Vec::new()),
        })
    }

    fn go_on(&self) -> Result<(), CascadeError> {
        if self.observer.cancelled() { Err(CascadeError::Cancelled) } else { Ok(()) }
    }

    /// Which of the candidates are taken, in the order of a farthest point sampling; of a part, beside its darts.
    fn choose(
        &self,
        candidates: &[Point],
        local: Option<Vec<f32>>,
        shares: Shares<'_>,
        globals: &mut PolishGlobals,
        random: &mut Rng,
    ) -> Vec<u32> {
        let size = self.sizes.size;
        let count = ((SURPLUS * size as f64) as usize).min(candidates.len());
        let sampled = if let Some(part) = self.part {
            part.sample(candidates, local.as_deref(), count, &part.settled())
        } else {
            let first = random.below(candidates.len() as u64) as usize;
            let sampled = sample(candidates, local.as_deref(), count, first);
            drop(local);
            sampled
        };
        balanced(candidates, &sampled, size, shares, globals)
    }
}

#[cfg(test)]
mod tests;
