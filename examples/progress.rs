//! A progress bar of one's own, and a way to stop: for a program with a window, or a user who may change their mind.
//!
//! ```sh
//! cargo run --release --example progress
//! ```

use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use densecloud::cascade::{Observer, Stage};
use densecloud::{Options, Upsampler};

fn main() -> Result<(), Box<dyn Error>> {
    let bar = Arc::new(Bar::default());
    let ears = Arc::clone(&bar);
    // Enter stops it; the end of the input does not.
    std::thread::spawn(move || {
        if std::io::stdin().read_line(&mut String::new()).is_ok_and(|bytes| bytes > 0) {
            ears.stop();
        }
    });
    let dense = Upsampler::new()?.upsample_watched(sheet(2000), Options::default(), &*bar)?;
    println!("{} points after {} stages", dense.positions.len(), bar.stages());
    Ok(())
}

/// Hears how far the work is, from the threads that do it.
#[derive(Default)]
pub(crate) struct Bar {
    stages: AtomicUsize,
    stop: AtomicBool,
}

impl Bar {
    /// Stops the work within one patch; may come from any thread.
    pub(crate) fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Stages that have begun.
    pub(crate) fn stages(&self) -> usize {
        self.stages.load(Ordering::Relaxed)
    }
}

impl Observer for Bar {
    fn plan(&self, sizes: &[usize]) {
        eprintln!("levels of {sizes:?} points");
    }

    fn begin(&self, level: usize, stage: Stage) {
        self.stages.fetch_add(1, Ordering::Relaxed);
        eprintln!("level {}: {}", level + 1, stage.name());
    }

    fn advance(&self, done: usize, total: usize) {
        eprint!("\r{} %", 100 * done / total.max(1));
    }

    fn cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Points of a bent sheet, on a spiral.
pub(crate) fn sheet(points: u32) -> Vec<[f64; 3]> {
    let place = |i: u32| (f64::from(i).sqrt(), 2.4 * f64::from(i));
    let bent = |(r, angle): (f64, f64)| [r * angle.cos(), r * angle.sin(), 0.01 * r * r];
    (0..points).map(place).map(bent).collect()
}
