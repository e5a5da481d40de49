//! Each neighbourhood its share: how dense the input is about each of its points.
//!
//! A result is as many times denser than its input everywhere, or as dense everywhere. In between lies chance: a random
//! sample's density varies from place to place though its surface does not. So density is measured on several scales, and
//! on each only what exceeds chance counts.

use std::fmt;
use std::str::FromStr;

use rayon::prelude::*;

use super::globals::{once, usual_logarithm};
use super::part::{Field, stands_for_others};
use super::sites::Sites;
use super::{CascadeError, filled};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Walk, farthest_point_sampling, indices, scaled_farthest_point_sampling};

/// Where the points of a result go.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Spread {
    /// Each neighbourhood becomes denser by the same factor, evenly within it.
    #[default]
    Neighbourhood,
    /// The whole surface becomes equally dense: dense places of an uneven cloud may lose points.
    Area,
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Neighbourhood => "neighbourhood",
            Self::Area => "area",
        })
    }
}

impl FromStr for Spread {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "neighbourhood" => Ok(Self::Neighbourhood),
            "area" => Ok(Self::Area),
            _ => Err(format!("{text:?}; there are `neighbourhood` and `area`")),
        }
    }
}

/// Points of a neighbourhood that is counted at once.
pub(super) const REGION: usize = 32;
/// Every so many points one stands for them on the next coarser scale.
pub(super) const COARSER: usize = 8;
/// Points of the coarser scale that tell what is usual about a point.
const NEAREST: usize = 4;
/// Logarithms of areas that differ from what is usual about them by less than this differ by chance, on the finest scale:
/// three deviations of a random sample. Each coarser scale counts more points, and has [`FINER`] times this.
const CHANCE: f32 = 0.35;
const FINER: f32 = 0.5;
/// The share of a region's disc that lies past a border, for the distance of its points' centroid from its middle in
/// radii: at a straight border the centroid is 0.42 radii away, and half of the disc is empty.
const EMPTY: f32 = 1.18;
/// The least share of a disc that is full, in a corner.
const LEAST_FULL: f32 = 0.25;

/// The neighbourhood of each point of the cascade's input, on all scales.
pub(super) struct Neighbourhoods {
    scale: Scale,
    /// For each point the root of the area that it has, by the number of points about it.
    pub(super) spacing: Vec<f32>,
}

/// The neighbourhoods of some points.
struct Scale {
    /// [`REGION`] or fewer indices for each point.
    members: Vec<u32>,
    row: usize,
    about: About,
}

/// What is usual about the points of a scale.
enum About {
    /// The same about all: there are hardly more points than a neighbourhood has.
    Nothing,
    /// What a coarser scale says.
    Coarser(Box<Coarser>),
    /// What is known of the whole, about each point: the logarithm of the area that a point has, beside the usual one.
    Known(Vec<f32>),
}

/// A part of the points, as dense everywhere in proportion.
struct Coarser {
    /// Their indices.
    of: Vec<u32>,
    /// For each point of the finer scale the nearest of these.
    nearest: Vec<[u32; NEAREST]>,
    scale: Scale,
}

impl Neighbourhoods {
    /// Neighbours on each scale: O(n log n); 170 bytes a point. Where the points are a part, the whole's `field` says what is
    /// usual about them.
    ///
    /// # Errors
    /// There is no memory for them.
    pub(super) fn of(
        Sites { points, tree, .. }: &Sites,
        usual: &mut Option<f32>,
        field: Option<&Field>,
    ) -> Result<Self, CascadeError> {
        let scale = match field {
            None => Scale::of(points, tree)?,
            Some(field) => Scale::of_part(points, tree, field)?,
        };
        let spacing = scale.spacing(&scale.areas(points), usual);
        Ok(Self { scale, spacing })
    }

    /// The local spacing at the points that have these indices.
    pub(super) fn spacing_at(&self, indices: &[u32]) -> Vec<f32> {
        indices.iter().map(|&i| self.spacing[i as usize]).collect()
    }

    /// The local spacing by the `areas` that the points have: the root of their mean over a neighbourhood as large as it takes
    /// to tell it from chance.
    pub(super) fn spacing_of(&self, areas: &[f32], usual: &mut Option<f32>) -> Vec<f32> {
        self.scale.spacing(areas, usual)
    }
}

impl Scale {
    /// `tree` must be built from `points`.
    fn of(points: &[Point], tree: &KdTree) -> Result<Self, CascadeError> {
        let about = if points.len() >= COARSER * REGION {
            About::Coarser(Box::new(Coarser::of(tree, points)?))
        } else {
            About::Nothing
        };
        Self::with(points, tree, about)
    }

