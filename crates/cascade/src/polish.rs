//! The last step, without learning: even coverage, and points on the surface they suggest.
//!
//! Farthest point sampling can only be as even as its candidates allow, and it prefers the
//! candidates that stand off the surface. So the last level's sample is only the start: the
//! midpoints of its neighbours, which average two errors and lie in its gaps, are sampled again
//! (each region by the area of its surface), points that are too near push each other apart, and each
//! is projected onto the moving least squares surface of all that the unit made, and drawn to the
//! input where that is clean. Coarser levels go without: there a chord cuts a curve that the next
//! unit would follow.

use rayon::prelude::*;

use super::anchors::Anchors;
use super::balance::{SURPLUS, Shares, balanced};
use super::border::Borders;
use super::globals::{PolishGlobals, once};
use super::measured::{Measured, Reference};
use super::part::Within;
use super::share::{Neighbourhoods, sample};
use super::strays::Kept;
use super::{CascadeError, Observer, check_count};
use densecloud_cloud::Point;
use densecloud_geometry::{
    KdTree, Neighbour, Reach, Rng, Walk, cell_area, indices, normal, project_to_surface,
};

/// Neighbours that a point shares midpoints with: the ring around it, and some.
const NEIGHBOURS: usize = 7;
/// A noisy input point further than this from every midpoint, in its own spacing, is a tip that they
/// fall short of. A clean one is a candidate wherever it lies: no midpoint is as exact.
const SHORT: f32 = 0.5;
/// Points of the sample around an input point whose midpoints are compared with it.
const AROUND: usize = 16;
/// Neighbours that a normal is estimated from, the point itself among them.
const NORMAL_NEIGHBOURS: usize = 12;
/// How far the surface is taken to reach beyond the points that the units made, in the input's spacing, if they are as
/// many as the input's; it shrinks as they become denser.
const REACH: f32 = 0.9;
/// Points that the units made lie in one sheet if they are no further from its tangent plane than this, in the input's
/// spacing.
const FLAT: f32 = 0.2;
/// A midpoint is of one surface if the edge lies within 45 degrees of both tangent planes: this is
/// the sine. Others bridge sheets or cut corners.
const STEEPEST: f32 = 0.7;
/// Steps of relaxation; more flatten what is thin and round what is sharp.
const STEPS: usize = 2;
/// Points push each other when they are nearer than this, in multiples of the usual distance.
const WANTED: f32 = 1.1;
/// The share of what lacks that one step makes up.
const PUSH: f32 = 0.4;
/// No step is longer than this share of the usual distance.
const FARTHEST: f32 = 0.2;

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

/// What the result is chosen from.
struct Candidates {
    /// Midpoints of the sample, and the input points that they fall short of: the more of these, the more the input is
    /// trusted.
    points: Vec<Point>,
    /// For each the spacing of the input there; none where the whole is to be equally dense.
    local: Option<Vec<f32>>,
    /// For each input point, the area of the surface that is nearest to it; where a local spacing is given, in squares of
    /// that.
    areas: Vec<f32>,
}

impl Candidates {
    /// Keeps those that a part may choose.
    fn keep_wanted(&mut self, part: &Within<'_>) -> Result<(), CascadeError> {
        let spacing = self.local.as_deref();
        let wanted: Vec<bool> = self
            .points
            .par_iter()
            .enumerate()
            .map(|(i, p)| part.may_choose(*p, spacing.map(|s| s[i])))
            .collect();
        let mut of = wanted.iter();
        self.points.retain(|_| *of.next().expect("one each"));
        if let Some(local) = &mut self.local {
            let mut of = wanted.iter();
            local.retain(|_| *of.next().expect("one each"));
        }
        part.suffices(self.points.len())
    }

