//! Surfaces from points with normals: screened Poisson reconstruction near the points.
//!
//! After Kazhdan & Hoppe (2013): the surface is where a function is zero whose gradient fits the normals, spread over space by the
//! area of each point, and which is small at the points themselves. The function is trilinear on a sparse grid of one cell
//! size, about the points alone; it is solved for from a coarse grid to ever finer ones, each adding what its cells can
//! tell. A point in sparser surroundings counts on the coarser grid that fits these.

mod grid;
mod level;
mod march;
mod trim;

use rayon::prelude::*;

use densecloud_cloud::Point;

use super::{KdTree, Walk};
use level::Level;

/// Neighbours by which a point's area is measured.
const NEIGHBOURS: usize = 8;
/// How far about a point the function is known, in spacings there and in cells.
const REACH: [f64; 2] = [3.0, 2.0];
/// The least side of a cell that a point's spacing asks for, in spacings.
const FINEST_OF_SPACING: f64 = 0.7;
/// How many times the median a point's area may be.
const MOST_AREA: f64 = 16.0;
/// Cells across the coarsest grid.
const COARSEST: f64 = 8.0;
/// Nodes of the finest grid: some 6 GB.
const MOST_NODES: usize = 1 << 24;

/// How to make a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoissonSettings {
    /// Side of a cell, in units of the points; none for the median spacing.
    pub cell: Option<f64>,
    /// How far from the nearest point, in spacings there, surface is kept.
    pub trim: f64,
}

/// A surface as triangles: corners in units of the points, and three of them a triangle, counterclockwise as seen from
/// where the normals point.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surface {
    /// Where the corners are.
    pub vertices: Vec<[f64; 3]>,
    /// Three corners a triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Side of a cell of the grid.
    pub cell: f64,
    /// Sides of triangles that have one triangle: zero for a closed surface.
    pub open_sides: usize,
}

/// Why no surface can be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PoissonError {
    /// Too few points, or all near one place or line.
    #[error("there are too few points apart from each other to tell a surface: at least 16 are needed")]
    TooFew,
    /// The grid would be too large.
    #[error("cells of that size make a grid of more than {MOST_NODES} nodes; take larger ones")]
    TooFine,
    /// Nothing of the surface is near the points.
    #[error("no surface lies near the points; their normals may contradict each other")]
    Nothing,
}

/// The points as the levels see them.
struct Samples {
    /// In units of the points, from the grid's corner.
    places: Vec<[f64; 3]>,
    normals: Vec<[f32; 3]>,
    areas: Vec<f64>,
    /// The level that each belongs to, 0 the finest.
    levels: Vec<u8>,
}

/// The surface through points with unit normals that point to one side of it.
///
/// O(n log n) on all threads of the current pool; the result does not depend on their number. Memory is some 2.5 kB a point
/// where cells are as large as the spacing, growing with the square of the cells.
///
/// # Errors
/// There is no surface, or cells are too small: see [`PoissonError`].
pub fn reconstruct(
    points: &[Point],
    normals: &[[f32; 3]],
    settings: PoissonSettings,
) -> Result<Surface, PoissonError> {
    let tree = KdTree::new(points);
    let areas = areas(points, &tree)?;
    let cell = settings.cell.unwrap_or_else(|| median(&areas).sqrt());
    let (samples, corner) = samples(points, normals, &areas, cell);
    let levels = levels(&samples, cell)?;
    let values = solved(&levels, &samples);
    let (mut vertices, triangles) = march::surface(&levels[0], &values);
    vertices.as_flattened_mut().chunks_exact_mut(3).for_each(|v| (0..3).for_each(|a| v[a] += corner[a]));
    let spacings: Vec<f64> = areas.iter().map(|area| area.sqrt()).collect();
    let surface = trim::trimmed(vertices, triangles, &tree, &spacings, settings.trim);
    if surface.triangles.is_empty() { Err(PoissonError::Nothing) } else { Ok(Surface { cell, ..surface }) }
}

