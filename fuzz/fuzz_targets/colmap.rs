#![no_main]

use densecloud_fuzz::{cloud_as, quiet};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: quiet(), |data: &[u8]| cloud_as(&["colmap"], data));