    fn of(
        sample: Sample<'_>,
        size: usize,
        Surface { input, borders, trust }: Surface<'_>,
        neighbourhoods: Option<Neighbourhoods>,
        globals: &mut PolishGlobals,
    ) -> Self {
        let Sample { tree, points: made, nearest } = sample;
        let density = once(&mut globals.input_a_sample, || input.points.len() as f32 / made.len() as f32);
        let reach = REACH * density.sqrt();
        let cell = |i: usize, near: &[Neighbour], normal| {
            let nearest = nearest[i];
            let spacing = input.spacing[nearest as usize];
            let radius = reach * spacing;
            let reach = Reach { radius, past: borders.past(nearest) * radius, flat: FLAT * spacing };
            cell_area(made, i, near, normal, reach)
        };
        let (rings, cells) = surroundings(tree, made, cell);
        let mut areas = vec![0.0; input.points.len()];
        nearest.iter().zip(&cells).for_each(|(&nearest, area)| areas[nearest as usize] += area);
        drop(cells);
        let local = neighbourhoods.map(|n| n.spacing_of(&areas, &mut globals.usual_point));
        if let Some(local) = &local {
            areas.iter_mut().zip(local).for_each(|(area, spacing)| *area /= spacing * spacing);
        }
        let of_sample =
            local.as_ref().map(|local| nearest.iter().map(|&i| local[i as usize]).collect::<Vec<_>>());
        let (mut points, mut spacings) = midpoints(made, &rings, of_sample.as_deref());
        let midpoints_made = once(&mut globals.midpoints, || points.len());
        let reached_by = if midpoints_made < size { ReachedBy::SampleToo } else { ReachedBy::Midpoints };
        if reached_by == ReachedBy::SampleToo {
            points.extend_from_slice(made);
            spacings.extend(of_sample.iter().flatten());
        }
        let short = SHORT * (1.0 - trust);
        for i in fallen_short_of(sample, &rings, reached_by, input, short) {
            points.push(input.points[i as usize]);
            spacings.extend(local.as_ref().map(|local| local[i as usize]));
        }
        if points.len() < size {
            // All is rough: whatever lies between neighbours, which is at least 3.5 times the sample.
            let (more, their) = midpoints(made, &nearest_rings(tree, made), of_sample.as_deref());
            points.extend(more);
            spacings.extend(their);
        }
        Self { points, local: local.map(|_| spacings), areas }
    }
}

/// The nearest others of a point that lie on the same surface.
#[derive(Clone, Copy, Default)]
pub(crate) struct Ring {
    others: [u32; NEIGHBOURS],
    count: u8,
}

impl Ring {
    /// The nearest to point `i` among those `found`, nearest first, whatever surface they lie on.
    fn of(i: usize, found: &[Neighbour]) -> Self {
        let mut ring = Self::default();
        for n in found.iter().filter(|n| n.index as usize != i).take(NEIGHBOURS) {
            ring.others[usize::from(ring.count)] = n.index;
            ring.count += 1;
        }
        ring
    }

    fn others(&self) -> &[u32] {
        &self.others[..usize::from(self.count)]
    }
}

/// The ring of each of `points`, of which `tree` is built; best when they lie in the order of a tree.
pub(crate) fn rings(tree: &KdTree, points: &[Point]) -> Vec<Ring> {
    surroundings(tree, points, |_, _, _| ()).0
}

/// The nearest others of each of `points`, of which `tree` is built, on whatever surface they lie.
fn nearest_rings(tree: &KdTree, points: &[Point]) -> Vec<Ring> {
    let ring = |found: &mut Vec<Neighbour>, (i, p): (usize, &Point)| {
        tree.nearest(*p, NEIGHBOURS + 1, found);
        Ring::of(i, found)
    };
    points.par_iter().enumerate().map_init(Vec::new, ring).collect()
}

