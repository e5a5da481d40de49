//! The disk is asked for room.

use super::support::{Bench, bytes, entries, ground};
use crate::TilesError;

/// A header that counts more points than any disk has room for.
#[test]
fn what_the_disk_has_no_room_for_is_told_before_it_is_read() {
    let parent = tempfile::tempdir().expect("a folder");
    let input = bytes(&ground(2000, 3), "a.ply");
    let text = b"element vertex 2000\n";
    let at = input.windows(text.len()).position(|window| window == text).expect("a count");
    let many = [&input[..at], b"element vertex 2000000000000\n", &input[at + text.len()..]].concat();
    let needs = |to: &str| {
        let why = Bench::new(1000, &[("ratio", "4")], to).dense(&many, parent.path()).expect_err("no room");
        let TilesError::NoSpace { needed, free, .. } = why else { panic!("{why}") };
        assert!(free < needed);
        needed
    };
    // 24 bytes, three colours, a time and a float a point: the row, too, once and a half; the result.
    let tiles = (2e12 * (28.0 + 15.0) * 1.5) as u64;
    let parts = 8_000_000_000_000 * (24 + 15);
    assert_eq!(needs("b.ply"), tiles + parts);
    assert!(needs("b.laz") > needs("b.ply"));
    assert!(needs("b.copc.laz") > needs("b.laz"));
    assert_eq!(entries(parent.path()), 0);
    // Whether a text that counts nothing is too long is known once it is read.
    let text = bytes(&ground(2000, 3), "a.csv");
    assert!(Bench::new(1000, &[("ratio", "4")], "b.ply").dense(&text, parent.path()).is_ok());
}
