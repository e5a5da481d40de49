//! The command line: one file a command.

use std::process::ExitCode;

/// Parses the arguments, runs the command, and says how it went.
pub fn main() -> ExitCode {
    ExitCode::SUCCESS
}