/// The rings, and whatever is wanted of each point's nearest (itself among them) and normal.
fn surroundings<T: Clone + Default + Send>(
    tree: &KdTree,
    points: &[Point],
    of: impl Fn(usize, &[Neighbour], [f32; 3]) -> T + Sync,
) -> (Vec<Ring>, Vec<T>) {
    let mut rings = vec![Ring::default(); points.len()];
    let mut normals = vec![[0.0; 3]; points.len()];
    let mut wanted = vec![T::default(); points.len()];
    let all = rings.par_iter_mut().zip(&mut normals).zip(&mut wanted).enumerate();
    all.for_each_init(Walk::default, |walk, (i, ((ring, normal_of), wanted))| {
        tree.nearest_next(points[i], NORMAL_NEIGHBOURS, walk);
        let found = &walk.found;
        *ring = Ring::of(i, found);
        *normal_of = normal(points, found);
        *wanted = of(i, found, *normal_of);
    });
    rings.par_iter_mut().enumerate().for_each(|(i, ring)| {
        let all = *ring;
        ring.count = 0;
        for &j in all.others() {
            let edge: [f32; 3] = std::array::from_fn(|a| points[j as usize][a] - points[i][a]);
            let length = edge.iter().map(|c| c * c).sum::<f32>().sqrt();
            let steep = |n: [f32; 3]| (0..3).map(|a| n[a] * edge[a]).sum::<f32>().abs() > STEEPEST * length;
            if !steep(normals[i]) && !steep(normals[j as usize]) {
                ring.others[usize::from(ring.count)] = j;
                ring.count += 1;
            }
        }
    });
    (rings, wanted)
}

/// Pushes points apart that are nearer to each other than is usual around them: what farthest
/// point sampling leaves uneven. The neighbours are found once, since points move little.
fn relax(points: &mut [Point]) {
    let rings = rings(&KdTree::new(points), points);
    for _ in 0..STEPS {
        let before = points.to_vec();
        let distance = |i: usize, j: u32| {
            let (p, q) = (before[i], before[j as usize]);
            (0..3).map(|a| (p[a] - q[a]).powi(2)).sum::<f32>().sqrt()
        };
        let nearest: Vec<f32> = rings
            .par_iter()
            .enumerate()
            .map(|(i, ring)| ring.others().iter().map(|&j| distance(i, j)).fold(f32::INFINITY, f32::min))
            .collect();
        points.par_iter_mut().zip(&rings).enumerate().for_each(|(i, (point, ring))| {
            // A neighbour on a steep spot may have no neighbours of its own.
            let known = ring.others().iter().map(|&j| nearest[j as usize]).filter(|d| d.is_finite());
            let (count, sum) = known.fold((0.0, 0.0), |(count, sum), d| (count + 1.0_f32, sum + d));
            if count == 0.0 {
                return;
            }
            let usual = sum / count;
            let wanted = WANTED * usual;
            let mut push = [0.0; 3];
            for &j in ring.others() {
                let length = distance(i, j);
                if length < wanted && length > 0.0 {
                    let by = PUSH * (wanted - length) / length;
                    for a in 0..3 {
                        push[a] += by * (before[i][a] - before[j as usize][a]);
                    }
                }
            }
            let moved = push.iter().map(|c| c * c).sum::<f32>().sqrt();
            let share = (FARTHEST * usual / moved.max(f32::MIN_POSITIVE)).min(1.0);
            for a in 0..3 {
                point[a] += share * push[a];
            }
        });
    }
}

/// A sample of what the unit made.
#[derive(Clone, Copy)]
struct Sample<'a> {
    /// Built from the points.
    tree: &'a KdTree,
    points: &'a [Point],
    /// For each the nearest input point.
    nearest: &'a [u32],
}

/// What the input tells of the surface.
#[derive(Clone, Copy)]
struct Surface<'a> {
    input: &'a Measured,
    borders: &'a Borders,
    /// How clean the input is, from 0 to 1.
    trust: f32,
}

/// The candidates that may come near an input point.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ReachedBy {
    /// Midpoints alone.
    Midpoints,
    /// Midpoints, and the points of the sample, which are candidates, too.
    SampleToo,
}

