//! `BilateralSkip`: what a unit takes over from the level before it (the paper's section 3.2).
//!
//! Each point adds the weighted mean of the features of its nearest points of the previous level's input, with
//! weights exp(-2 d_s / h_s) exp(-2 d_f / h_f): d are the squared distances in space and between the features, h the
//! patch's mean of each point's smallest.

use half::f16;
use half::slice::HalfFloatSliceExt;
use ort::operator::{ComputeContext, Kernel, KernelContext, Operator, OperatorInput, OperatorOutput};
use ort::value::TensorElementType;
use pulp::{Arch, Simd, WithSimd};

use super::{missing, three};

/// What the mean counts beside the point's own features.
const FACTOR: f32 = 0.2;
/// The least h: where every point coincides with a previous one, all weight goes to distances of 0.
const SMALLEST: f32 = 1e-10;

/// Features `[B, N, C]`, previous features `[M, C]` (`f16`), indices `[B, N, n]` (rows of those), squared distances
/// `[B, N, n]` -> features `[B, N, C]`.
pub(super) struct BilateralSkip;

impl Operator for BilateralSkip {
    type Kernel<'attr> = BilateralSkipKernel;

    fn name(&self) -> &str {
        "BilateralSkip"
    }

    fn inputs(&self) -> impl IntoIterator<Item = OperatorInput> {
        [
            OperatorInput::required(TensorElementType::Float32),
            OperatorInput::required(TensorElementType::Float16),
            OperatorInput::required(TensorElementType::Int64),
            OperatorInput::required(TensorElementType::Float32),
        ]
    }

    fn outputs(&self) -> impl IntoIterator<Item = OperatorOutput> {
        [OperatorOutput::required(TensorElementType::Float32)]
    }

    fn create_kernel<'attr>(&self, _: &KernelContext<'attr>) -> ort::Result<BilateralSkipKernel> {
        Ok(BilateralSkipKernel::new(Arch::new()))
    }
}

pub(super) struct BilateralSkipKernel {
    arch: Arch,
    /// `[N, n]`: squared distances between features, then weights.
    weights: Vec<f32>,
    /// `[C]`: one row of the previous features.
    row: Vec<f32>,
}

impl Kernel for BilateralSkipKernel {
    fn compute(&mut self, context: &ComputeContext) -> ort::Result<()> {
        let input =
            |number: usize| context.input(number)?.ok_or_else(|| missing("an input of BilateralSkip"));
        let (features, previous, indices, distances) = (input(0)?, input(1)?, input(2)?, input(3)?);
        let (shape, features) = features.try_extract_tensor::<f32>()?;
        let [items, count, channels] = three(shape, "the features of BilateralSkip")?;
        let (shape, previous) = previous.try_extract_tensor::<f16>()?;
        let (rows, same) = match **shape {
            [rows, width] => (rows, width == channels as i64),
            _ => (0, false),
        };
        let (shape, indices) = indices.try_extract_tensor::<i64>()?;
        let [index_items, index_count, neighbours] = three(shape, "the indices of BilateralSkip")?;
        let (_, distances) = distances.try_extract_tensor::<f32>()?;
        if !same || (index_items, index_count) != (items, count) || distances.len() != indices.len() {
            return Err(ort::Error::new("the inputs of BilateralSkip do not fit each other"));
        }
        if indices.iter().any(|i| !(0..rows).contains(i)) {
            return Err(ort::Error::new("an index of BilateralSkip names no row"));
        }
        if count == 0 || neighbours == 0 || channels == 0 {
            return Err(ort::Error::new("BilateralSkip needs points, neighbours and channels"));
        }
        let mut out = context
            .output(0, [items as i64, count as i64, channels as i64])?
            .ok_or_else(|| missing("the output of BilateralSkip"))?;
        let (_, out) = out.try_extract_tensor_mut::<f32>()?;
        let patches = features
            .chunks_exact(count * channels)
            .zip(indices.chunks_exact(count * neighbours))
            .zip(distances.chunks_exact(count * neighbours))
            .zip(out.chunks_exact_mut(count * channels));
        for (((features, indices), distances), out) in patches {
            self.run(&Patch { features, previous, indices, distances, channels, neighbours }, out);
        }
        Ok(())
    }
}

