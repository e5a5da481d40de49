#![no_main]

use densecloud_fuzz::{quiet, text};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: quiet(), |data: &[u8]| text(data));
