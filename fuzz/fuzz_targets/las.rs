#![no_main]

use densecloud_fuzz::{cloud_and_window, quiet};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: quiet(), |data: &[u8]| cloud_and_window(b"LASF", data));
