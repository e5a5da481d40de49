//! Temporary.
use crate::cloud::Point;
/// Plain.
pub fn farthest_point_sampling(points: &[Point], count: usize, first: usize) -> Vec<u32> {
    let mut d = vec![f32::INFINITY; points.len()];
    let mut out = vec![first as u32];
    let mut last = first;
    while out.len() < count {
        let q = points[last];
        let (mut best, mut bi) = (-1.0, 0);
        for (i, p) in points.iter().enumerate() {
            let e = (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2) + (p[2] - q[2]).powi(2);
            if e < d[i] {
                d[i] = e;
            }
            if d[i] > best {
                best = d[i];
                bi = i;
            }
        }
        out.push(bi as u32);
        last = bi;
    }
    out
}
