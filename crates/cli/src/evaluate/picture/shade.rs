//! From what is seen to colours.

use rayon::prelude::*;

use super::camera::Camera;
use super::splat::Canvas;
use super::{Image, Shade};

pub(super) type Rgb = [f32; 3];

/// Reach of ambient occlusion, as a share of the depth range of the scene.
const OCCLUSION_REACH: f32 = 0.12;
const OCCLUSION_SAMPLES: usize = 24;
const OCCLUSION_STRENGTH: f32 = 1.5;
/// How dark edges get for each pixel of depth step, at most `EDGE_MOST`.
const EDGE_STRENGTH: f32 = 0.04;
const EDGE_MOST: f32 = 0.5;
/// How far the farthest points fade into the background.
const FOG: f32 = 0.22;
/// Linear colours.
const MATERIAL: Rgb = [0.30, 0.43, 0.55];
const TOP: Rgb = [0.96, 0.965, 0.975];
const BOTTOM: Rgb = [0.80, 0.82, 0.85];

/// Colours every pixel and averages blocks of `scale` x `scale`.
pub(super) fn image(canvas: &Canvas, camera: &Camera, shade: Shade, scale: u32) -> Image {
    let scale = scale as usize;
    let (width, height) = (canvas.width / scale, canvas.height / scale);
    let scene = Scene {
        spiral: std::array::from_fn(|i| {
            let share = (i as f32 + 0.5) / OCCLUSION_SAMPLES as f32;
            let (sin, cos) = (7.0 * std::f32::consts::TAU * share).sin_cos();
            [share * cos, share * sin]
        }),
        canvas,
        shade,
        focal: camera.focal as f32,
        centre: camera.centre.map(|c| c as f32),
        near: camera.depths.0 as f32,
        range: (camera.depths.1 - camera.depths.0).max(1e-9) as f32,
    };
    let mut rgb = vec![0; width * height * 3];
    rgb.par_chunks_exact_mut(width * 3).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let mut sum = [0.0; 3];
            for sub in 0..scale * scale {
                let colour = scene.colour(x * scale + sub % scale, y * scale + sub / scale);
                (0..3).for_each(|a| sum[a] += colour[a] / (scale * scale) as f32);
            }
            pixel.copy_from_slice(&sum.map(encode));
        }
    });
    Image { width: width as u32, height: height as u32, rgb }
}

struct Scene<'a> {
    /// Samples for ambient occlusion in the unit disc, seven turns.
    spiral: [[f32; 2]; OCCLUSION_SAMPLES],
    canvas: &'a Canvas,
    shade: Shade,
    focal: f32,
    centre: [f32; 2],
    near: f32,
    range: f32,
}

