//! What `--json` tells: an object a line on standard output, in the order in which things happen. docs/cli.md has the members.

use std::path::Path;

use densecloud::Report;
use serde::Serialize;
use serde_json::{Map, Value};

use super::{CliError, files};

/// Whether events are told.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Events(pub(super) bool);

/// What happens.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(super) enum Event<'a> {
    /// Work on an input begins.
    Begin { input: &'a Path, output: &'a Path },
    /// A share of it is done.
    Progress { input: &'a Path, fraction: f64 },
    /// What it would come to; nothing is written.
    Estimate {
        input: &'a Path,
        output: &'a Path,
        #[serde(flatten)]
        estimate: &'a Estimate,
    },
    /// Its result is written.
    Done {
        input: &'a Path,
        output: &'a Path,
        seconds: f64,
        #[serde(flatten)]
        made: &'a Made,
    },
    /// Its result was there before, and stays.
    Skipped { input: &'a Path, output: &'a Path },
    /// There is no result.
    Failed { input: &'a Path, output: &'a Path, why: String, exit_code: u8 },
    /// All is over.
    End { done: usize, skipped: usize, failed: usize },
}

/// What a work has made.
#[derive(Debug, Serialize)]
pub(super) struct Made {
    pub(super) format: String,
    /// None where a server does not tell; so below.
    pub(super) points_in: Option<u64>,
    pub(super) points_out: Option<u64>,
    /// Into which it was cut; none where it was not, or where a server knows.
    pub(super) tiles: Option<usize>,
    /// Seconds of each stage, where it was worked on as a whole and here.
    pub(super) stages: Map<String, Value>,
    pub(super) warnings: Vec<String>,
    pub(super) provenance: String,
}

impl Made {
    /// Of what is told of a result.
    pub(super) fn of(report: &Report) -> Self {
        Self {
            format: report.format.to_string(),
            points_in: Some(report.points_in),
            points_out: Some(report.points_out),
            tiles: None,
            stages: Map::new(),
            warnings: report.warnings.clone(),
            provenance: report.provenance.clone(),
        }
    }
}

/// What a work would come to.
#[derive(Debug, Serialize)]
pub(super) struct Estimate {
    pub(super) points_in: u64,
    /// Unknown for a spacing or a density of a cloud that is worked on in tiles.
    pub(super) points_out: Option<u64>,
    /// On this machine, with these threads.
    pub(super) seconds: Option<f64>,
    /// Of memory at its height.
    pub(super) bytes: u64,
    /// Whether it is worked on in tiles.
    pub(super) in_tiles: bool,
    pub(super) warnings: Vec<String>,
}

impl Events {
    /// Tells of an event, where that is wanted.
    ///
    /// # Errors
    /// Standard output cannot be written to.
    pub(super) fn tell(self, event: &Event<'_>) -> Result<(), CliError> {
        if !self.0 {
            return Ok(());
        }
        let line = serde_json::to_string(event).map_err(|why| CliError::Failed(why.to_string()))?;
        files::print(&(line + "\n"))
    }

    /// Tells of progress in steps of a hundredth; `told` is what was told before. Where nobody can be told, the work goes on.
    pub(super) fn progress(self, input: &Path, fraction: f64, told: &mut f64) {
        if fraction - *told >= 0.01 {
            *told = fraction;
            let _ = self.tell(&Event::Progress { input, fraction });
        }
    }
}
