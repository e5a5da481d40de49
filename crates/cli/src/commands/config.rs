//! `densecloud config`: which defaults apply, and where they come from.

use std::path::PathBuf;

use clap::{Args, Command};

use super::{CliError, files, settings};

/// Tell which defaults apply to the commands, and where they come from.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud config
  densecloud config --config lidar.toml

Options on the command line go before variables in the environment, these before the file.")]
pub(super) struct ConfigArgs {
    /// The file, instead of the one that is found
    #[arg(long, env = "DENSECLOUD_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(super) fn run(args: &ConfigArgs, program: Command) -> Result<(), CliError> {
    files::print(&settings::applied(program, args.config.as_deref())?)
}
