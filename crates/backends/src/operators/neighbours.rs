//! `Neighbours`: for each row of a patch the k nearest others, by brute force.
//!
//! A patch has 312 rows: an index would cost more than it saves.

use ort::operator::{ComputeContext, Kernel, KernelContext, Operator, OperatorInput, OperatorOutput};
use ort::value::TensorElementType;
use pulp::{Arch, Simd, WithSimd};

use super::{missing, three};

/// Rows `[B, N, C]` -> indices `[B, N, k]` (`i64`, within the item, in no particular order).
pub(super) struct Neighbours;

impl Operator for Neighbours {
    type Kernel<'attr> = NeighboursKernel;

    fn name(&self) -> &str {
        "Neighbours"
    }

    fn inputs(&self) -> impl IntoIterator<Item = OperatorInput> {
        [OperatorInput::required(TensorElementType::Float32)]
    }

    fn outputs(&self) -> impl IntoIterator<Item = OperatorOutput> {
        [OperatorOutput::required(TensorElementType::Int64)]
    }

    fn create_kernel<'attr>(&self, context: &KernelContext<'attr>) -> ort::Result<NeighboursKernel> {
        let k: i64 = context.get("k").ok_or_else(|| missing("the attribute k of Neighbours"))?;
        let k = usize::try_from(k).map_err(|_| ort::Error::new("k of Neighbours is negative"))?;
        Ok(NeighboursKernel { k, arch: Arch::new(), search: Search::default() })
    }
}

pub(super) struct NeighboursKernel {
    k: usize,
    arch: Arch,
    search: Search,
}

impl Kernel for NeighboursKernel {
    fn compute(&mut self, context: &ComputeContext) -> ort::Result<()> {
        let rows = context.input(0)?.ok_or_else(|| missing("the rows of Neighbours"))?;
        let (shape, rows) = rows.try_extract_tensor::<f32>()?;
        let [items, count, channels] = three(shape, "the rows of Neighbours")?;
        let k = self.k;
        if count <= k {
            return Err(ort::Error::new(format!("{count} rows have no {k} others each")));
        }
        let mut found = context
            .output(0, [items as i64, count as i64, k as i64])?
            .ok_or_else(|| missing("the output of Neighbours"))?;
        let (_, found) = found.try_extract_tensor_mut::<i64>()?;
        if k == 0 || channels == 0 {
            found.fill(0);
            return Ok(());
        }
        for (rows, found) in rows.chunks_exact(count * channels).zip(found.chunks_exact_mut(count * k)) {
            self.search.nearest_others(self.arch, rows, channels, k, found);
        }
        Ok(())
    }
}

/// Buffers of a search, reused from patch to patch.
#[derive(Default)]
struct Search {
    /// `[C, padded N]`: the rows, turned, so that a vector holds one channel of several rows.
    columns: Vec<f32>,
    /// Of one row to all: squared distances.
    distances: Vec<f32>,
    /// The smallest distance of each of k or more groups of rows.
    smallest: Vec<f32>,
    /// Squared distance (its bits order as its values do, since it is not negative) and index.
    candidates: Vec<u64>,
}

impl Search {
    /// `found[i]`: the k nearest others of row i, of equally near ones those of the lower index.
    fn nearest_others(&mut self, arch: Arch, rows: &[f32], channels: usize, k: usize, found: &mut [i64]) {
        arch.dispatch(NearestOthers { search: self, rows, channels, k, found });
    }
}

struct NearestOthers<'a> {
    search: &'a mut Search,
    rows: &'a [f32],
    channels: usize,
    k: usize,
    found: &'a mut [i64],
}