/// The input points that no candidate comes nearer to than `short` of their spacing: what was measured must not vanish.
/// Looks at the candidates around the nearest points of the sample only.
fn fallen_short_of(
    Sample { tree, points, .. }: Sample<'_>,
    rings: &[Ring],
    by: ReachedBy,
    input: &Measured,
    short: f32,
) -> Vec<u32> {
    let far = |walk: &mut Walk, ((p, spacing), i): ((&Point, &f32), u32)| {
        let limit = (short * spacing).powi(2);
        let near = |q: Point| (0..3).map(|a| (q[a] - p[a]).powi(2)).sum::<f32>() <= limit;
        tree.nearest_next(*p, AROUND, walk);
        let reached = walk.found.iter().any(|n| {
            let q = points[n.index as usize];
            by == ReachedBy::SampleToo && near(q)
                || rings[n.index as usize].others().iter().any(|&j| near(middle(q, points[j as usize])))
        });
        (!reached).then_some(i)
    };
    let all = input.points.par_iter().zip(&input.spacing).zip(indices(input.points.len()).into_par_iter());
    all.map_init(Walk::default, far).flatten_iter().collect()
}

fn middle(p: Point, q: Point) -> Point {
    std::array::from_fn(|a| 0.5 * (p[a] + q[a]))
}

