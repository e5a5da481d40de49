//! The keys of points, by which COLMAP's images refer to them.

use std::any::Any;

use densecloud_cloud::{Extra, FormatExtra, Origin, Position};

/// The keys of a file's points.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Keys {
    /// The bits of each point's position, and its key; in order.
    points: Vec<([u64; 3], u64)>,
    highest: u64,
}

impl Keys {
    /// Takes note of a point.
    pub(super) fn push(&mut self, position: Position, key: u64) {
        self.points.push((position.map(f64::to_bits), key));
        self.highest = self.highest.max(key);
    }

    /// Of all points.
    pub(super) fn finish(mut self) -> Extra {
        self.points.sort_unstable();
        self.points.shrink_to_fit();
        Extra::new(self)
    }
}

impl FormatExtra for Keys {
    /// They are an attribute there.
    fn lost_elsewhere(&self) -> Vec<String> {
        Vec::new()
    }

    fn equals(&self, other: &dyn FormatExtra) -> bool {
        (other as &dyn Any).downcast_ref() == Some(self)
    }
}

/// Gives each point of a result a key of its own: that of the source's point where it is one, since images refer to it by
/// that; else one above all of the source, which nothing refers to.
#[derive(Debug)]
pub(super) struct NewKeys {
    source: Option<Extra>,
    /// Which of the source's are given.
    given: Vec<bool>,
    next: u64,
}

impl NewKeys {
    pub(super) fn new(origin: &Origin) -> Self {
        let source = origin.extra.clone().filter(|extra| extra.get::<Keys>().is_some());
        let keys = source.as_ref().and_then(Extra::get::<Keys>);
        let (count, highest) = keys.map_or((0, 0), |keys| (keys.points.len(), keys.highest));
        Self { given: vec![false; count], next: highest + 1, source }
    }

    /// Whether the source's points have keys.
    pub(super) fn has_source(&self) -> bool {
        self.source.is_some()
    }

    /// The key of the next point. O(log n).
    pub(super) fn next(&mut self, position: Position) -> u64 {
        self.kept(position.map(f64::to_bits)).unwrap_or_else(|| {
            self.next += 1;
            self.next - 1
        })
    }

    /// The key that the source has for a point there, once.
    fn kept(&mut self, position: [u64; 3]) -> Option<u64> {
        let keys = self.source.as_ref()?.get::<Keys>()?;
        let first = keys.points.partition_point(|(other, _)| *other < position);
        let there = keys.points[first..].iter().take_while(|(other, _)| *other == position);
        let (row, (_, key)) = (first..).zip(there).find(|(row, _)| !self.given[*row])?;
        self.given[row] = true;
        Some(*key)
    }
}
