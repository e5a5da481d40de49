//! Discs into a depth buffer.

use super::shade::Rgb;

/// Discs seen from the side are drawn as if tilted at most this much, lest they vanish.
const LEAST_FACING: f32 = 0.25;

/// A point as the camera sees it.
pub(super) struct Splat {
    /// Pixels from the left.
    pub(super) x: f32,
    /// Pixels from the top.
    pub(super) y: f32,
    /// Local units along the view direction.
    pub(super) depth: f32,
    /// Unit, in the view's axes (right, up, forward), mostly towards the viewer.
    pub(super) normal: [f32; 3],
    /// Local units.
    pub(super) radius: f32,
    /// Linear.
    pub(super) tint: Rgb,
}

/// What is seen at each pixel.
pub(super) struct Canvas {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Depth of the nearest disc; infinite where there is none.
    pub(super) depth: Vec<f32>,
    /// Blended normals, unit where there is a disc.
    pub(super) normal: Vec<[f32; 3]>,
    /// Blended colours.
    pub(super) tint: Vec<Rgb>,
}

impl Canvas {
    pub(super) fn new(width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        let pixels = width * height;
        Self {
            width,
            height,
            depth: vec![f32::INFINITY; pixels],
            normal: vec![[0.0; 3]; pixels],
            tint: vec![[0.0; 3]; pixels],
        }
    }

    /// Draws all splats: first the nearest depths, then the blend of all discs that are about as
    /// near as the nearest one.
    pub(super) fn draw(&mut self, splats: &[Splat], focal: f32) {
        for splat in splats {
            self.pixels(splat, focal, |canvas, at, depth, _| {
                if depth < canvas.depth[at] {
                    canvas.depth[at] = depth;
                }
            });
        }
        let mut weights = vec![0.0_f32; self.depth.len()];
        for splat in splats {
            self.pixels(splat, focal, |canvas, at, depth, inside| {
                if depth <= canvas.depth[at] + splat.radius {
                    // Never quite zero: the rim of a lone disc has a colour too.
                    let weight = (1.0 - inside) * (1.0 - inside) + 1e-3;
                    weights[at] += weight;
                    for (sum, c) in canvas.tint[at].iter_mut().zip(splat.tint) {
                        *sum += weight * c;
                    }
                    for (sum, n) in canvas.normal[at].iter_mut().zip(splat.normal) {
                        *sum += weight * n;
                    }
                }
            });
        }
        for ((normal, tint), weight) in self.normal.iter_mut().zip(&mut self.tint).zip(weights) {
            if weight > 0.0 {
                tint.iter_mut().for_each(|c| *c /= weight);
                let length = normal.iter().map(|c| c * c).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
                normal.iter_mut().for_each(|c| *c /= length);
            }
        }
    }

    /// Visits the pixels of a disc with the depth there, and how far out that is (squared, 1 at
    /// the rim).
    fn pixels(&mut self, s: &Splat, focal: f32, mut visit: impl FnMut(&mut Self, usize, f32, f32)) {
        let unit = s.depth / focal;
        // A disc smaller than a pixel still covers one.
        let radius = s.radius.max(0.71 * unit);
        let reach = radius / unit;
        let span = |centre: f32, side: usize| {
            let first = (centre - reach).floor().max(0.0) as usize;
            first..((centre + reach).ceil().max(0.0) as usize).min(side)
        };
        let facing = s.normal[2].abs().max(LEAST_FACING).copysign(-s.normal[2]);
        let squared = radius * radius;
        for row in span(s.y, self.height) {
            let dy = (s.y - row as f32 - 0.5) * unit;
            for column in span(s.x, self.width) {
                let dx = (column as f32 + 0.5 - s.x) * unit;
                let dz = (s.normal[0] * dx + s.normal[1] * dy) / facing;
                let inside = (dx * dx + dy * dy + dz * dz) / squared;
                if inside <= 1.0 {
                    visit(self, row * self.width + column, s.depth + dz, inside);
                }
            }
        }
    }
}
