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
    assert!(error.contains("LAS"), "{error}");
}
