//! A file in, a denser file out. For scripts over files, in any format that is read and written.
//!
//! ```sh
//! cargo run --release --example file -- scan.ply dense.ply 4
//! ```

use std::error::Error;
use std::path::Path;

use densecloud::{Options, Upsampler};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, output, ratio] = &arguments[..] else { return Err("usage: file IN OUT RATIO".into()) };
    upsample(input.as_ref(), output.as_ref(), ratio)
}

/// All of it: ten lines.
pub(crate) fn upsample(input: &Path, output: &Path, ratio: &str) -> Result<(), Box<dyn Error>> {
    let upsampler = Upsampler::new()?;
    let options = Options::parse(&[("ratio", ratio)])?;
    let report = upsampler.upsample_file(input, output, options)?;
    for warning in &report.warnings {
        eprintln!("warning: {warning}");
    }
    println!("{} -> {} points", report.points_in, report.points_out);
    Ok(())
}
