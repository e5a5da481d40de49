//! Vectors of three coordinates.

use densecloud_cloud::Point;

pub(super) fn sub(p: Point, q: Point) -> Point {
    std::array::from_fn(|a| p[a] - q[a])
}

pub(super) fn dot(p: Point, q: Point) -> f32 {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}

pub(super) fn length(p: Point) -> f32 {
    dot(p, p).sqrt()
}

/// `share` of the way from `p` to `q`.
pub(super) fn mix(p: Point, q: Point, share: f32) -> Point {
    std::array::from_fn(|a| p[a] + share * (q[a] - p[a]))
}

/// Of the angle between two; 0 where one of them has no direction.
pub(super) fn cosine(p: Point, q: Point) -> f32 {
    dot(p, q) / (length(p) * length(q)).max(f32::MIN_POSITIVE)
}

/// Of length 1; zero where there is no direction.
pub(super) fn unit(p: Point) -> Point {
    let length = length(p).max(f32::MIN_POSITIVE);
    p.map(|c| c / length)
}
