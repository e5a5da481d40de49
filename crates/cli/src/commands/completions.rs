//! `densecloud completions`: what a shell needs to complete the program's arguments.

use clap::{Args, Command};
use clap_complete::{Shell, generate};

use super::{CliError, NAME, files};

/// Print what a shell needs to complete commands and options.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud completions bash > ~/.local/share/bash-completion/completions/densecloud
  densecloud completions zsh > ~/.zfunc/_densecloud
  densecloud completions fish > ~/.config/fish/completions/densecloud.fish
  densecloud completions powershell >> $PROFILE
  densecloud completions elvish >> ~/.config/elvish/rc.elv")]
pub(super) struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

pub(super) fn run(args: &CompletionsArgs, mut program: Command) -> Result<(), CliError> {
    let mut script = Vec::new();
    generate(args.shell, &mut program, NAME, &mut script);
    files::print(&String::from_utf8_lossy(&script))
}
