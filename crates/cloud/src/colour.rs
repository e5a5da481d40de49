//! What numbers a colour's parts go up to.

use super::Values;

/// The number that a colour's parts have where they are full: of integers of 8 bits 255; of others, and of floats, the first of
/// 1, 255 and 65,535 that none of them exceeds, where 1 is for floats alone.
#[must_use]
pub fn full_colour(parts: [&Values; 3]) -> f64 {
    let numbers = parts.iter().flat_map(|part| (0..part.len()).map(|i| part.get(i)));
    let largest = numbers.filter(|c| c.is_finite()).fold(0.0, f64::max);
    match largest {
        m if m <= 1.0 && parts.iter().all(|part| part.kind().is_float()) => 1.0,
        m if m <= 255.0 => 255.0,
        _ => 65_535.0,
    }
}