impl WithSimd for NearestOthers<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { search, rows, channels, k, found } = self;
        let count = rows.len() / channels;
        let lanes = S::F32_LANES;
        let padded = count.next_multiple_of(lanes);
        // As many groups as make at least k, each of whole vectors of rows.
        let groups = k.div_ceil(lanes);

        // The padding is infinitely far.
        search.columns.clear();
        search.columns.resize(channels * padded, f32::INFINITY);
        for (i, row) in rows.chunks_exact(channels).enumerate() {
            for (c, value) in row.iter().enumerate() {
                search.columns[c * padded + i] = *value;
            }
        }
        search.distances.resize(padded, 0.0);
        search.smallest.resize(groups * lanes, 0.0);
        let columns = S::as_simd_f32s(&search.columns).0;
        let infinity = simd.splat_f32s(f32::INFINITY);
        for (i, (row, found)) in rows.chunks_exact(channels).zip(found.chunks_exact_mut(k)).enumerate() {
            let distances = S::as_mut_simd_f32s(&mut search.distances).0;
            for (j, distance) in distances.iter_mut().enumerate() {
                let mut sum = simd.splat_f32s(0.0);
                for (c, value) in row.iter().enumerate() {
                    let difference =
                        simd.sub_f32s(columns[c * (padded / lanes) + j], simd.splat_f32s(*value));
                    sum = simd.mul_add_e_f32s(difference, difference, sum);
                }
                *distance = sum;
            }
            search.distances[i] = f32::INFINITY;

            // Each of the k or more groups has a row at its own smallest distance: so k rows are no further than
            // the largest of those, and nothing further need be looked at.
            let smallest = S::as_mut_simd_f32s(&mut search.smallest).0;
            smallest.fill(infinity);
            for chunk in S::as_simd_f32s(&search.distances).0.chunks(groups) {
                for (s, d) in smallest.iter_mut().zip(chunk) {
                    *s = simd.min_f32s(*s, *d);
                }
            }
            let bound = search.smallest.iter().copied().fold(0.0, f32::max);
            search.candidates.resize(padded, 0);
            let mut near = 0;
            for (j, d) in search.distances[..count].iter().enumerate() {
                search.candidates[near] = u64::from(d.to_bits()) << 32 | j as u64;
                near += usize::from(*d <= bound);
            }
            let candidates = &mut search.candidates[..near];
            if k < candidates.len() {
                candidates.select_nth_unstable(k - 1);
            }
            // Rows that are not numbers are near nothing; the row itself stands in, so that every index exists.
            for (place, f) in found.iter_mut().enumerate() {
                *f = candidates.get(place).map_or(i as i64, |c| (c & u64::from(u32::MAX)) as i64);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Rng;

    fn by_sorting(rows: &[f32], channels: usize, k: usize) -> Vec<i64> {
        let row = |i: usize| &rows[i * channels..][..channels];
        let count = rows.len() / channels;
        let of = |i: usize| {
            let distance =
                |j: usize| row(i).iter().zip(row(j)).fold(0.0, |s, (a, b)| (b - a).mul_add(b - a, s));
            let mut others: Vec<(f32, usize)> =
                (0..count).filter(|j| *j != i).map(|j| (distance(j), j)).collect();
            others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let mut nearest: Vec<i64> = others[..k].iter().map(|o| o.1 as i64).collect();
            nearest.sort_unstable();
            nearest
        };
        (0..count).flat_map(of).collect()
    }

    fn by_kernel(arch: Arch, rows: &[f32], channels: usize, k: usize) -> Vec<i64> {
        let mut found = vec![0; rows.len() / channels * k];
        Search::default().nearest_others(arch, rows, channels, k, &mut found);
        found.chunks_exact_mut(k).for_each(<[i64]>::sort_unstable);
        found
    }

    #[test]
    fn the_kernel_finds_what_sorting_finds() {
        let mut random = Rng::new(1);
        for (count, channels, k) in
            [(312, 3, 16), (312, 24, 32), (33, 3, 32), (18, 3, 16), (9, 24, 1), (100, 1, 5)]
        {
            let rows: Vec<f32> = (0..count * channels).map(|_| random.f64() as f32).collect();
            for arch in [Arch::new(), Arch::Scalar] {
                assert_eq!(
                    by_kernel(arch, &rows, channels, k),
                    by_sorting(&rows, channels, k),
                    "{count} {k}"
                );
            }
        }
    }

    #[test]
    fn of_equally_near_rows_the_first_are_taken() {
        let grid: Vec<f32> = (0..100).flat_map(|i| [(i % 10) as f32, (i / 10) as f32, 0.0]).collect();
        assert_eq!(by_kernel(Arch::new(), &grid, 3, 5), by_sorting(&grid, 3, 5));
        let same = vec![0.5; 3 * 40];
        assert_eq!(by_kernel(Arch::new(), &same, 3, 5)[..10], [1, 2, 3, 4, 5, 0, 2, 3, 4, 5]);
    }

    #[test]
    fn rows_that_are_not_numbers_do_no_harm() {
        let mut rows: Vec<f32> = (0..60).map(|i| i as f32).collect();
        rows[7] = f32::NAN;
        rows[30] = f32::INFINITY;
        let found = by_kernel(Arch::new(), &rows, 3, 16);
        assert!(found.iter().all(|i| (0..20).contains(i)));
    }
}
