//! The settings of `densecloud serve` and `densecloud worker`, and defaults of other commands: from the command line, else the
//! environment, else a file, else the default.
//!
//! There is no second list of them. Every option of the server that has a name in the environment is
//! a setting, and its key in the file is the option without its dashes; so is every option of another command, in a table of that
//! command's name. What the file has enters as
//! if it had been typed, so that options are parsed, checked and weighed against each other in one
//! place, clap's; only what is about the file itself (its syntax, unknown keys, types, lines) is here.

mod applied;
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
use clap::{Arg, ArgAction, ArgGroup, ArgMatches, Args, Command, Id};

use super::CliError;
pub(super) use applied::applied;
pub(super) use log_format::logs_json;
pub(super) use page::page;

/// The command whose options are settings.
const SERVE: &str = "serve";
/// The other command that has the same settings.
const WORKER: &str = "worker";

/// Commands that take no defaults from a file: the server's, whose settings the file itself has, those that go by the server's, and
/// those of steps or without options.
const WITHOUT: [&str; 8] = [SERVE, WORKER, "healthcheck", "tiles", "completions", "man", "config", "help"];

/// Whether a command is one of the server's, with settings.
fn has_settings(command: &OsStr) -> bool {
    command == SERVE || command == WORKER
}

/// What is given to such a command.
fn given(matches: &ArgMatches) -> Option<&ArgMatches> {
    matches.subcommand().filter(|(name, _)| has_settings(name.as_ref())).map(|(_, given)| given)
}

/// Where the command's name is among the arguments: only switches may be before it.
fn place(arguments: &[OsString]) -> Option<usize> {
    let is_switch = |argument: &OsString| argument.as_encoded_bytes().starts_with(b"-");
    arguments.iter().skip(1).position(|argument| !is_switch(argument)).map(|at| at + 1)
}

/// What a command can be told by a file: the server, which is none of them, or another.
pub(super) struct Settings<'a> {
    command: Option<&'a str>,
    options: Vec<&'a Arg>,
}

impl Settings<'_> {
    fn kind(&self, option: &Arg) -> kind::Kind {
        if self.command.is_none() { kind::Kind::of(option) } else { kind::Kind::of_default(option) }
    }
}

/// All that a file can tell. The program is built, so that each command has the options that all have.
fn known(program: &Command) -> Vec<Settings<'_>> {
    let server = Settings { command: None, options: of_serve(program) };
    let commands = program.get_subcommands().filter(|command| !WITHOUT.contains(&command.get_name()));
    let of = |command| Settings { command: Some(Command::get_name(command)), options: defaults(command) };
    std::iter::once(server).chain(commands.map(of)).collect()
}

/// A command's options, but for those that are something to do.
fn defaults(command: &Command) -> Vec<&Arg> {
    let options = command.get_arguments().filter(|option| option.get_long().is_some());
    options.filter(|option| !["help", "version", CONFIG].contains(&option.get_id().as_str())).collect()
}

/// Adds the option that names the file to each command that takes defaults from one.
pub(super) fn with_config(program: Command) -> Command {
    program.mut_subcommands(|command| match WITHOUT.contains(&command.get_name()) {
        true => command,
        false => command.arg(
            Arg::new(CONFIG)
                .long(CONFIG)
                .env(VARIABLE)
                .global(true)
                .value_name("FILE")
                .value_parser(clap::value_parser!(PathBuf))
                .help("TOML file of defaults: the options without their dashes, in a table of the command's name"),
        ),
    })
}

/// The file of the person who runs the program: in the folder of the XDG Base Directory Specification, or Windows's.
pub(super) fn own_file() -> Option<PathBuf> {
    let folder = |name| std::env::var_os(name).map(PathBuf::from).filter(|folder| folder.is_absolute());
    let folder = match cfg!(windows) {
        true => folder("APPDATA"),
        false => folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config"))),
    };
    Some(folder?.join("densecloud").join("config.toml"))
}

