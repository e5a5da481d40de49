#![no_main]

use densecloud_fuzz::{mesh, quiet};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: quiet(), |data: &[u8]| mesh(data));