impl BilateralSkipKernel {
    fn new(arch: Arch) -> Self {
        Self { arch, weights: Vec::new(), row: Vec::new() }
    }

    fn run(&mut self, patch: &Patch, out: &mut [f32]) {
        self.weights.clear();
        self.weights.resize(patch.indices.len(), 0.0);
        self.row.resize(patch.channels, 0.0);
        self.arch.dispatch(Distances { patch, row: &mut self.row, out: &mut self.weights });
        patch.weigh(&mut self.weights);
        self.arch.dispatch(Mean { patch, weights: &self.weights, row: &mut self.row, out });
    }
}

/// One patch's share of the inputs.
struct Patch<'a> {
    features: &'a [f32],
    previous: &'a [f16],
    indices: &'a [i64],
    distances: &'a [f32],
    channels: usize,
    neighbours: usize,
}

impl Patch<'_> {
    fn row(&self, index: i64, out: &mut [f32]) {
        self.previous[index as usize * self.channels..][..self.channels].convert_to_f32_slice(out);
    }

    /// Turns squared distances between features into weights, which sum to the factor for each point.
    fn weigh(&self, featural: &mut [f32]) {
        let widths = [self.distances, featural].map(|distances| {
            let rows = distances.chunks_exact(self.neighbours);
            let count = rows.len() as f32;
            (rows.map(|row| row.iter().copied().fold(f32::INFINITY, f32::min)).sum::<f32>() / count)
                .max(SMALLEST)
        });
        let spatial = self.distances.chunks_exact(self.neighbours);
        for (weights, spatial) in featural.chunks_exact_mut(self.neighbours).zip(spatial) {
            for (w, s) in weights.iter_mut().zip(spatial) {
                *w = -2.0 * (s / widths[0] + *w / widths[1]);
            }
            // The largest exponent taken off, as in any softmax: nothing underflows to 0 / 0.
            let largest = weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            weights.iter_mut().for_each(|w| *w = (*w - largest).exp());
            let share = FACTOR / weights.iter().sum::<f32>();
            weights.iter_mut().for_each(|w| *w *= share);
        }
    }
}

/// Squared distances between each point's features and those it may take over.
struct Distances<'a> {
    patch: &'a Patch<'a>,
    row: &'a mut [f32],
    out: &'a mut [f32],
}

impl WithSimd for Distances<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { patch, row, out } = self;
        let of_points =
            patch.indices.chunks_exact(patch.neighbours).zip(out.chunks_exact_mut(patch.neighbours));
        for (own, (indices, out)) in patch.features.chunks_exact(patch.channels).zip(of_points) {
            let (own, own_rest) = S::as_simd_f32s(own);
            for (index, out) in indices.iter().zip(out) {
                patch.row(*index, row);
                let (other, other_rest) = S::as_simd_f32s(row);
                // Two sums: one would wait for itself.
                let mut sums = [simd.splat_f32s(0.0); 2];
                for (a, b) in own.chunks(2).zip(other.chunks(2)) {
                    for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
                        let difference = simd.sub_f32s(*a, *b);
                        *sum = simd.mul_add_e_f32s(difference, difference, *sum);
                    }
                }
                let rest: f32 = own_rest.iter().zip(other_rest).map(|(a, b)| (a - b) * (a - b)).sum();
                *out = simd.reduce_sum_f32s(simd.add_f32s(sums[0], sums[1])) + rest;
            }
        }
    }
}

/// Each point's features and the weighted sum of those it takes over.
struct Mean<'a> {
    patch: &'a Patch<'a>,
    weights: &'a [f32],
    row: &'a mut [f32],
    out: &'a mut [f32],
}

