//! Points that are chosen already when a sampling begins.

use pulp::{Arch, Simd, WithSimd};

use super::tree::{WIDE, mask, positive};
use crate::kdtree::squared;
use densecloud_cloud::Point;

/// Points that are chosen before, eight side by side; unused places are infinitely far.
pub(super) struct Beside(Vec<[[f32; WIDE]; 3]>);

impl Beside {
    pub(super) fn of(points: &[Point]) -> Self {
        let group = |points: &[Point]| {
            std::array::from_fn(|a| {
                std::array::from_fn(|i| points.get(i).map_or(f32::INFINITY, |point| point[a]))
            })
        };
        Self(points.chunks(WIDE).map(group).collect())
    }

    /// All of them, axis by axis.
    pub(super) fn groups(&self) -> &[[[f32; WIDE]; 3]] {
        &self.0
    }

    /// Those that may be nearest to anything in a box.
    pub(super) fn near(&self, lo: Point, hi: Point) -> Self {
        let mut near = Vec::new();
        if !self.0.is_empty() {
            Arch::new().dispatch(Near { all: &self.0, lo, hi, near: &mut near });
        }
        Self::of(&near)
    }
}

/// The choice of those points.
struct Near<'a> {
    all: &'a [[[f32; WIDE]; 3]],
    lo: Point,
    hi: Point,
    near: &'a mut Vec<Point>,
}

impl WithSimd for Near<'_> {
    type Output = ();

    /// Distances are computed as those to a point inside are, of which they are bounds, since rounding is monotone.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { all, lo, hi, near } = self;
        let mut reach = [f32::INFINITY; WIDE];
        for q in all {
            for i in 0..WIDE {
                let offset = |a: usize| positive((q[a][i] - lo[a]).abs(), (hi[a] - q[a][i]).abs());
                let farthest = squared([offset(0), offset(1), offset(2)]);
                reach[i] = if farthest < reach[i] { farthest } else { reach[i] };
            }
        }
        let reach = reach.into_iter().fold(f32::INFINITY, f32::min);
        for q in all {
            let squares: [f32; WIDE] = std::array::from_fn(|i| {
                let offset = |a: usize| positive(lo[a] - q[a][i], q[a][i] - hi[a]);
                squared([offset(0), offset(1), offset(2)])
            });
            let mut within = mask::<WIDE>(|i| squares[i] <= reach);
            while within != 0 {
                let i = within.trailing_zeros() as usize % WIDE;
                near.push(q.map(|axis| axis[i]));
                within &= within - 1;
            }
        }
    }
}
