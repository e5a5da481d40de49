//! What the neighbourhood of one point is like.

use super::cell::{Flat, voronoi_area};
use densecloud_cloud::{Frame, Point, Position};
use densecloud_geometry::{KdTree, Neighbour, Plane, quadratic_residual};

/// Neighbours looked at.
const NEIGHBOURS: usize = 24;

/// Neighbours within which the surface is about flat.
const FLAT: usize = 16;

/// A cell reaches to this neighbour at most, further than nearly every cell inside a surface does.
const RING: usize = 10;

/// Neighbours that tell the usual spacing.
const CLOSE: usize = 6;

/// The smallest share of the variance of a plane's 16 neighbours across it from which they fill a volume.
const VOLUME: f64 = 0.12;

/// Nearest neighbours through pairs of which, and the point, a plane is laid to find a sheet among several; those of a pair
/// whose directions differ by less than this sine span none.
const SPANNING: usize = 8;
const SPAN: f64 = 0.3;

/// A neighbour lies in a sheet if it is no further from its plane than this share of the usual spacing.
const IN_SHEET: f64 = 0.12;

/// Neighbours in one plane, the spanning ones included, from which they are a sheet, of 24: in a volume most planes
/// have fewer.
const SHEET: usize = 7;

/// The largest share of the middle axis from which they lie on a line.
const LINE: f64 = 0.01;

/// How much further than its neighbours from theirs a point is that stands alone.
const ALONE: f32 = 3.0;

/// Measures of one point, in the cloud's units.
pub(super) struct Local {
    /// Where it is, in the cloud's coordinates.
    pub(super) at: Position,
    /// Distance to the nearest other point.
    pub(super) nearest: f64,
    /// Points a square unit of the tangent plane.
    pub(super) density: f64,
    /// Area of the point's cell in the tangent plane.
    pub(super) cell: f64,
    /// Distance from the surface that its neighbours suggest.
    pub(super) noise: f64,
    pub(super) off_surface: bool,
    pub(super) on_line: bool,
    pub(super) isolated: bool,
}

impl Local {
    /// `None` where there are too few points to say anything.
    pub(super) fn measure(points: &[Point], tree: &KdTree, frame: &Frame, i: usize) -> Option<Self> {
        let mut near = Vec::new();
        tree.nearest(points[i], NEIGHBOURS + 1, &mut near);
        if near.len() < RING + 2 {
            return None;
        }
        let distance = |n: &Neighbour| f64::from(n.distance_squared).sqrt();
        let nearest = distance(&near[1]);
        let flat = &near[..near.len().min(FLAT + 1)];
        let plane = Plane::fit(points, flat);
        let [least, middle, most] = plane.variances;
        let total = least + middle + most;
        // Laid flat: in its direction on the plane, at its own distance, so that a curved surface, of which the
        // plane is a shadow, keeps its size.
        let others: Vec<Flat> = near[1..]
            .iter()
            .map(|n| {
                let shadow = plane.flat(points[i], points[n.index as usize]);
                let length = shadow[0].hypot(shadow[1]);
                let stretch = if length > 0.0 { distance(n) / length } else { 1.0 };
                shadow.map(|c| c * stretch)
            })
            .collect();
        let ring = distance(&near[RING]);
        let (mut cell, open) = voronoi_area(&others, ring);
        if open {
            // What is beyond a border belongs to nobody; half a usual spacing is what a cell inside has.
            let usual = near[1..=CLOSE].iter().map(distance).sum::<f64>() / CLOSE as f64;
            cell = voronoi_area(&others, 0.5 * usual).0;
        }
        let reach = distance(&flat[flat.len() - 1]);
        // Between this one and the last, which lies on the circle's rim.
        let density = (flat.len() - 1) as f64 / (std::f64::consts::PI * reach * reach);
        let isolated = isolated(points, tree, &near);
        // In the cloud's units.
        let unit = frame.scale();
        Some(Self {
            at: frame.to_world(points[i]),
            nearest: nearest * unit,
            density: density / (unit * unit),
            // A lone return is no surface.
            cell: if isolated { 0.0 } else { cell * unit * unit },
            noise: quadratic_residual(points, &near) * unit,
            off_surface: least > VOLUME * total && !in_sheet(points, &near),
            on_line: middle < LINE * most,
            isolated,
        })
    }
}

/// Whether the first of `near` lies in a sheet, if beside others: a thin part's two sides fill a volume together, and
/// are surfaces.
fn in_sheet(points: &[Point], near: &[Neighbour]) -> bool {
    let at = |n: &Neighbour| points[n.index as usize].map(f64::from);
    let origin = at(&near[0]);
    let others: Vec<[f64; 3]> =
        near[1..].iter().map(at).map(|p| std::array::from_fn(|a| p[a] - origin[a])).collect();
    let close = others.iter().take(CLOSE).map(|p| dot(*p, *p).sqrt());
    let tolerance = IN_SHEET * close.sum::<f64>() / CLOSE as f64;
    let spanning = &others[..others.len().min(SPANNING)];
    spanning.iter().enumerate().any(|(i, p)| {
        spanning[i + 1..].iter().any(|q| {
            let normal = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
            let length = dot(normal, normal).sqrt();
            let in_plane = |o: &&[f64; 3]| dot(normal, **o).abs() <= tolerance * length;
            length > SPAN * (dot(*p, *p) * dot(*q, *q)).sqrt()
                && others.iter().filter(in_plane).count() >= SHEET
        })
    })
}

fn dot(p: [f64; 3], q: [f64; 3]) -> f64 {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}

/// Compares the distance to the third neighbour with those of the three themselves.
fn isolated(points: &[Point], tree: &KdTree, near: &[Neighbour]) -> bool {
    let mut found = Vec::new();
    let mut theirs = [0.0_f32; 3];
    for (their, n) in theirs.iter_mut().zip(&near[1..]) {
        tree.nearest(points[n.index as usize], 4, &mut found);
        *their = found.last().map_or(0.0, |n| n.distance_squared);
    }
    // The middle one: another stray may be near, and so may a cluster.
    theirs.sort_unstable_by(f32::total_cmp);
    near[3].distance_squared > ALONE * ALONE * theirs[1]
}
