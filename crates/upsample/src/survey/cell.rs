//! The share of a plane that belongs to one point among others.

/// A point of the plane.
pub(super) type Flat = [f64; 2];

/// The area of the Voronoi cell of the origin among `others`, within an octagon that touches the circle
/// of radius `bound`; and whether that octagon had to close it, as at the border of a surface.
pub(super) fn voronoi_area(others: &[Flat], bound: f64) -> (f64, bool) {
    let mut cell: Vec<Flat> = (0..8)
        .map(|i| {
            let angle = std::f64::consts::FRAC_PI_4 * (f64::from(i) + 0.5);
            let corner = bound / (std::f64::consts::FRAC_PI_8).cos();
            [corner * angle.cos(), corner * angle.sin()]
        })
        .collect();
    for other in others {
        cell = nearer_than(&cell, *other);
    }
    let twice: f64 = pairs(&cell).map(|(p, q)| p[0] * q[1] - p[1] * q[0]).sum();
    // Whatever other points cut lies inside; a side of the octagon keeps its distance.
    let open = pairs(&cell).any(|(p, q)| {
        let middle = [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])];
        let length = (q[0] - p[0]).hypot(q[1] - p[1]);
        let distance = (p[0] * q[1] - p[1] * q[0]).abs() / length;
        length > 1e-9 * bound && middle[0].hypot(middle[1]) >= distance && distance > bound * (1.0 - 1e-9)
    });
    (0.5 * twice, open)
}

fn pairs(cell: &[Flat]) -> impl Iterator<Item = (Flat, Flat)> + '_ {
    (0..cell.len()).map(|i| (cell[i], cell[(i + 1) % cell.len()]))
}

/// What of a convex polygon is nearer to the origin than to `other` (Sutherland and Hodgman's clipping).
fn nearer_than(cell: &[Flat], other: Flat) -> Vec<Flat> {
    let half = 0.5 * (other[0] * other[0] + other[1] * other[1]);
    let beyond = |p: Flat| p[0] * other[0] + p[1] * other[1] - half;
    let mut kept = Vec::with_capacity(cell.len() + 1);
    for (p, q) in pairs(cell) {
        let (from, to) = (beyond(p), beyond(q));
        if from <= 0.0 {
            kept.push(p);
        }
        if (from < 0.0 && to > 0.0) || (from > 0.0 && to < 0.0) {
            let t = from / (from - to);
            kept.push([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_of_a_grid_are_its_squares() {
        let grid: Vec<Flat> = (-2..=2)
            .flat_map(|x| (-2..=2).map(move |y| [f64::from(x), f64::from(y)]))
            .filter(|p| *p != [0.0, 0.0])
            .collect();
        let (area, open) = voronoi_area(&grid, 2.0);
        assert!((area - 1.0).abs() < 1e-12 && !open, "{area}");
        // At a border: the half plane x > 0 is empty.
        let border: Vec<Flat> = grid.into_iter().filter(|p| p[0] <= 0.0).collect();
        let (area, open) = voronoi_area(&border, 0.5);
        assert!((0.8..1.0).contains(&area) && open, "{area}");
        let (alone, open) = voronoi_area(&[], 1.0);
        assert!((alone - 8.0 * (2.0_f64.sqrt() - 1.0)).abs() < 1e-12 && open, "{alone}");
    }
}