/// What surface each point stands for, in square units.
fn areas(points: &[Point], tree: &KdTree) -> Result<Vec<f64>, PoissonError> {
    if points.len() < 2 * NEIGHBOURS {
        return Err(PoissonError::TooFew);
    }
    let area = |walk: &mut Walk, point: &Point| {
        tree.nearest_next(*point, NEIGHBOURS + 1, walk);
        let furthest = walk.found.last().map_or(0.0, |n| f64::from(n.distance_squared));
        furthest * std::f64::consts::PI / NEIGHBOURS as f64
    };
    let mut areas: Vec<f64> = points.par_iter().map_init(Walk::default, area).collect();
    let middle = median(&areas);
    // Points in one place have no area of their own.
    areas.iter_mut().for_each(|a| *a = a.clamp(middle / MOST_AREA, middle * MOST_AREA));
    if middle > 0.0 { Ok(areas) } else { Err(PoissonError::TooFew) }
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The points on a grid's coordinates, whose corner is given too, far enough outside for all that is put about them.
fn samples(points: &[Point], normals: &[[f32; 3]], areas: &[f64], cell: f64) -> (Samples, [f64; 3]) {
    let room = 2.0 * COARSEST * cell.max(areas.iter().fold(0.0_f64, |a, b| a.max(*b)).sqrt());
    let (low, high) = bounds(points);
    let extent = (0..3).fold(0.0_f64, |most, a| most.max(high[a] - low[a]));
    // Cells of the coarsest grid are up to two thirds of the extent, and each level goes one further out than the one before.
    let corner = low.map(|c| c - 4.0 * extent - room);
    let places = points.iter().map(|p| std::array::from_fn(|a| f64::from(p[a]) - corner[a])).collect();
    let level = |area: &f64| (area.sqrt() * FINEST_OF_SPACING / cell).log2().ceil().clamp(0.0, 20.0) as u8;
    let levels = areas.iter().map(level).collect();
    (Samples { places, normals: normals.to_vec(), areas: areas.to_vec(), levels }, corner)
}

fn bounds(points: &[Point]) -> ([f64; 3], [f64; 3]) {
    let mut bounds = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for p in points {
        for (a, c) in p.iter().map(|c| f64::from(*c)).enumerate() {
            bounds.0[a] = bounds.0[a].min(c);
            bounds.1[a] = bounds.1[a].max(c);
        }
    }
    bounds
}

/// All levels, the finest first.
fn levels(samples: &Samples, cell: f64) -> Result<Vec<Level>, PoissonError> {
    let furthest = samples.places.as_flattened().iter().fold(0.0_f64, |a, b| a.max(*b));
    if furthest / cell > grid::MOST_ACROSS {
        return Err(PoissonError::TooFine);
    }
    let mut cells = cells_about(samples, cell)?;
    let mut side = cell;
    let mut levels = Vec::new();
    let deepest = samples.levels.iter().copied().max().unwrap_or(0);
    loop {
        let last = across(&cells) <= COARSEST && levels.len() >= usize::from(deepest);
        let coarser = grid::coarser(&cells);
        let level = Level::new(side, cells, samples, last);
        levels.push(level);
        if last {
            return Ok(levels);
        }
        (cells, side) = (coarser, 2.0 * side);
    }
}

/// Cells along the longest side of the box about all.
fn across(cells: &[grid::Key]) -> f64 {
    let mut bounds = ([u32::MAX; 3], [0; 3]);
    for c in cells.iter().map(|cell| grid::coordinates(*cell)) {
        for (a, c) in c.into_iter().enumerate() {
            bounds.0[a] = bounds.0[a].min(c);
            bounds.1[a] = bounds.1[a].max(c);
        }
    }
    (0..3).map(|a| f64::from(bounds.1[a] - bounds.0[a] + 1)).fold(0.0, f64::max)
}

/// The cells within reach of a point.
fn cells_about(samples: &Samples, side: f64) -> Result<Vec<grid::Key>, PoissonError> {
    let reach = |i: usize| (REACH[0] * samples.areas[i].sqrt()).max(REACH[1] * side) / side;
    let expected: f64 = (0..samples.places.len()).map(|i| (samples.areas[i] / side.powi(2)) * reach(i)).sum();
    if expected > MOST_NODES as f64 {
        return Err(PoissonError::TooFine);
    }
    let of = |chunk: usize| {
        let end = samples.places.len().min((chunk + 1) * 1024);
        grid::distinct((chunk * 1024..end).flat_map(|i| ball(samples.places[i], reach(i), side)).collect())
    };
    let chunks = samples.places.len().div_ceil(1024);
    let cells = grid::distinct((0..chunks).into_par_iter().flat_map_iter(of).collect());
    if cells.len() > MOST_NODES { Err(PoissonError::TooFine) } else { Ok(cells) }
}

/// The cells of which any part lies within `reach` sides of a place.
fn ball(place: [f64; 3], reach: f64, side: f64) -> impl Iterator<Item = grid::Key> {
    let p = place.map(|c| c / side);
    let range = move |a: usize| (p[a] - reach) as u32..=(p[a] + reach) as u32;
    let away = move |a: usize, c: u32| {
        let low = f64::from(c);
        (low - p[a]).max(p[a] - low - 1.0).max(0.0).powi(2)
    };
    range(0)
        .flat_map(move |x| range(1).flat_map(move |y| range(2).map(move |z| [x, y, z])))
        .filter(move |c| (0..3).map(|a| away(a, c[a])).sum::<f64>() <= reach * reach)
        .map(grid::key)
}

/// The function at the nodes of the finest level.
fn solved(levels: &[Level], samples: &Samples) -> Vec<f64> {
    let parents: Vec<Vec<[u32; 8]>> =
        levels.windows(2).map(|pair| grid::parents(&pair[0].nodes, &pair[1].nodes)).collect();
    let finer = right_sides_of_finer(levels, samples, &parents);
    let (mut values, mut field) = (Vec::new(), Vec::new());
    for (n, level) in levels.iter().enumerate().rev() {
        field = fined(&field, parents.get(n), level.nodes.len(), || [0.0; 3]);
        for (sum, own) in field.iter_mut().zip(level.spread(samples, n as u8)) {
            (0..3).for_each(|a| sum[a] += own[a]);
        }
        let flat: Vec<[f64; 1]> = fined(&values, parents.get(n), level.nodes.len(), || [0.0]);
        let mut now: Vec<f64> = flat.into_iter().flatten().collect();
        let right: Vec<f64> = level.divergence(&field).iter().zip(&finer[n]).map(|(a, b)| a + b).collect();
        level.solve(samples, &right, &mut now);
        values = now.into_iter().map(|value| [value]).collect();
    }
    values.into_iter().flatten().collect()
}

/// For each level, what samples that belong to finer ones add to its right side.
fn right_sides_of_finer(levels: &[Level], samples: &Samples, parents: &[Vec<[u32; 8]>]) -> Vec<Vec<f64>> {
    let mut all = vec![vec![0.0; levels[0].nodes.len()]];
    for (n, parents) in parents.iter().enumerate() {
        let own = levels[n].divergence(&levels[n].spread(samples, n as u8));
        let mut sums = vec![0.0; levels[n + 1].nodes.len()];
        for ((own, finer), parents) in own.iter().zip(&all[n]).zip(parents) {
            let share = (own + finer) / 8.0;
            parents.iter().filter(|p| **p != grid::NONE).for_each(|p| sums[*p as usize] += share);
        }
        all.push(sums);
    }
    all
}

/// Values at the nodes of a finer grid, which lie between those of the coarser one; `zero` where there is none.
fn fined<const N: usize>(
    coarse: &[[f64; N]],
    parents: Option<&Vec<[u32; 8]>>,
    nodes: usize,
    zero: fn() -> [f64; N],
) -> Vec<[f64; N]> {
    let Some(parents) = parents else { return vec![zero(); nodes] };
    let mean = |of: &[u32; 8]| {
        let mut sum = zero();
        for at in of.iter().filter(|at| **at != grid::NONE) {
            (0..N).for_each(|a| sum[a] += coarse[*at as usize][a] / 8.0);
        }
        sum
    };
    parents.par_iter().map(mean).collect()
}

#[cfg(test)]
mod tests;