    /// As [`Scale::of`], of a part: on one coarser scale, and what is usual about that is known. Each decides by what lies
    /// around a point alone, so that it is the same in every part.
    fn of_part(points: &[Point], tree: &KdTree, field: &Field) -> Result<Self, CascadeError> {
        let of: Vec<u32> = indices(points.len()).filter(|&i| stands_for_others(points[i as usize])).collect();
        let about = if of.len() >= REGION {
            let scale =
                |few: &[Point], theirs: &KdTree| Self::with(few, theirs, About::Known(field.at(few)?));
            About::Coarser(Box::new(Coarser::with(tree, points, of, scale)?))
        } else {
            About::Known(field.at(points)?)
        };
        Self::with(points, tree, about)
    }

    fn with(points: &[Point], tree: &KdTree, about: About) -> Result<Self, CascadeError> {
        let row = REGION.min(points.len());
        let mut members = filled(0_u32, row * points.len())?;
        for (&i, near) in tree.order().iter().zip(nearest_of::<REGION>(tree, points, tree.order())?) {
            members[i as usize * row..][..row].copy_from_slice(&near[..row]);
        }
        Ok(Self { members, row, about })
    }

    /// The area that each of the points has by the number of those about it.
    fn areas(&self, points: &[Point]) -> Vec<f32> {
        let area = |(i, near): (usize, &[u32])| area(points, points[i], near);
        self.members.par_chunks_exact(self.row).enumerate().map(area).collect()
    }

    fn spacing(&self, areas: &[f32], usual: &mut Option<f32>) -> Vec<f32> {
        self.logarithms(areas, CHANCE, usual).into_par_iter().map(|area| (0.5 * area).exp()).collect()
    }

    /// The logarithms of the areas, without what is `chance`: `usual` is that of the whole.
    fn logarithms(&self, areas: &[f32], chance: f32, usual: &mut Option<f32>) -> Vec<f32> {
        let mean = |members: &[u32]| {
            let sum: f32 = members.iter().map(|&i| areas[i as usize]).sum();
            (sum / members.len() as f32).max(f32::MIN_POSITIVE)
        };
        let means: Vec<f32> = self.members.par_chunks_exact(self.row).map(mean).collect();
        let kept = |mean: f32, about: f32| {
            let off = mean.ln() - about;
            about + off * (1.0 - (chance / off).powi(2)).max(0.0)
        };
        match &self.about {
            About::Nothing => vec![once(usual, || usual_logarithm(&means)); means.len()],
            About::Known(known) => {
                let usual = once(usual, || usual_logarithm(&means));
                means.par_iter().zip(known).map(|(mean, known)| kept(*mean, usual + known)).collect()
            }
            About::Coarser(coarser) => {
                let theirs: Vec<f32> = coarser.of.iter().map(|&i| means[i as usize]).collect();
                let about = coarser.scale.logarithms(&theirs, FINER * chance, usual);
                let mean = |near: &[u32; NEAREST]| {
                    near.iter().map(|&i| about[i as usize]).sum::<f32>() / NEAREST as f32
                };
                means.par_iter().zip(&coarser.nearest).map(|(own, near)| kept(*own, mean(near))).collect()
            }
        }
    }
}

impl Coarser {
    fn of(tree: &KdTree, points: &[Point]) -> Result<Self, CascadeError> {
        let of = tree.order().iter().copied().step_by(COARSER).collect();
        Self::with(tree, points, of, Scale::of)
    }

    fn with(
        tree: &KdTree,
        points: &[Point],
        of: Vec<u32>,
        scale: impl Fn(&[Point], &KdTree) -> Result<Scale, CascadeError>,
    ) -> Result<Self, CascadeError> {
        let few: Vec<Point> = of.iter().map(|&i| points[i as usize]).collect();
        let theirs = KdTree::new(&few);
        let mut nearest = filled([0; NEAREST], points.len())?;
        for (&i, near) in tree.order().iter().zip(nearest_of::<NEAREST>(&theirs, points, tree.order())?) {
            nearest[i as usize] = near;
        }
        Ok(Self { of, nearest, scale: scale(&few, &theirs)? })
    }
}

/// The logarithm of the area that each of a sample's points has, and the usual one: a random sample has the chance of its own
/// number of points, however many those are that it was drawn from.
pub(super) fn coarse_logarithms(sample: &[Point]) -> Result<(Vec<f32>, f32), CascadeError> {
    let scale = Scale::of(sample, &KdTree::new(sample))?;
    let mut usual = None;
    let logarithms = scale.logarithms(&scale.areas(sample), CHANCE, &mut usual);
    Ok((logarithms, usual.unwrap_or_default()))
}