/// Of every point and its ring, each pair once; and the mean of their local spacings, where there are such.
pub(crate) fn midpoints(points: &[Point], rings: &[Ring], local: Option<&[f32]>) -> (Vec<Point>, Vec<f32>) {
    let pairs = |i: usize| {
        let others = rings[i].others().iter().map(|&j| j as usize);
        others.filter(move |&j| i < j || !rings[j].others().contains(&(i as u32))).map(move |j| (i, j))
    };
    let all = || (0..points.len()).into_par_iter().flat_map_iter(pairs);
    let middles = all().map(|(i, j)| middle(points[i], points[j])).collect();
    let spacings = local.map(|local| all().map(|(i, j)| 0.5 * (local[i] + local[j])).collect());
    (middles, spacings.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Silent;
    use crate::globals::Globals;
    use densecloud_cloud::Frame;
    use densecloud_geometry::farthest_point_sampling;

    fn reference(points: &[Point], spacing: f32) -> Reference {
        let frame = Frame::fit(&[[0.0; 3], [1.0; 3]]).unwrap();
        Reference::new(Measured::new(points, spacing), None, &mut Globals::new(frame))
    }

    fn nearest(points: &[Point], reference: &Reference) -> Vec<u32> {
        let nearest = |p: &Point| reference.input.tree.nearest_one(*p).expect("a point").index;
        points.iter().map(nearest).collect()
    }

    fn polished(made: &[Point], full: usize, size: usize, reference: Reference) -> Vec<Point> {
        let (mut globals, mut random) = (PolishGlobals::default(), Rng::new(5));
        let made = Kept { points: made.to_vec(), nearest: nearest(made, &reference) };
        let polish = Polish { sizes: Sizes { full, size }, part: None, observer: &Silent };
        polish.run(made, reference, &mut globals, &mut random).unwrap().0
    }

    /// A square of unit side, at some height.
    fn square(n: u64, height: f32, seed: u64) -> Vec<Point> {
        let mut random = Rng::new(seed);
        (0..n).map(|_| [random.f64() as f32, random.f64() as f32, height]).collect()
    }

    fn all_midpoints(points: &[Point]) -> Vec<Point> {
        midpoints(points, &rings(&KdTree::new(points), points), None).0
    }

    /// Coefficient of variation of nearest-neighbour distances.
    fn variation(points: &[Point]) -> f64 {
        let tree = KdTree::new(points);
        let mut found = Vec::new();
        let distances: Vec<f64> = points
            .iter()
            .map(|&p| {
                tree.nearest(p, 2, &mut found);
                f64::from(found[1].distance_squared).sqrt()
            })
            .collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        let square = distances.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / distances.len() as f64;
        square.sqrt() / mean
    }

    #[test]
    fn the_result_is_more_even_than_the_sample_and_stays_on_the_surface() {
        let made = square(3000, 0.5, 1);
        let sample: Vec<Point> =
            farthest_point_sampling(&made, 2000, 0).iter().map(|&i| made[i as usize]).collect();
        let dense = polished(&made, 2000, 2000, reference(&sample[..500], 0.05));
        assert_eq!(dense.len(), 2000);
        assert!(dense.iter().all(|p| (p[2] - 0.5).abs() < 1e-6));
        let (before, after) = (variation(&sample), variation(&dense));
        assert!(after < 0.4 * before, "{after} from {before}");
    }

    #[test]
    fn a_tip_of_one_point_keeps_its_reach() {
        let made = square(3000, 0.5, 1);
        let sample: Vec<Point> =
            farthest_point_sampling(&made, 2000, 0).iter().map(|&i| made[i as usize]).collect();
        let mut measured = sample[..500].to_vec();
        measured.push([0.5, 1.06, 0.5]);
        let dense = polished(&made, 2000, 2000, reference(&measured, 0.05));
        assert!(dense.iter().any(|p| p[1] > 1.04), "nothing near the tip");
    }

    #[test]
    fn what_lies_on_no_surface_gives_the_size_too() {
        for n in [20_u64, 60, 300] {
            let mut random = Rng::new(n);
            let made: Vec<Point> = (0..n).map(|_| std::array::from_fn(|_| random.f64() as f32)).collect();
            // Edges at any angle to any normal: few midpoints are of one surface.
            for size in [2 * made.len(), 3 * made.len()] {
                assert_eq!(polished(&made, size, size, reference(&made, 0.1)).len(), size);
            }
        }
    }

    #[test]
    fn sheets_are_not_bridged() {
        // Sheets 0.035 apart: with a spacing of 0.022 that is nearer than some neighbours in a
        // sheet. What is left are edges of less than 45 degrees.
        let even = |height: f32, seed| -> Vec<Point> {
            let all = square(8000, height, seed);
            farthest_point_sampling(&all, 2000, 0).iter().map(|&i| all[i as usize]).collect()
        };
        let (mut points, other) = (even(0.0, 1), even(0.035, 2));
        points.extend(other);
        let middles = all_midpoints(&points);
        let between = middles.iter().filter(|p| (0.01..0.025).contains(&p[2])).count();
        assert!(between * 40 < middles.len(), "{between} of {} between the sheets", middles.len());
    }

    #[test]
    fn input_points_share_the_area_of_the_surface() {
        // A square of area 1, half as dense on its right half; both clouds are thinned out, and have points on the border.
        let thinned = |from: u64, to: usize, seed| -> Vec<Point> {
            let all = square(from, 0.5, seed);
            farthest_point_sampling(&all, to, 0).iter().map(|&i| all[i as usize]).collect()
        };
        let points: Vec<Point> = thinned(20_000, 6000, 1)
            .into_iter()
            .enumerate()
            .filter(|(i, p)| p[0] < 0.5 || *i < 3000)
            .map(|(_, p)| p)
            .collect();
        let even = thinned(8000, 400, 2);
        let (tree, made) = KdTree::in_order(&points);
        let (input, mut globals) = (reference(&even, 0.06), PolishGlobals::default());
        let sample = Sample { tree: &tree, points: &made, nearest: &nearest(&made, &input) };
        let surface = Surface { input: &input.input, borders: &input.borders, trust: 1.0 };
        let areas = Candidates::of(sample, made.len(), surface, None, &mut globals).areas;
        let whole: f32 = areas.iter().sum();
        assert!((0.93..1.1).contains(&whole), "{whole}");
        let right: f32 =
            input.input.points.iter().zip(&areas).filter(|(p, _)| p[0] > 0.5).map(|(_, area)| area).sum();
        assert!((right / whole - 0.5).abs() < 0.03, "{right} of {whole} on the right");
    }

    #[test]
    fn every_pair_comes_once() {
        let points = square(60, 0.0, 4);
        let mut middles: Vec<[u32; 3]> = all_midpoints(&points).iter().map(|p| p.map(f32::to_bits)).collect();
        let count = middles.len();
        assert!((60 * 7 / 2..=60 * 7).contains(&count), "{count} pairs");
        middles.sort_unstable();
        middles.dedup();
        assert_eq!(middles.len(), count);
    }

    #[test]
    fn too_few_midpoints_are_made_up_for() {
        let points = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(polished(&points, 5, 5, reference(&points, 1.0)).len(), 5);
    }
}
