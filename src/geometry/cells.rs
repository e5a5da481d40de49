//! How much of a surface a point of a cloud stands for.

use std::f32::consts::{FRAC_1_SQRT_2, PI};

use super::Neighbour;
use super::mls::tangents;
use crate::cloud::Point;

/// Directions of a quarter turn.
const QUARTER: usize = 4;
/// Their cosines and sines; the others are these, turned.
const DIRECTIONS: [[f32; 2]; QUARTER] = [[1.0, 0.0], [COS, SIN], [FRAC_1_SQRT_2, FRAC_1_SQRT_2], [SIN, COS]];
/// Of an eighth of a half turn.
const COS: f32 = 0.923_879_5;
const SIN: f32 = 0.382_683_43;

/// The area of the Voronoi cell of point `i` in its tangent plane, as far as that is within `radius` of the point.
///
/// `near` are its nearest, the point itself among them, and bound the cell; `normal` is a unit vector. Those that lie no
/// further than `flat` from the tangent plane are taken to lie in it: a rough sheet has no more area than a smooth one.
/// Others bound the cell where they are as near as the point itself. The boundary is measured in 16 directions: exact on
/// average over the turns of a cell (a square comes out 5 % too large or too small), O(`near`). Points in one place share
/// one cell. All cells of a cloud together are the area of the surface and of what lies within `radius` of its points
/// past its borders.
pub(crate) fn cell_area(
    points: &[Point],
    i: usize,
    near: &[Neighbour],
    normal: [f32; 3],
    radius: f32,
    flat: f32,
) -> f32 {
    let (u, v) = tangents(normal.map(f64::from));
    let along = |axis: [f64; 3], edge: Point| (0..3).map(|a| axis[a] as f32 * edge[a]).sum::<f32>();
    // The reciprocal of the distance to the boundary, a maximum over the bisectors with all neighbours.
    let mut nearness = [[1.0 / radius; QUARTER]; 4];
    let mut together = 0;
    for n in near {
        let q = points[n.index as usize];
        let edge = std::array::from_fn(|a| q[a] - points[i][a]);
        let (x, y) = (along(u, edge), along(v, edge));
        let height = (0..3).map(|a| normal[a] * edge[a]).sum::<f32>();
        let squared = x * x + y * y + if height.abs() > flat { height * height } else { 0.0 };
        if squared == 0.0 {
            together += 1;
            continue;
        }
        let (x, y) = (2.0 * x / squared, 2.0 * y / squared);
        for (d, [cos, sin]) in DIRECTIONS.into_iter().enumerate() {
            let (ahead, aside) = (cos * x + sin * y, cos * y - sin * x);
            for (turn, value) in [ahead, aside, -ahead, -aside].into_iter().enumerate() {
                nearness[turn][d] = nearness[turn][d].max(value);
            }
        }
    }
    let squares: f32 = nearness.as_flattened().iter().map(|n| 1.0 / (n * n)).sum();
    PI / (4 * QUARTER) as f32 * squares / together.max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::super::{KdTree, Rng, farthest_point_sampling, normal};
    use super::*;

    /// The areas of the cells of all `points`.
    fn areas(points: &[Point], radius: f32) -> Vec<f32> {
        let tree = KdTree::new(points);
        let mut near = Vec::new();
        let area = |i: usize| {
            tree.nearest(points[i], 12, &mut near);
            cell_area(points, i, &near, normal(points, &near), radius, 0.0)
        };
        (0..points.len()).map(area).collect()
    }

    #[test]
    fn a_cell_of_a_grid_is_a_square_and_of_a_lone_point_a_disc() {
        let grid: Vec<Point> = (0..400).map(|i| [(i % 20) as f32, (i / 20) as f32, 7.0]).collect();
        let areas = areas(&grid, 5.0);
        let inner = areas[10 * 20 + 10];
        // 5 % too much in this one turn of the square, as much too little in others.
        assert!((inner - 1.0).abs() < 0.06, "{inner}");
        let alone =
            cell_area(&grid, 0, &[Neighbour { index: 0, distance_squared: 0.0 }], [0.0, 0.0, 1.0], 3.0, 0.0);
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
        let found = areas(&points, 0.3);
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
                cell_area(points, i, &near, [0.0, 0.0, 1.0], 0.05, flat)
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
        let (once, both): (f32, f32) = (areas(&square, 1.0).iter().sum(), areas(&twice, 1.0).iter().sum());
        // 20 by 20, and a rim as wide as the radius but for the cells' round ends; cells of squares are 5 % too large.
        assert!((470.0..508.0).contains(&once), "{once}");
        assert!((both / once - 1.0).abs() < 0.1, "{both} and {once}");
    }
}
