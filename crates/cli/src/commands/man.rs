//! `densecloud man`: its manual pages.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, Command};
use clap_mangen::{Man, generate_to};

use super::{CliError, files};

/// Print the manual page, or write one for each command.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud man | man -l -
  densecloud man --dir ~/.local/share/man/man1")]
pub(super) struct ManArgs {
    /// Folder in which a page for each command is written, densecloud-upsample.1 and so on; it is made if need be
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
}

pub(super) fn run(args: &ManArgs, program: Command) -> Result<(), CliError> {
    match &args.dir {
        Some(folder) => write(folder, program).map_err(|why| CliError::file(folder, why)),
        None => print(program),
    }
}

fn write(folder: &Path, program: Command) -> std::io::Result<()> {
    fs::create_dir_all(folder)?;
    generate_to(program, folder)
}

fn print(program: Command) -> Result<(), CliError> {
    let mut page = Vec::new();
    Man::new(program).render(&mut page).map_err(|why| CliError::file("-", why))?;
    files::print(&String::from_utf8_lossy(&page))
}