/// The option that names the file, which is none of the settings in it.
const CONFIG: &str = "config";
const VARIABLE: &str = "DENSECLOUD_CONFIG";

/// Where the settings' file is, and what there is to set.
#[derive(Debug, Args)]
pub(super) struct SettingsArgs {
    /// TOML file with settings: the options below without their dashes. What the command line or the
    /// environment sets goes before it
    #[arg(long, env = VARIABLE, value_name = "FILE")]
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

/// Parses the arguments (the program's name first), with what a file adds.
///
/// # Errors
/// See [`Refused`]; help and version come as errors, too, as clap has it.
pub(super) fn parse(command: &Command, arguments: &[OsString]) -> Result<ArgMatches, Refused> {
    let plain = || command.clone().try_get_matches_from(arguments);
    let Some(at) = place(arguments) else { return Ok(plain()?) };
    // The file may have what the rest needs, so errors wait for the second look.
    let typed = command.clone().ignore_errors(true).try_get_matches_from(arguments)?;
    let Some((name, given)) = typed.subcommand() else { return Ok(plain()?) };
    let Some(path) = file_of(name, given) else { return Ok(plain()?) };
    let mut built = command.clone();
    built.build();
    let entries = file::read(&path, &known(&built)).map_err(Refused::File)?;
    let table = (!has_settings(name.as_ref())).then_some(name);
    let own = entries.into_iter().filter(|entry| entry.table.as_deref() == table);
    let command_of = built.find_subcommand(name);
    let added = own.filter(|entry| {
        !is_set(given, entry.setting) && !command_of.is_some_and(|one| yields(one, given, entry.setting))
    });
    let mut all = arguments.to_vec();
    all.splice(at + 1..=at, added.flat_map(|entry| entry.typed));
    match command.clone().try_get_matches_from(all) {
        Ok(matches) => Ok(matches),
        // What is wrong without the file, too, is told without it.
        Err(error) => Err(plain().err().map_or(Refused::Arguments(error, Some(path)), Into::into)),
    }
}

/// The file that a command goes by. A server's settings are never a person's own.
fn file_of(command: &str, given: &ArgMatches) -> Option<PathBuf> {
    let named = given.try_get_one::<PathBuf>(CONFIG).ok()?;
    let own = || own_file().filter(|file| !has_settings(command.as_ref()) && file.exists());
    named.cloned().or_else(own)
}

/// Whether something stronger than the file sets it.
fn is_set(given: &ArgMatches, setting: &Arg) -> bool {
    is_typed(given, setting.get_id()) || is_in_environment(setting)
}

fn is_typed(given: &ArgMatches, option: &Id) -> bool {
    given.value_source(option.as_str()) == Some(ValueSource::CommandLine)
}

fn is_in_environment(setting: &Arg) -> bool {
    setting.get_env().is_some_and(|name| std::env::var_os(name).is_some())
}

/// Whether something is typed that excludes it: a default is no reason to refuse what is typed.
fn yields(command: &Command, given: &ArgMatches, setting: &Arg) -> bool {
    let excludes = |one: &Arg, other: &Arg| {
        !one.is_global_set()
            && command.get_arg_conflicts_with(one).iter().any(|arg| arg.get_id() == other.get_id())
    };
    let alternatives = |other: &Arg| {
        let both = |group: &&ArgGroup| {
            [setting, other].iter().all(|arg| group.get_args().any(|id| id == arg.get_id()))
        };
        command.get_groups().filter(both).any(|group| !group.clone().is_multiple())
    };
    let typed = command.get_arguments().filter(|other| {
        other.get_id() != setting.get_id()
            && given.ids().any(|id| id == other.get_id())
            && is_typed(given, other.get_id())
    });
    typed.into_iter().any(|other| excludes(setting, other) || excludes(other, setting) || alternatives(other))
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
