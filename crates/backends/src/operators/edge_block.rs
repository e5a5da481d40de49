//! `EdgeBlock`: the dense edge block of a unit (method: "dense edge block"), without the edges ever in memory.
//!
//! For a point i and each neighbour j, with f the features (24) and every linear map split into what acts on the
//! point, on the neighbour, and on what is the edge's own:
//!
//! ```text
//! a = relu(own_a(f_i) + other(f_j))                        12 channels
//! b = relu(own_b(f_i) + on_a[.., 0..12] a)                 12 channels
//! c =      own_c(f_i) + on_a[.., 12..24] a + on_b b        12 channels
//! block_i = [max_j c, max_j b, max_j a, f_i]               60 channels
//! ```
//!
//! A vector holds one channel of several points, each with its own neighbour of the same rank: so the maximum over
//! neighbours needs no sum across a vector, and a weight that is loaded once serves them all. Cost: 432 multiplications
//! an edge and 1,152 a point.

use ort::operator::{ComputeContext, Kernel, KernelContext, Operator, OperatorInput, OperatorOutput};
use ort::value::TensorElementType;
use pulp::{Arch, Simd, WithSimd};

use super::{missing, three};

/// Features in.
const IN: usize = 24;
/// Channels that each of the three maps adds.
const G: usize = 12;
/// Channels that depend on one point alone: its share of a, b and c, and what it is to others.
const OWN: usize = 4 * G;
/// Features out.
const OUT: usize = 3 * G + IN;
/// Output channels computed at once: with two vectors of edges they fill 16 registers.
const AT_ONCE: usize = 6;

/// Features `[B, N, 24]`, indices `[B, N, K]`, own `[24, 48]`, `own_bias` `[48]`, `on_a` `[12, 24]`, `on_b` `[12, 12]`
/// -> `[B, N, 60]`.
pub(super) struct EdgeBlock;

impl Operator for EdgeBlock {
    type Kernel<'attr> = EdgeBlockKernel;

    fn name(&self) -> &str {
        "EdgeBlock"
    }

    fn inputs(&self) -> impl IntoIterator<Item = OperatorInput> {
        let float = || OperatorInput::required(TensorElementType::Float32);
        [float(), OperatorInput::required(TensorElementType::Int64), float(), float(), float(), float()]
    }

    fn outputs(&self) -> impl IntoIterator<Item = OperatorOutput> {
        [OperatorOutput::required(TensorElementType::Float32)]
    }

    fn create_kernel<'attr>(&self, _: &KernelContext<'attr>) -> ort::Result<EdgeBlockKernel> {
        Ok(EdgeBlockKernel { arch: Arch::new(), buffers: Buffers::default() })
    }
}

pub(super) struct EdgeBlockKernel {
    arch: Arch,
    buffers: Buffers,
}

impl Kernel for EdgeBlockKernel {
    fn compute(&mut self, context: &ComputeContext) -> ort::Result<()> {
        let input = |number: usize| context.input(number)?.ok_or_else(|| missing("an input of EdgeBlock"));
        let (features, indices) = (input(0)?, input(1)?);
        let (shape, features) = features.try_extract_tensor::<f32>()?;
        let [items, count, channels] = three(shape, "the features of EdgeBlock")?;
        let (shape, indices) = indices.try_extract_tensor::<i64>()?;
        let [index_items, index_count, k] = three(shape, "the indices of EdgeBlock")?;
        if channels != IN || (index_items, index_count) != (items, count) {
            return Err(ort::Error::new(format!(
                "EdgeBlock needs {IN} channels and as many index rows as points"
            )));
        }
        let (own, own_bias, on_a, on_b) = (input(2)?, input(3)?, input(4)?, input(5)?);
        let weights = Weights::new([
            own.try_extract_tensor::<f32>()?.1,
            own_bias.try_extract_tensor::<f32>()?.1,
            on_a.try_extract_tensor::<f32>()?.1,
            on_b.try_extract_tensor::<f32>()?.1,
        ])?;
        if indices.iter().any(|i| !(0..count as i64).contains(i)) {
            return Err(ort::Error::new("an index of EdgeBlock names no point"));
        }
        let mut out = context
            .output(0, [items as i64, count as i64, OUT as i64])?
            .ok_or_else(|| missing("the output of EdgeBlock"))?;
        let (_, out) = out.try_extract_tensor_mut::<f32>()?;
        if k == 0 || count == 0 {
            return Err(ort::Error::new("EdgeBlock needs points and neighbours"));
        }
        let items = features.chunks_exact(count * IN).zip(indices.chunks_exact(count * k));
        for ((features, indices), out) in items.zip(out.chunks_exact_mut(count * OUT)) {
            self.buffers.run(self.arch, weights, features, indices, k, out);
        }
        Ok(())
    }
}

