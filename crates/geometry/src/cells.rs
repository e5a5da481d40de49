//! How much of a surface a point of a cloud stands for.

use std::f32::consts::{FRAC_1_SQRT_2, PI};

use super::Neighbour;
use super::mls::tangents;
use densecloud_cloud::Point;

/// Directions of a quarter turn.
const QUARTER: usize = 4;
/// Their cosines and sines; the others are these, turned.
const DIRECTIONS: [[f32; 2]; QUARTER] = [[1.0, 0.0], [COS, SIN], [FRAC_1_SQRT_2, FRAC_1_SQRT_2], [SIN, COS]];
/// Of an eighth of a half turn.
const COS: f32 = 0.923_879_5;
const SIN: f32 = 0.382_683_43;

/// No neighbour is within 60 degrees of an open direction: this is the cosine. A straight border leaves a gap of 180
/// degrees; one of 120 or more, a direction beside it more or less, is taken for a border.
const OPEN: f32 = 0.5;

/// How far a cell may go, in lengths.
#[derive(Debug, Clone, Copy)]
pub struct Reach {
    /// From the point, wherever no neighbour bounds the cell.
    pub radius: f32,
    /// The same past a point that has neighbours on one side only; no more than the radius.
    pub past: f32,
    /// From the tangent plane, for a neighbour to count as lying in it.
    pub flat: f32,
}

/// The area of the Voronoi cell of point `i` in its tangent plane, as far as that is within `reach` of the point.
///
/// `near` are its nearest, the point itself among them, and bound the cell; `normal` is a unit vector. Those that are
/// `reach.flat` are taken to lie in the tangent plane: a rough sheet has no more area than a smooth one.
/// Others bound the cell where they are as near as the point itself. The boundary is measured in 16 directions: exact on
/// average over the turns of a cell (a square comes out 5 % too large or too small), O(`near`). Points in one place share
/// one cell. All cells of a cloud together are the area of the surface and of what lies within `reach` of its points
/// past its borders.
pub fn cell_area(points: &[Point], i: usize, near: &[Neighbour], normal: [f32; 3], reach: Reach) -> f32 {
    let plane = Tangent::of(points[i], normal);
    // The reciprocal of the distance to the boundary, a maximum over the bisectors with all neighbours.
    let mut nearness = [[1.0 / reach.radius; QUARTER]; 4];
    let mut together = 0;
    for n in near {
        let ([x, y], height) = plane.edge(points[n.index as usize]);
        let squared = x * x + y * y + if height.abs() > reach.flat { height * height } else { 0.0 };
        if squared == 0.0 {
            together += 1;
            continue;
        }
        raise(&mut nearness, [2.0 * x / squared, 2.0 * y / squared]);
    }
    if reach.past < reach.radius
        && let Some([x, y]) = outwards(points, &plane, near)
    {
        raise(&mut nearness, [x / reach.past, y / reach.past]);
    }
    let squares: f32 = nearness.as_flattened().iter().map(|n| 1.0 / (n * n)).sum();
    PI / (4 * QUARTER) as f32 * squares / together.max(1) as f32
}

/// Whether point `i` has those that are `near` on one side only, seen in its tangent plane: whether it lies on a border.
pub fn one_sided(points: &[Point], i: usize, near: &[Neighbour], normal: [f32; 3]) -> bool {
    outwards(points, &Tangent::of(points[i], normal), near).is_some()
}

/// The unit vector from a point's neighbours to where it has none, if they leave out enough.
fn outwards(points: &[Point], plane: &Tangent, near: &[Neighbour]) -> Option<[f32; 2]> {
    // The cosine of the angle to the neighbour that lies closest to each direction.
    let mut towards = [[-1.0_f32; QUARTER]; 4];
    for n in near {
        let ([x, y], height) = plane.edge(points[n.index as usize]);
        let length = (x * x + y * y + height * height).sqrt();
        if length > 0.0 {
            raise(&mut towards, [x / length, y / length]);
        }
    }
    let (mut count, mut sum) = (0.0, [0.0_f32; 2]);
    for (turn, row) in towards.iter().enumerate() {
        for ([cos, sin], _) in DIRECTIONS.into_iter().zip(row).filter(|(_, cosine)| **cosine < OPEN) {
            let [x, y] = [[cos, sin], [-sin, cos], [-cos, -sin], [sin, -cos]][turn];
            (count, sum) = (count + 1.0, [sum[0] + x, sum[1] + y]);
        }
    }
    let length = sum[0].hypot(sum[1]);
    // Open on opposite sides is a thread, which has no one border.
    (length > 0.7 * count).then(|| sum.map(|c| c / length))
}