impl WithSimd for Mean<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { patch, weights, row, out } = self;
        let of_points =
            patch.indices.chunks_exact(patch.neighbours).zip(weights.chunks_exact(patch.neighbours));
        let points = patch.features.chunks_exact(patch.channels).zip(out.chunks_exact_mut(patch.channels));
        for ((own, out), (indices, weights)) in points.zip(of_points) {
            out.copy_from_slice(own);
            let (out, out_rest) = S::as_mut_simd_f32s(out);
            for (index, weight) in indices.iter().zip(weights) {
                patch.row(*index, row);
                let (other, other_rest) = S::as_simd_f32s(row);
                let factor = simd.splat_f32s(*weight);
                for (o, p) in out.iter_mut().zip(other) {
                    *o = simd.mul_add_e_f32s(factor, *p, *o);
                }
                for (o, p) in out_rest.iter_mut().zip(other_rest) {
                    *o += weight * p;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Rng;

    /// The definition, in double precision.
    fn plain(patch: &Patch) -> Vec<f32> {
        let (c, n) = (patch.channels, patch.neighbours);
        let own = |i: usize| &patch.features[i * c..][..c];
        let other = |e: usize, a: usize| f64::from(patch.previous[patch.indices[e] as usize * c + a]);
        let featural: Vec<f64> = (0..patch.indices.len())
            .map(|e| {
                own(e / n)
                    .iter()
                    .enumerate()
                    .map(|(a, value)| (f64::from(*value) - other(e, a)).powi(2))
                    .sum()
            })
            .collect();
        let spatial: Vec<f64> = patch.distances.iter().map(|d| f64::from(*d)).collect();
        let width = |d: &[f64]| {
            let rows = d.chunks_exact(n);
            let count = rows.len() as f64;
            rows.map(|row| row.iter().copied().fold(f64::INFINITY, f64::min)).sum::<f64>() / count
        };
        let (spatial_width, featural_width) = (width(&spatial), width(&featural));
        let weight = |e: usize| {
            (-2.0 * spatial[e] / spatial_width).exp() * (-2.0 * featural[e] / featural_width).exp()
        };
        let value = |i: usize, a: usize| {
            let edges = i * n..(i + 1) * n;
            let total: f64 = edges.clone().map(weight).sum();
            let mean: f64 = edges.map(|e| weight(e) * other(e, a)).sum::<f64>() / total;
            (f64::from(own(i)[a]) + 0.2 * mean) as f32
        };
        (0..patch.features.len() / c)
            .flat_map(|i| (0..c).map(move |a| (i, a)))
            .map(|(i, a)| value(i, a))
            .collect()
    }

    #[test]
    fn the_kernel_computes_the_definition() {
        let mut random = Rng::new(3);
        for (count, rows, channels) in [(312, 700, 264), (5, 1, 264), (20, 9, 7)] {
            let mut numbers = |n: usize| -> Vec<f32> { (0..n).map(|_| random.f64() as f32).collect() };
            let features = numbers(count * channels);
            let previous: Vec<f16> = numbers(rows * channels).into_iter().map(f16::from_f32).collect();
            let distances: Vec<f32> = numbers(count * 5).iter().map(|d| 0.5 + d).collect();
            let indices: Vec<i64> = (0..count * 5).map(|e| ((e * 13) % rows) as i64).collect();
            let patch = Patch {
                features: &features,
                previous: &previous,
                indices: &indices,
                distances: &distances,
                channels,
                neighbours: 5,
            };
            let wanted = plain(&patch);
            for arch in [Arch::new(), Arch::Scalar] {
                let mut out = vec![f32::NAN; features.len()];
                BilateralSkipKernel::new(arch).run(&patch, &mut out);
                let worst = out.iter().zip(&wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(worst < 1e-5, "{worst} for {count} points of {channels} channels");
            }
        }
    }

    #[test]
    fn points_that_coincide_with_previous_ones_take_those() {
        let (features, previous) = (vec![0.0; 8], [1.0, 1.0, 3.0, 3.0].map(f16::from_f32));
        let patch = Patch {
            features: &features,
            previous: &previous,
            indices: &[0, 1, 0, 1, 0, 1, 0, 1],
            distances: &[0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0],
            channels: 2,
            neighbours: 2,
        };
        let mut out = vec![f32::NAN; 8];
        BilateralSkipKernel::new(Arch::new()).run(&patch, &mut out);
        assert!(out.iter().all(|v| (v - 0.2).abs() < 1e-6), "{out:?}");
    }
}
