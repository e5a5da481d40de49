//! The settings of `densecloud serve` and `densecloud worker`: from the command line, else the environment, else a file, else
//! the default.
//!
//! There is no second list of them. Every option of the command that has a name in the environment is
//! a setting, and its key in the file is the option without its dashes. What the file has enters as
//! if it had been typed, so that options are parsed, checked and weighed against each other in one
//! place, clap's; only what is about the file itself (its syntax, unknown keys, types, lines) is here.

mod file;
mod kind;
mod log_format;
mod page;
#[cfg(test)]
mod tests;

use std::ffi::{OsStr, OsString};
use std::fmt;
use std::path::PathBuf;

use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Args, Command};

use super::CliError;
pub(super) use log_format::logs_json;
pub(super) use page::page;

/// The command whose options are settings.
const SERVE: &str = "serve";
/// The other command that has the same settings.
const WORKER: &str = "worker";

/// Whether a command is one of those with settings.
fn has_settings(command: &OsStr) -> bool {
    command == SERVE || command == WORKER
}

/// What is given to such a command.
fn given(matches: &ArgMatches) -> Option<&ArgMatches> {
    matches.subcommand().filter(|(name, _)| has_settings(name.as_ref())).map(|(_, given)| given)
}
/// The option that names the file, which is none of the settings in it.
const CONFIG: &str = "config";

/// Where the settings' file is, and what there is to set.
#[derive(Debug, Args)]
pub(super) struct SettingsArgs {
    /// TOML file with settings: the options below without their dashes. What the command line or the
    /// environment sets goes before it
    #[arg(long, env = "DENSECLOUD_CONFIG", value_name = "FILE")]
    pub(super) config: Option<PathBuf>,

    /// Check the settings, print them all as such a file (commented out at their defaults) and end
    #[arg(long)]
    pub(super) print_config: bool,
}

/// Why the arguments are not taken.
#[derive(Debug)]
pub(super) enum Refused {
    /// By clap, in whose words and with whose help; and the file that took part, if one did.
    Arguments(clap::Error, Option<PathBuf>),
    /// By the file.
    File(CliError),
}

impl Refused {
    /// Whether something is wrong, and it is not help that was asked for.
    pub(super) fn is_failure(&self) -> bool {
        match self {
            Self::Arguments(error, _) => error.use_stderr(),
            Self::File(_) => true,
        }
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Arguments(error, file) => {
                let words = error.to_string();
                f.write_str(words.strip_prefix("error: ").unwrap_or(&words).trim_end())?;
                file.iter().try_for_each(|file| write!(f, "\nSome of these are in {}.", file.display()))
            }
            Self::File(error) => error.fmt(f),
        }
    }
}

impl From<clap::Error> for Refused {
    fn from(error: clap::Error) -> Self {
        Self::Arguments(error, None)
    }
}

/// Parses the arguments (the program's name first); for those with settings, with what their file adds.
///
/// # Errors
/// See [`Refused`]; help and version come as errors, too, as clap has it.
pub(super) fn parse(command: &Command, arguments: &[OsString]) -> Result<ArgMatches, Refused> {
    let plain = || command.clone().try_get_matches_from(arguments);
    if arguments.get(1).is_none_or(|name| !has_settings(name)) {
        return Ok(plain()?);
    }
    // The file may have what the rest needs, so errors wait for the second look.
    let typed = command.clone().ignore_errors(true).try_get_matches_from(arguments)?;
    let Some(serve) = given(&typed) else { return Ok(plain()?) };
    let Some(path) = serve.get_one::<PathBuf>(CONFIG) else { return Ok(plain()?) };
    let entries = file::read(path, &of_serve(command)).map_err(Refused::File)?;
    let mut all = arguments.to_vec();
    let added =
        entries.into_iter().filter(|entry| !is_set(serve, entry.setting)).flat_map(|entry| entry.typed);
    all.splice(2..2, added);
    match command.clone().try_get_matches_from(all) {
        Ok(matches) => Ok(matches),
        // What is wrong without the file, too, is told without it.
        Err(error) => Err(plain().err().map_or(Refused::Arguments(error, Some(path.clone())), Into::into)),
    }
}

/// Whether something stronger than the file sets it.
fn is_set(serve: &ArgMatches, setting: &Arg) -> bool {
    serve.value_source(setting.get_id().as_str()) == Some(ValueSource::CommandLine)
        || setting.get_env().is_some_and(|name| std::env::var_os(name).is_some())
}

/// Every setting, in the order of the help.
fn of_serve(command: &Command) -> Vec<&Arg> {
    let serve = command.find_subcommand(SERVE);
    let options = serve.into_iter().flat_map(Command::get_arguments);
    options.filter(|option| option.get_env().is_some() && option.get_id() != CONFIG).collect()
}

/// A setting's key in the file.
fn key(setting: &Arg) -> &str {
    setting.get_long().unwrap_or_default()
}

/// Whether it may be given more than once: in the file, an array.
fn is_list(setting: &Arg) -> bool {
    matches!(setting.get_action(), ArgAction::Append)
}
