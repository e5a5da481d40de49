//! What the program `densecloud` does, for whoever starts it: `main.rs`, or Python's package. One file a command
//! (`commands/`).

mod commands;
mod evaluate;
mod report;

pub use commands::{Inspection, PROVENANCE, available_memory, beside, run, write_file};
pub use evaluate::{Corrected, DEFAULT_TOLERANCE, MetricError, Published, Scores, score};
