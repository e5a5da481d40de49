//! How sure a result's points are: as an attribute, and which of them are left out.

use densecloud_cloud::{Attribute, Position, Values};
use densecloud_geometry::indices;

use super::finish::Finish;

/// What the attribute is called, where there is no other of that name.
pub(super) const NAME: &str = "confidence";

/// The attribute's name beside these others, whose case does not tell them from it.
pub(super) fn name(others: &[&str]) -> String {
    let mut name = NAME.to_owned();
    while others.iter().any(|other| other.eq_ignore_ascii_case(&name)) {
        name.push('_');
    }
    name
}

/// Adds each point's `confidence`, and leaves out what is below the least that is asked for; the first `kept` points stay.
pub(super) fn finish(
    mut positions: Vec<Position>,
    mut attributes: Vec<Attribute>,
    confidence: Vec<f32>,
    kept: usize,
    how: &Finish,
) -> (Vec<Position>, Vec<Attribute>) {
    let is_left = |i: usize| i < kept || f64::from(confidence[i]) >= how.min_confidence;
    let left: Vec<u32> = indices(positions.len()).filter(|&i| is_left(i as usize)).collect();
    if how.confidence {
        let others: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
        let name = name(&others);
        attributes.push(Attribute { name, values: Values::F32(confidence) });
    }
    if left.len() < positions.len() {
        positions = left.iter().map(|&i| positions[i as usize]).collect();
        for attribute in &mut attributes {
            attribute.values = attribute.values.gather(&left);
        }
    }
    (positions, attributes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_is_taken_becomes_another() {
        assert_eq!(name(&["red", "confidences"]), "confidence");
        assert_eq!(name(&["red", "Confidence"]), "confidence_");
        assert_eq!(name(&["confidence", "CONFIDENCE_"]), "confidence__");
    }

    #[test]
    fn rows_that_are_not_sure_go_whole_but_for_those_that_are_kept() {
        let positions: Vec<Position> = (0..5).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        let attributes = vec![Attribute { name: "id".into(), values: Values::U8(vec![0, 1, 2, 3, 4]) }];
        let how = Finish { confidence: true, min_confidence: 0.5, ..Finish::default() };
        let sure = vec![0.1, 0.4, 0.5, 0.49, 1.0];
        let (left, attributes) = finish(positions, attributes, sure, 1, &how);
        assert_eq!(left, [[0.0; 3], [2.0, 0.0, 0.0], [4.0, 0.0, 0.0]]);
        assert_eq!(attributes[0].values, Values::U8(vec![0, 2, 4]));
        let own = Attribute { name: "confidence".into(), values: Values::F32(vec![0.1, 0.5, 1.0]) };
        assert_eq!(attributes[1..], [own]);
    }
}
