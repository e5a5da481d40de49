#![no_main]

use densecloud_fuzz::{as_is, cloud, quiet};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: quiet(), |data: &[u8]| cloud(b"3\n2\n", data, as_is));
