//! A quadratic height field over the local plane, fitted so that outlying points have little weight.

use super::{Place, decay, lifted};
use crate::Neighbour;
use crate::mls::{TERMS, solve};
use crate::plane::Plane;
use densecloud_cloud::Point;

/// Width of the weights by distance, in multiples of the neighbourhood's reach.
const WIDTH: f64 = 0.6;
/// Width of the weights by the residual of the fit before, in multiples of the noise.
const ROBUST: f64 = 2.5;
/// Fits: the first without weights by residual.
const FITS: usize = 3;
/// Weight of the penalty on all terms but the height.
const RIDGE: f64 = 1e-3;

/// The middle of the neighbourhood on the surface.
pub(super) fn foot(points: &[Point], near: &[Neighbour], place: &Place) -> Point {
    let plane = Plane::fit(points, near);
    let origin = points[near[0].index as usize];
    let reach = f64::from(near[near.len() - 1].distance_squared).sqrt();
    let noise = (ROBUST * f64::from(place.residual) / reach).max(1e-9);
    let rows: Vec<([f64; TERMS], f64, f64)> = near
        .iter()
        .map(|n| {
            let p = points[n.index as usize];
            let [a, b] = plane.flat(origin, p).map(|c| c / reach);
            let weight = decay(f64::from(n.distance_squared) / (WIDTH * reach).powi(2));
            ([1.0, a, b, a * a, a * b, b * b], plane.height(origin, p) / reach, weight)
        })
        .collect();
    let mut fit = [0.0; TERMS];
    for round in 0..FITS {
        let robust = |off: f64| if round == 0 { 1.0 } else { decay((off / noise).powi(2)) };
        let Some(next) = fitted(&rows, &fit, robust) else { break };
        fit = next;
    }
    lifted(origin, plane.normal, fit[0] * reach)
}

/// The weighted least squares fit, with further weights by how far rows are off `before`.
fn fitted(
    rows: &[([f64; TERMS], f64, f64)],
    before: &[f64; TERMS],
    robust: impl Fn(f64) -> f64,
) -> Option<[f64; TERMS]> {
    let (mut matrix, mut right, mut total) = ([[0.0; TERMS]; TERMS], [0.0; TERMS], 0.0);
    for (terms, height, weight) in rows {
        let off = height - terms.iter().zip(before).map(|(term, c)| term * c).sum::<f64>();
        let weight = weight * robust(off);
        for i in 0..TERMS {
            for j in 0..=i {
                matrix[i][j] += weight * terms[i] * terms[j];
            }
            right[i] += weight * terms[i] * height;
        }
        total += weight;
    }
    for (i, row) in matrix.iter_mut().enumerate().skip(1) {
        row[i] += RIDGE * total;
    }
    solve(matrix, right)
}