/// Rows act on an input channel each.
#[derive(Clone, Copy)]
struct Weights<'a> {
    own: &'a [[f32; OWN]; IN],
    own_bias: &'a [f32; OWN],
    on_a: &'a [[f32; 2 * G]; G],
    on_b: &'a [[f32; G]; G],
}

impl<'a> Weights<'a> {
    fn new([own, own_bias, on_a, on_b]: [&'a [f32]; 4]) -> ort::Result<Self> {
        fn matrix<const O: usize, const I: usize>(values: &[f32]) -> Option<&[[f32; O]; I]> {
            let (rows, rest) = values.as_chunks::<O>();
            rest.is_empty().then(|| rows.try_into().ok()).flatten()
        }
        let all = || {
            Some(Self {
                own: matrix(own)?,
                own_bias: own_bias.try_into().ok()?,
                on_a: matrix(on_a)?,
                on_b: matrix(on_b)?,
            })
        };
        all().ok_or_else(|| ort::Error::new("the weights of EdgeBlock have other sizes"))
    }
}

/// Reused from patch to patch. `L`: the points that a vector holds.
#[derive(Default)]
struct Buffers {
    /// `[points / L][36][L]`: each point's share of a, b, c.
    own: Vec<f32>,
    /// `[N, 12]`: what each point is to others.
    other: Vec<[f32; G]>,
    /// `[max(24, 12 K)][L]`: features of L points, or what their neighbours are to them.
    turned: Vec<f32>,
    /// `[36][L]`: what L points are, or the maxima over their edges.
    lanes: Vec<f32>,
}

impl Buffers {
    fn run(
        &mut self,
        arch: Arch,
        weights: Weights,
        features: &[f32],
        indices: &[i64],
        k: usize,
        out: &mut [f32],
    ) {
        arch.dispatch(Run { buffers: self, weights, features, indices, k, out });
    }
}

struct Run<'a> {
    buffers: &'a mut Buffers,
    weights: Weights<'a>,
    features: &'a [f32],
    indices: &'a [i64],
    k: usize,
    out: &'a mut [f32],
}