impl Scene<'_> {
    fn colour(&self, x: usize, y: usize) -> Rgb {
        let at = y * self.canvas.width + x;
        let background = mix(TOP, BOTTOM, y as f32 / self.canvas.height as f32);
        let depth = self.canvas.depth[at];
        if depth.is_infinite() {
            return background;
        }
        let normal = self.canvas.normal[at];
        let far = ((depth - self.near) / self.range).clamp(0.0, 1.0);
        let base = match self.shade {
            Shade::Normals => MATERIAL,
            Shade::Depth => scale_colour(1.0 - far),
            Shade::Density | Shade::Colour => self.canvas.tint[at],
        };
        let light = match self.shade {
            Shade::Normals => lit(normal),
            // Colours carry the meaning: only a hint of light.
            Shade::Depth | Shade::Density => mix([0.9; 3], lit(normal), 0.3),
            // Light is in the scan's own colours already.
            Shade::Colour => mix([1.0; 3], lit(normal), 0.15),
        };
        let fog = match self.shade {
            Shade::Normals => FOG * far * far,
            Shade::Depth | Shade::Density | Shade::Colour => 0.0,
        };
        let dark = (1.0 - self.occlusion(x, y, depth, normal)) * (1.0 - self.edge(x, y, depth));
        let colour = std::array::from_fn(|a| base[a] * light[a] * dark);
        mix(colour, background, fog)
    }

    /// The place of a pixel in the view's axes, relative to the eye.
    fn place(&self, x: f32, y: f32, depth: f32) -> [f32; 3] {
        let unit = depth / self.focal;
        [(x - self.centre[0]) * unit, (self.centre[1] - y) * unit, depth]
    }

    /// How much of the sky above a pixel is hidden by what is around it: sums over samples how
    /// high each rises above the tangent plane (McGuire et al., "The Alchemy Screen-Space Ambient
    /// Obscurance Algorithm", 2011).
    fn occlusion(&self, x: usize, y: usize, depth: f32, normal: [f32; 3]) -> f32 {
        let reach = OCCLUSION_REACH * self.range;
        let pixels = (reach * self.focal / depth).max(3.0);
        let here = self.place(x as f32, y as f32, depth);
        // Neighbouring pixels take other samples; the average over a block evens it out.
        let (sin, cos) = (std::f32::consts::TAU * hash(x as u32, y as u32)).sin_cos();
        let mut sum = 0.0;
        for [u, v] in &self.spiral {
            let (sx, sy) = (x as f32 + pixels * (u * cos - v * sin), y as f32 + pixels * (u * sin + v * cos));
            let Some(there) = self.depth_at(sx, sy) else { continue };
            let v = sub(self.place(sx, sy, there), here);
            let distance = dot(v, v);
            if distance < reach * reach {
                let rise = dot(v, normal) - 0.02 * reach;
                let fade = 1.0 - distance / (reach * reach);
                sum += fade * rise.max(0.0) / (distance + 1e-4 * reach * reach).sqrt();
            }
        }
        (OCCLUSION_STRENGTH * sum / OCCLUSION_SAMPLES as f32).clamp(0.0, 0.85)
    }

    /// Darkness from being just behind something (Boucheny's eye-dome lighting, 2009): outlines
    /// what stands in front of what.
    fn edge(&self, x: usize, y: usize, depth: f32) -> f32 {
        let unit = depth / self.focal;
        let mut sum = 0.0;
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            for step in [2, 4] {
                let (x, y) = ((x as i32 + dx * step) as f32, (y as i32 + dy * step) as f32);
                if let Some(there) = self.depth_at(x, y) {
                    // A slope of 4 is still a surface, and no edge.
                    sum += ((depth - there) / unit - 4.0 * step as f32).clamp(0.0, 20.0);
                }
            }
        }
        (EDGE_STRENGTH * sum / 8.0).min(EDGE_MOST)
    }

    fn depth_at(&self, x: f32, y: f32) -> Option<f32> {
        let inside = x >= 0.0 && y >= 0.0 && x < self.canvas.width as f32 && y < self.canvas.height as f32;
        let depth = inside.then(|| self.canvas.depth[y as usize * self.canvas.width + x as usize])?;
        depth.is_finite().then_some(depth)
    }
}

/// A warm key light from the upper left, a cool fill from the right, sky and ground, a gloss.
fn lit(normal: [f32; 3]) -> Rgb {
    let facing = |l: [f32; 3]| dot(normal, unit(l)).max(0.0);
    let key = facing([-0.5, 0.65, -0.75]);
    let fill = facing([0.85, 0.05, -0.5]);
    let sky = 0.5 + 0.5 * normal[1];
    let half = facing(add(unit([-0.5, 0.65, -0.75]), [0.0, 0.0, -1.0]));
    let gloss = 0.12 * half.powi(24);
    let sum = |k: f32, f: f32, up: f32, down: f32| k * key + f * fill + up * sky + down * (1.0 - sky) + gloss;
    [sum(1.05, 0.16, 0.26, 0.17), sum(1.00, 0.19, 0.29, 0.15), sum(0.90, 0.28, 0.38, 0.15)]
}

/// A scale from dark violet over teal to yellow, lighter all the way.
pub(super) fn scale_colour(t: f32) -> Rgb {
    const STOPS: [Rgb; 5] =
        [[0.07, 0.02, 0.16], [0.06, 0.10, 0.36], [0.04, 0.28, 0.34], [0.22, 0.56, 0.20], [0.95, 0.80, 0.10]];
    let t = t.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let i = (t as usize).min(STOPS.len() - 2);
    mix(STOPS[i], STOPS[i + 1], t - i as f32)
}

/// sRGB, from 0 to 1, to linear.
pub(super) fn decode(c: f64) -> f32 {
    let c = c.clamp(0.0, 1.0);
    (if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }) as f32
}

/// Linear to sRGB.
fn encode(linear: f32) -> u8 {
    let c = linear.clamp(0.0, 1.0);
    let c = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    (255.0 * c).round() as u8
}

/// A number in [0, 1) that looks random and depends on the pixel alone.
fn hash(x: u32, y: u32) -> f32 {
    let h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    ((h ^ (h >> 13)) >> 8) as f32 / (1 << 24) as f32
}

fn mix(a: Rgb, b: Rgb, t: f32) -> Rgb {
    std::array::from_fn(|i| a[i] + t * (b[i] - a[i]))
}

fn add(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}

fn sub(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}
