#![no_main]

use densecloud_fuzz::{cloud, mend_pages, quiet};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: quiet(), |data: &[u8]| cloud(b"ASTM-E57", data, mend_pages));
