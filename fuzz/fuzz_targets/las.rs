#![no_main]

use densecloud_fuzz::{as_is, cloud, quiet};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: quiet(), |data: &[u8]| cloud(b"LASF", data, as_is));