/// Raises each direction's value to its product with a vector.
fn raise(values: &mut [[f32; QUARTER]; 4], [x, y]: [f32; 2]) {
    for (d, [cos, sin]) in DIRECTIONS.into_iter().enumerate() {
        let (ahead, aside) = (cos * x + sin * y, cos * y - sin * x);
        for (turn, value) in [ahead, aside, -ahead, -aside].into_iter().enumerate() {
            values[turn][d] = values[turn][d].max(value);
        }
    }
}

/// A plane through a point.
struct Tangent {
    origin: Point,
    axes: [[f32; 3]; 2],
    normal: [f32; 3],
}

impl Tangent {
    fn of(origin: Point, normal: [f32; 3]) -> Self {
        let (u, v) = tangents(normal.map(f64::from));
        Self { origin, axes: [u, v].map(|axis| axis.map(|c| c as f32)), normal }
    }

    /// From the origin to a point: along the axes, and off the plane.
    fn edge(&self, q: Point) -> ([f32; 2], f32) {
        let edge: [f32; 3] = std::array::from_fn(|a| q[a] - self.origin[a]);
        let along = |axis: [f32; 3]| (0..3).map(|a| axis[a] * edge[a]).sum::<f32>();
        (self.axes.map(along), along(self.normal))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{KdTree, Rng, farthest_point_sampling, normal};
    use super::*;

    /// The areas of the cells of all `points`.
    fn areas(points: &[Point], radius: f32, past: f32) -> Vec<f32> {
        let tree = KdTree::new(points);
        let mut near = Vec::new();
        let area = |i: usize| {
            tree.nearest(points[i], 12, &mut near);
            cell_area(points, i, &near, normal(points, &near), Reach { radius, past, flat: 0.0 })
        };
        (0..points.len()).map(area).collect()
    }

    #[test]
    fn a_cell_of_a_grid_is_a_square_and_of_a_lone_point_a_disc() {
        let grid: Vec<Point> = (0..400).map(|i| [(i % 20) as f32, (i / 20) as f32, 7.0]).collect();
        let areas = areas(&grid, 5.0, 5.0);
        let inner = areas[10 * 20 + 10];
        // 5 % too much in this one turn of the square, as much too little in others.
        assert!((inner - 1.0).abs() < 0.06, "{inner}");
        let reach = Reach { radius: 3.0, past: 3.0, flat: 0.0 };
        let itself = [Neighbour { index: 0, distance_squared: 0.0 }];
        let alone = cell_area(&grid, 0, &itself, [0.0, 0.0, 1.0], reach);
        assert!((alone - 9.0 * PI).abs() < 1e-3, "{alone}");
    }

    #[test]
    fn cells_are_as_large_as_a_count_of_the_surface_nearest_to_each_point() {
        // On a sphere, uneven: one half has four times the points of the other.
        let mut random = Rng::new(3);
        let mut sphere = |n: usize| -> Vec<Point> {
            let next = |random: &mut Rng| -> Point {
                let p: [f64; 3] = std::array::from_fn(|_| random.normal());
                let length = p.iter().map(|c| c * c).sum::<f64>().sqrt();
                p.map(|c| (c / length) as f32)
            };
            (0..n).map(|_| next(&mut random)).collect()
        };
        let all = sphere(30_000);
        let order = farthest_point_sampling(&all, 2000, 0);
        let points: Vec<Point> = order
            .iter()
            .enumerate()
            .filter(|(k, i)| *k < 500 || all[**i as usize][2] > 0.0)
            .map(|(_, i)| all[*i as usize])
            .collect();
        let found = areas(&points, 0.3, 0.3);
        // Brute force: of many points of the sphere, those nearest to each.
        let many = sphere(200_000);
        let tree = KdTree::new(&points);
        let mut counts = vec![0.0_f32; points.len()];
        many.iter().for_each(|p| counts[tree.nearest_one(*p).expect("a point").index as usize] += 1.0);
        let scale = 4.0 * PI / many.len() as f32;
        let [mut upper, mut lower] = [[0.0; 2]; 2];
        for ((p, found), count) in points.iter().zip(&found).zip(&counts) {
            let half = if p[2] > 0.0 { &mut upper } else { &mut lower };
            half[0] += found;
            half[1] += count * scale;
        }
        for half in [upper, lower] {
            assert!((half[0] / half[1] - 1.0).abs() < 0.03, "{half:?}");
        }
        let errors = found.iter().zip(&counts).map(|(found, count)| (found / (count * scale) - 1.0).abs());
        let mean = errors.sum::<f32>() / found.len() as f32;
        assert!(mean < 0.1, "cells are off by {mean}");
    }

    #[test]
    fn a_rough_sheet_has_the_area_of_a_smooth_one_and_two_sheets_have_twice_that() {
        let mut random = Rng::new(5);
        let mut sheet = |height: f32, rough: f32| -> Vec<Point> {
            let all: Vec<Point> =
                (0..8000).map(|_| [random.f64() as f32, random.f64() as f32, height]).collect();
            let even = farthest_point_sampling(&all, 2000, 0);
            even.iter()
                .map(|&i| all[i as usize])
                .map(|p| [p[0], p[1], p[2] + rough * random.normal() as f32])
                .collect()
        };
        // The spacing is 0.022.
        let (smooth, rough) = (sheet(0.0, 0.0), sheet(0.0, 0.006));
        let apart: Vec<Point> = sheet(0.0, 0.0).into_iter().chain(sheet(0.03, 0.0)).collect();
        let area = |points: &[Point], flat: f32| -> f32 {
            let tree = KdTree::new(points);
            let mut near = Vec::new();
            let area = |i: usize| {
                tree.nearest(points[i], 12, &mut near);
                cell_area(points, i, &near, [0.0, 0.0, 1.0], Reach { radius: 0.05, past: 0.05, flat })
            };
            (0..points.len()).map(area).sum()
        };
        let one = area(&smooth, 0.015);
        let (flat, bumpy) = (area(&rough, 0.015), area(&rough, 0.0));
        assert!((flat / one - 1.0).abs() < 0.08, "{flat} against {one}");
        assert!(bumpy > 1.1 * one, "{bumpy} against {one}");
        assert!(area(&apart, 0.01) > 1.7 * one, "{} against {one}", area(&apart, 0.01));
    }

    #[test]
    fn points_in_one_place_share_a_cell_and_a_border_adds_the_radius() {
        let square: Vec<Point> = (0..441).map(|i| [(i % 21) as f32, (i / 21) as f32, 0.0]).collect();
        let twice: Vec<Point> = square.iter().chain(&square).copied().collect();
        let sum = |points: &[Point], past: f32| areas(points, 1.0, past).iter().sum::<f32>();
        let (once, both) = (sum(&square, 1.0), sum(&twice, 1.0));
        // 20 by 20, and a rim as wide as the radius but for the cells' round ends; cells of squares are 5 % too large.
        assert!((470.0..508.0).contains(&once), "{once}");
        assert!((both / once - 1.0).abs() < 0.1, "{both} and {once}");
        // A border that is known to be near: a rim of a tenth, but for the corners.
        let ended = sum(&square, 0.1);
        assert!((400.0..432.0).contains(&ended), "{ended}");
    }

    #[test]
    fn what_has_neighbours_on_one_side_is_a_border_and_nothing_inside_is() {
        let mut random = Rng::new(7);
        let all: Vec<Point> = (0..8000).map(|_| [random.f64() as f32, random.f64() as f32, 0.0]).collect();
        let even = farthest_point_sampling(&all, 1000, 0);
        let points: Vec<Point> = even.iter().map(|&i| all[i as usize]).collect();
        let tree = KdTree::new(&points);
        let mut near = Vec::new();
        // Of those that lie further than `from` and no further than `to` from the middle, in x or in y.
        let mut share = |from: f32, to: f32| {
            let out = |p: &Point| (p[0] - 0.5).abs().max((p[1] - 0.5).abs());
            let ring: Vec<usize> = (0..1000).filter(|&i| (from..to).contains(&out(&points[i]))).collect();
            let sided = ring.iter().filter(|&&i| {
                tree.nearest(points[i], 12, &mut near);
                one_sided(&points, i, &near, [0.0, 0.0, 1.0])
            });
            sided.count() as f64 / ring.len() as f64
        };
        // The spacing is 0.03.
        let (border, inside) = (share(0.495, 0.5), share(0.0, 0.45));
        assert!(border > 0.9, "{border} of the border");
        assert!(inside < 0.01, "{inside} of the inside");
    }
}