impl WithSimd for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { buffers, weights, features, indices, k, out } = self;
        let lanes = S::F32_LANES;
        let features = features.as_chunks::<IN>().0;
        let count = features.len();
        let groups = count.div_ceil(lanes);
        buffers.own.resize(groups * 3 * G * lanes, 0.0);
        buffers.other.resize(count, [0.0; G]);
        buffers.turned.resize(IN.max(G * k) * lanes, 0.0);
        buffers.lanes.resize(3 * G * lanes, 0.0);
        // A vector that is not full repeats the last point.
        let point = |group: usize, lane: usize| (group * lanes + lane).min(count - 1);

        for (group, own) in buffers.own.chunks_exact_mut(3 * G * lanes).enumerate() {
            for lane in 0..lanes {
                for (c, value) in features[point(group, lane)].iter().enumerate() {
                    buffers.turned[c * lanes + lane] = *value;
                }
            }
            let turned = S::as_simd_f32s(&buffers.turned).0;
            let own = S::as_mut_simd_f32s(own).0;
            for first in (0..3 * G).step_by(AT_ONCE) {
                own[first..first + AT_ONCE].copy_from_slice(&own_channels(simd, turned, weights, first));
            }
            let other = S::as_mut_simd_f32s(&mut buffers.lanes).0;
            for first in (0..G).step_by(AT_ONCE) {
                let channels = own_channels(simd, turned, weights, 3 * G + first);
                other[first..first + AT_ONCE].copy_from_slice(&channels);
            }
            for lane in 0..lanes.min(count - group * lanes) {
                buffers.other[group * lanes + lane] =
                    std::array::from_fn(|c| buffers.lanes[c * lanes + lane]);
            }
        }

        for (group, own) in buffers.own.chunks_exact(3 * G * lanes).enumerate() {
            // All of them before the first is used: loads of vectors would wait for stores of single numbers.
            for lane in 0..lanes {
                for (rank, index) in indices[point(group, lane) * k..][..k].iter().enumerate() {
                    let turned = &mut buffers.turned[rank * G * lanes..][..G * lanes];
                    for (c, value) in buffers.other[*index as usize].iter().enumerate() {
                        turned[c * lanes + lane] = *value;
                    }
                }
            }
            let own = S::as_simd_f32s(own).0;
            let turned = S::as_simd_f32s(&buffers.turned).0;
            let maxima = S::as_mut_simd_f32s(&mut buffers.lanes).0;
            maxima.fill(simd.splat_f32s(f32::NEG_INFINITY));
            let (pairs, rest) = turned[..G * k].as_chunks::<{ 2 * G }>();
            for pair in pairs {
                edges::<S, 2>(simd, pair, own, weights, maxima);
            }
            if !rest.is_empty() {
                edges::<S, 1>(simd, rest, own, weights, maxima);
            }
            for c in 0..G {
                maxima[c] = simd.add_f32s(maxima[c], own[2 * G + c]);
            }
            for lane in 0..lanes.min(count - group * lanes) {
                let point = group * lanes + lane;
                let (maxima, own) = out[point * OUT..][..OUT].split_at_mut(3 * G);
                for (c, value) in maxima.iter_mut().enumerate() {
                    *value = buffers.lanes[c * lanes + lane];
                }
                own.copy_from_slice(&features[point]);
            }
        }
    }
}

/// Channels `first..first + 6` of those that depend on the point alone.
#[inline(always)]
fn own_channels<S: Simd>(
    simd: S,
    features: &[S::f32s],
    weights: Weights,
    first: usize,
) -> [S::f32s; AT_ONCE] {
    let mut sums: [S::f32s; AT_ONCE] = std::array::from_fn(|o| simd.splat_f32s(weights.own_bias[first + o]));
    for (value, row) in features.iter().zip(weights.own) {
        for (sum, weight) in sums.iter_mut().zip(&row[first..first + AT_ONCE]) {
            *sum = simd.mul_add_e_f32s(*value, simd.splat_f32s(*weight), *sum);
        }
    }
    sums
}

/// `W` vectors of edges (`[W][12]` in `neighbours`) of the same points: raises the maxima of c, b and a.
#[inline(always)]
fn edges<S: Simd, const W: usize>(
    simd: S,
    neighbours: &[S::f32s],
    own: &[S::f32s],
    weights: Weights,
    maxima: &mut [S::f32s],
) {
    let zero = simd.splat_f32s(0.0);
    let (own_a, own_b) = (&own[..G], &own[G..2 * G]);
    let (max_c, rest) = maxima.split_at_mut(G);
    let (max_b, max_a) = rest.split_at_mut(G);

    let mut a = [[zero; W]; G];
    for c in 0..G {
        for w in 0..W {
            a[c][w] = simd.max_f32s(simd.add_f32s(own_a[c], neighbours[w * G + c]), zero);
            max_a[c] = simd.max_f32s(max_a[c], a[c][w]);
        }
    }
    let mut b = [[zero; W]; G];
    for first in (0..G).step_by(AT_ONCE) {
        let mut sums: [[S::f32s; W]; AT_ONCE] = std::array::from_fn(|o| [own_b[first + o]; W]);
        for (a, row) in a.iter().zip(weights.on_a) {
            add(simd, a, &row[first..first + AT_ONCE], &mut sums);
        }
        for (o, sum) in sums.iter().enumerate() {
            for w in 0..W {
                b[first + o][w] = simd.max_f32s(sum[w], zero);
                max_b[first + o] = simd.max_f32s(max_b[first + o], b[first + o][w]);
            }
        }
    }
    for first in (0..G).step_by(AT_ONCE) {
        let mut sums = [[zero; W]; AT_ONCE];
        for (a, row) in a.iter().zip(weights.on_a) {
            add(simd, a, &row[G + first..G + first + AT_ONCE], &mut sums);
        }
        for (b, row) in b.iter().zip(weights.on_b) {
            add(simd, b, &row[first..first + AT_ONCE], &mut sums);
        }
        for (o, sum) in sums.iter().enumerate() {
            for s in sum {
                max_c[first + o] = simd.max_f32s(max_c[first + o], *s);
            }
        }
    }
}

