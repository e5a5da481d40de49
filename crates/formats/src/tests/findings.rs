//! What the fuzzers found (`fuzz/run.sh`), each with what it must come to.

use super::*;

/// A file from `findings/`, in full.
macro_rules! finding {
    ($name:literal) => {
        include_bytes!(concat!("findings/", $name)).as_slice()
    };
}

#[test]
fn points_of_a_length_that_no_file_has_take_no_room() {
    // 65,536 of these points were 1.3 GB.
    let error = read(finding!("las-long-points.bin")).expect_err("an error").to_string();
    assert!(error.contains("layers of compressed points"), "{error}");
}

#[test]
fn a_layer_that_is_longer_than_the_file_takes_no_room() {
    // It was 1.7 GB.
    let error = read(finding!("las-long-layer.bin")).expect_err("an error").to_string();
    assert!(error.contains("layers of compressed points"), "{error}");
}

#[test]
fn tables_for_extra_bytes_are_bounded() {
    // They were 0.6 GB.
    let error = read(finding!("las-many-extra-bytes.bin")).expect_err("an error").to_string();
    assert!(error.contains("extra bytes a point"), "{error}");
}
