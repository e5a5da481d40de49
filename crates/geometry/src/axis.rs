//! The axis that some directions have in common.

use super::normals::eigen;

/// The axis nearest to some directions, each of which means the same as its opposite: its share of their squared
/// lengths, from a third to 1, and its unit direction. All of one length count alike. A share of 0 where there are none.
#[must_use]
pub fn common_axis(directions: impl Iterator<Item = [f32; 3]>) -> (f64, [f32; 3]) {
    let mut products = [[0.0; 3]; 3];
    for direction in directions.map(|d| d.map(f64::from)) {
        for a in 0..3 {
            for b in a..3 {
                products[a][b] += direction[a] * direction[b];
            }
        }
    }
    let (values, vectors) = eigen(products);
    let most = (1..3).fold(0, |best, a| if values[a] > values[best] { a } else { best });
    let whole: f64 = values.iter().sum();
    (if whole > 0.0 { values[most] / whole } else { 0.0 }, vectors[most].map(|c| c as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opposite_directions_are_one_axis() {
        let (share, axis) = common_axis([[0.0, 0.6, 0.8], [0.0, -0.6, -0.8]].into_iter());
        assert!((share - 1.0).abs() < 1e-6);
        assert!((axis[1] * 0.6 + axis[2] * 0.8).abs() > 1.0 - 1e-6, "{axis:?}");
    }

    #[test]
    fn all_directions_of_a_plane_have_no_axis_in_common() {
        let around = (0..7).map(|i| (i as f32).sin_cos()).map(|(s, c)| [s, c, 0.0]);
        let share = common_axis(around).0;
        assert!((0.5..0.6).contains(&share), "{share}");
        assert_eq!(common_axis(std::iter::empty()).0, 0.0);
    }
}