/// `sums[o] += weights[o] * values`.
#[inline(always)]
fn add<S: Simd, const W: usize>(
    simd: S,
    values: &[S::f32s; W],
    weights: &[f32],
    sums: &mut [[S::f32s; W]; AT_ONCE],
) {
    for (sum, weight) in sums.iter_mut().zip(weights) {
        let weight = simd.splat_f32s(*weight);
        for w in 0..W {
            sum[w] = simd.mul_add_e_f32s(values[w], weight, sum[w]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Rng;

    /// The definition, edge by edge, in double precision.
    fn plain(weights: Weights, features: &[f32], indices: &[i64], k: usize) -> Vec<f32> {
        let features = features.as_chunks::<IN>().0;
        let own = |i: usize, o: usize| -> f64 {
            let products =
                features[i].iter().zip(weights.own).map(|(f, row)| f64::from(*f) * f64::from(row[o]));
            f64::from(weights.own_bias[o]) + products.sum::<f64>()
        };
        let mut out = Vec::new();
        for (i, neighbours) in indices.chunks_exact(k).enumerate() {
            let mut maxima = [f64::NEG_INFINITY; 3 * G];
            for &j in neighbours {
                let a: [f64; G] = std::array::from_fn(|o| (own(i, o) + own(j as usize, 3 * G + o)).max(0.0));
                let on_a = |o: usize| (0..G).map(|c| a[c] * f64::from(weights.on_a[c][o])).sum::<f64>();
                let b: [f64; G] = std::array::from_fn(|o| (own(i, G + o) + on_a(o)).max(0.0));
                let on_b = |o: usize| (0..G).map(|c| b[c] * f64::from(weights.on_b[c][o])).sum::<f64>();
                for o in 0..G {
                    let c = own(i, 2 * G + o) + on_a(G + o) + on_b(o);
                    for (part, value) in [c, b[o], a[o]].into_iter().enumerate() {
                        maxima[part * G + o] = maxima[part * G + o].max(value);
                    }
                }
            }
            out.extend(maxima.map(|m| m as f32));
            out.extend(features[i]);
        }
        out
    }

    #[test]
    fn the_kernel_computes_the_definition() {
        let mut random = Rng::new(2);
        let mut numbers = |n: usize| -> Vec<f32> { (0..n).map(|_| random.f64() as f32 - 0.5).collect() };
        let all = [numbers(IN * OWN), numbers(OWN), numbers(G * 2 * G), numbers(G * G)];
        let weights = Weights::new([&all[0], &all[1], &all[2], &all[3]]).expect("sizes");
        let mut buffers = Buffers::default();
        for (count, k) in [(312, 16), (40, 7), (3, 1), (17, 2)] {
            let features = numbers(count * IN);
            let indices: Vec<i64> = (0..count * k).map(|e| ((e * 7 + e / k) % count) as i64).collect();
            let wanted = plain(weights, &features, &indices, k);
            for arch in [Arch::new(), Arch::Scalar] {
                let mut out = vec![f32::NAN; count * OUT];
                buffers.run(arch, weights, &features, &indices, k, &mut out);
                let worst = out.iter().zip(&wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(worst < 1e-5, "{worst} for {count} points of {k} neighbours");
            }
        }
    }

    #[test]
    fn weights_of_other_sizes_are_refused() {
        let own = vec![0.0; IN * OWN];
        assert!(Weights::new([&own, &own[..OWN], &own[..G * 2 * G], &own[..G * G]]).is_ok());
        assert!(Weights::new([&own[1..], &own[..OWN], &own[..G * 2 * G], &own[..G * G]]).is_err());
        assert!(Weights::new([&own, &own[..OWN], &own[..G * 2 * G], &own[..G * G + 1]]).is_err());
    }
}
