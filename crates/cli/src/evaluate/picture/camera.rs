//! Where points appear on the image.

use super::shade::Rgb;
use super::splat::Splat;
use super::{Axis, SIDEWAYS, View};
use densecloud_cloud::Point;

/// Half of the angle of view: narrow, so that shapes are hardly distorted.
const HALF_ANGLE: f64 = 12.0;
/// Share of the image left empty on each side.
const MARGIN: f64 = 0.05;
/// Strays lie farther out than this many times the range of the inner 96 %.
const STRAY: f64 = 0.75;

/// A perspective camera that fits all clouds.
pub(super) struct Camera {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Right, up and forward in local coordinates: the view's axes.
    axes: [[f64; 3]; 3],
    eye: [f64; 3],
    /// Pixels for a slope of one.
    pub(super) focal: f64,
    /// Where the forward axis meets the image, in pixels.
    pub(super) centre: [f64; 2],
    /// Depths of the nearest and the farthest point.
    pub(super) depths: (f64, f64),
}

impl Camera {
    /// A camera for an image of `width` x `height` that shows all points.
    pub(super) fn fit(clouds: &[Vec<Point>], view: View, width: u32, height: u32) -> Self {
        let axes = axes(view);
        let along = |p: &Point| axes.map(|axis| dot(axis, p.map(f64::from)));
        let turned: Vec<[f64; 3]> = clouds.iter().flatten().map(along).collect();
        let ranges: [(f64, f64); 3] = std::array::from_fn(|a| range(turned.iter().map(|p| p[a])));
        let middle = ranges.map(|(lo, hi)| (lo + hi) / 2.0);
        let half_diagonal = ranges.iter().map(|(lo, hi)| ((hi - lo) / 2.0).powi(2)).sum::<f64>().sqrt();
        let distance = half_diagonal.max(1e-9) / HALF_ANGLE.to_radians().sin();
        let depth = |p: &[f64; 3]| p[2] - middle[2] + distance;
        let slope = |a: usize| range(turned.iter().map(|p| (p[a] - middle[a]) / depth(p)));
        let (x, y) = (slope(0), slope(1));
        let inside = 1.0 - 2.0 * MARGIN;
        let zoom = |side: u32, (lo, hi): (f64, f64)| inside * f64::from(side) / (hi - lo).max(1e-6);
        let focal = zoom(width, x).min(zoom(height, y));
        let centre = [
            f64::from(width) / 2.0 - focal * (x.0 + x.1) / 2.0,
            f64::from(height) / 2.0 + focal * (y.0 + y.1) / 2.0,
        ];
        let eye = [middle[0], middle[1], middle[2] - distance];
        let depths = range(turned.iter().map(depth));
        Self { width, height, axes, eye, focal, centre, depths }
    }

    /// The length of a pixel at the middle of the depths, in local units.
    pub(super) fn pixel(&self) -> f64 {
        (self.depths.0 + self.depths.1) / 2.0 / self.focal
    }

    /// The normal on the viewer's side, in the view's axes. Of a disc seen from the side that is a
    /// toss-up, and its light would be wrong half of the time; but an outline is convex towards
    /// the viewer, so there the side is the one that points `out` of the neighbours.
    pub(super) fn towards(&self, p: Point, normal: [f32; 3], out: [f32; 3]) -> [f64; 3] {
        let (p, n, out) = (self.seen(p), self.turn(normal), self.turn(out));
        let facing = -dot(n, p) / dot(p, p).sqrt();
        let side = if facing.abs() < SIDEWAYS { dot(n, out) } else { facing };
        if side < 0.0 { n.map(|c| -c) } else { n }
    }

    /// A point as it is drawn.
    pub(super) fn splat(&self, p: Point, normal: [f64; 3], radius: f64, tint: Rgb) -> Splat {
        let p = self.seen(p);
        Splat {
            x: (self.centre[0] + self.focal * p[0] / p[2]) as f32,
            y: (self.centre[1] - self.focal * p[1] / p[2]) as f32,
            depth: p[2] as f32,
            normal: normal.map(|c| c as f32),
            radius: radius as f32,
            tint,
        }
    }

    fn turn(&self, v: [f32; 3]) -> [f64; 3] {
        self.axes.map(|axis| dot(axis, v.map(f64::from)))
    }

    /// A point in the view's axes, from the eye.
    fn seen(&self, p: Point) -> [f64; 3] {
        let p = self.turn(p);
        std::array::from_fn(|a| p[a] - self.eye[a])
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Right, up and forward.
fn axes(view: View) -> [[f64; 3]; 3] {
    const X: [f64; 3] = [1.0, 0.0, 0.0];
    const Y: [f64; 3] = [0.0, 1.0, 0.0];
    const Z: [f64; 3] = [0.0, 0.0, 1.0];
    // Seen from the front; right, forward and up are a right-handed system.
    let (right, forward, up) = match view.up {
        Axis::X => (Y, Z, X),
        Axis::Y => (X, Z.map(|c| -c), Y),
        Axis::Z => (X, Y, Z),
    };
    let mix = |a: [f64; 3], s: f64, b: [f64; 3], t: f64| -> [f64; 3] {
        std::array::from_fn(|i| s * a[i] + t * b[i])
    };
    let (sin, cos) = view.azimuth.to_radians().sin_cos();
    let (ahead, right) = (mix(forward, cos, right, -sin), mix(right, cos, forward, sin));
    let (sin, cos) = view.elevation.to_radians().sin_cos();
    [right, mix(up, cos, ahead, sin), mix(ahead, cos, up, -sin)]
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)))
}

/// The range of all values but strays: of those that are near the inner 96 %.
pub(super) fn robust_range(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_unstable_by(f64::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return (0.0, 0.0) };
    let cut = last / 50;
    let (lo, hi) = (values[cut], values[last - cut]);
    let reach = STRAY * (hi - lo);
    // With few points nothing can be told to be a stray.
    if cut == 0 { (lo, hi) } else { (lo - reach, hi + reach) }
}