/// The `K` points of `tree` nearest to each of `points`, in that `order`; where there are fewer, the first one again.
fn nearest_of<const K: usize>(
    tree: &KdTree,
    points: &[Point],
    order: &[u32],
) -> Result<Vec<[u32; K]>, CascadeError> {
    let mut all = filled([0_u32; K], order.len())?;
    let nearest = |walk: &mut Walk, (near, &i): (&mut [u32; K], &u32)| {
        tree.nearest_next(points[i as usize], K, walk);
        near.fill(walk.found.first().map_or(0, |n| n.index));
        near.iter_mut().zip(&walk.found).for_each(|(place, n)| *place = n.index);
    };
    all.par_iter_mut().zip(order).for_each_init(Walk::default, nearest);
    Ok(all)
}

/// The area that each of `near` has about `p` if they lie on a surface.
fn area(points: &[Point], p: Point, near: &[u32]) -> f32 {
    let count = near.len() as f32;
    let (mut centre, mut reach) = ([0.0_f32; 3], 0.0_f32);
    for &i in near {
        let to: Point = std::array::from_fn(|a| points[i as usize][a] - p[a]);
        reach = reach.max(to.iter().map(|c| c * c).sum());
        centre = std::array::from_fn(|a| centre[a] + to[a] / count);
    }
    let off = (centre.iter().map(|c| c * c).sum::<f32>() / reach.max(f32::MIN_POSITIVE)).sqrt();
    let full = (1.0 - EMPTY * off).max(LEAST_FULL);
    std::f32::consts::PI * reach * full / count
}

/// Farthest point sampling in the spacing at each point, or evenly where there is none.
pub(super) fn sample(points: &[Point], spacing: Option<&[f32]>, count: usize, first: usize) -> Vec<u32> {
    match spacing {
        Some(spacing) => scaled_farthest_point_sampling(points, spacing, count, first),
        None => farthest_point_sampling(points, count, first),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Rng;

    /// Random points of a square with that corner and side.
    fn square(n: usize, corner: [f32; 2], side: f32, random: &mut Rng) -> Vec<Point> {
        let mut at = |a: usize| corner[a] + side * random.f64() as f32;
        (0..n).map(|_| [at(0), at(1), 0.0]).collect()
    }

    fn neighbourhoods(points: Vec<Point>) -> Neighbourhoods {
        Neighbourhoods::of(&Sites::new(points), &mut None, None).unwrap()
    }

    fn mean(values: &[f32]) -> f32 {
        values.iter().sum::<f32>() / values.len() as f32
    }

    /// The largest deviation from the mean, as a share of it.
    fn variation(values: &[f32]) -> f32 {
        let usual = mean(values);
        values.iter().map(|v| (v / usual - 1.0).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn chance_is_no_density() {
        for seed in 0..5 {
            let mut random = Rng::new(seed);
            let spacing = neighbourhoods(square(2000, [0.0; 2], 1.0, &mut random)).spacing;
            let varied = spacing.iter().filter(|s| (**s / mean(&spacing) - 1.0).abs() > 0.03).count();
            // Corners look thinner than they are.
            assert!(varied < 100, "{varied} of 2000 spacings vary, seed {seed}");
        }
    }

    #[test]
    fn density_is_told_from_chance() {
        let mut random = Rng::new(3);
        let mut points = square(800, [0.0; 2], 1.0, &mut random);
        points.extend(square(800, [3.0; 2], 10.0, &mut random));
        let spacing = neighbourhoods(points.clone()).spacing;
        let ratio = mean(&spacing[800..]) / mean(&spacing[..800]);
        assert!((9.0..10.5).contains(&ratio), "{ratio} of 10");
        // A dense part no larger than the finest neighbourhood.
        points.truncate(800);
        points.extend(square(60, [0.5; 2], 0.03, &mut random));
        let spacing = neighbourhoods(points.clone()).spacing;
        let ratio = mean(&spacing[..800]) / mean(&spacing[800..]);
        assert!(ratio > 3.5, "{ratio} of 9");
    }

    #[test]
    fn areas_of_nothing_and_few_points_give_a_spacing() {
        for n in [1, 2, 20, 255, 256, 300] {
            let points = square(n, [0.0; 2], 1.0, &mut Rng::new(n as u64));
            let neighbourhoods = neighbourhoods(points);
            for spacing in [&neighbourhoods.spacing, &neighbourhoods.spacing_of(&vec![0.0; n], &mut None)] {
                assert!(spacing.iter().all(|s| s.is_finite() && *s > 0.0), "{n} points");
            }
            assert!(variation(&neighbourhoods.spacing_of(&vec![2.0; n], &mut None)) < 1e-5);
        }
    }

    #[test]
    fn a_name_is_read_as_it_is_told() {
        for spread in [Spread::Neighbourhood, Spread::Area] {
            assert_eq!(spread.to_string().parse(), Ok(spread));
        }
        assert!("even".parse::<Spread>().expect_err("an error").contains("`area`"));
    }
}
