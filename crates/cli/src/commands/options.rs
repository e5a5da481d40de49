//! The options of a result, as the command line has them: one for each of the library's [`PARAMETERS`], so that a new
//! one needs no line here.

use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};
use densecloud::{Options, PARAMETERS, Parameter, Topic};

use densecloud_formats::Reading;

use super::CliError;

/// All options that were typed, by their names.
#[derive(Debug, Clone, Default)]
pub(super) struct OptionArgs(Vec<(&'static str, String)>);

/// The same of those of the cascade alone.
#[derive(Debug, Clone, Default)]
pub(super) struct CascadeArgs(Vec<(&'static str, String)>);

/// The same of those that say how a cloud is read.
#[derive(Debug, Clone, Default)]
pub(super) struct ReadingArgs(Vec<(&'static str, String)>);

/// The group of the goals: one of them at most may be given.
pub(super) const GOALS: &str = "target";

/// What the command line alone asks for: a cloud to score comes from elsewhere.
const PREDICTIONS: &str = "pred";

impl OptionArgs {
    /// What they mean.
    ///
    /// # Errors
    /// [`CliError::Usage`]; the parser has judged each option by itself.
    pub(super) fn options(&self) -> Result<Options, CliError> {
        read(&self.0)
    }
}

impl CascadeArgs {
    /// How the cascade is run, with this seed.
    ///
    /// # Errors
    /// As [`OptionArgs::options`].
    pub(super) fn settings(&self, seed: u64) -> Result<densecloud_cascade::CascadeOptions, CliError> {
        Ok(densecloud_cascade::CascadeOptions { seed, ..read(&self.0)?.cascade })
    }
}

impl ReadingArgs {
    /// What they mean.
    ///
    /// # Errors
    /// As [`OptionArgs::options`].
    pub(super) fn reading(&self) -> Result<Reading, CliError> {
        Ok(read(&self.0)?.reading)
    }
}

fn read(typed: &[(&'static str, String)]) -> Result<Options, CliError> {
    Options::parse(typed).map_err(|error| CliError::Usage(format!("--{}: {}", flag(&error.name), error.why)))
}

fn flag(name: &str) -> String {
    name.replace('_', "-")
}

fn of_cascade() -> impl Iterator<Item = &'static Parameter> {
    PARAMETERS.iter().filter(|parameter| parameter.topic == Topic::Cascade)
}

fn of_reading() -> impl Iterator<Item = &'static Parameter> {
    PARAMETERS.iter().filter(|parameter| parameter.topic == Topic::Reading)
}

/// The option of a parameter.
fn arg(parameter: &'static Parameter) -> Arg {
    let mut arg = Arg::new(parameter.name).long(flag(parameter.name)).help(help(parameter));
    if let Some(short) = parameter.short {
        arg = arg.short(short);
    }
    if parameter.topic == Topic::Goal {
        arg = arg.group(GOALS);
    }
    arg = match parameter.value {
        None => arg.action(ArgAction::SetTrue),
        Some(value) => {
            let parse = move |text: &str| parameter.check(text).map(|()| text.to_owned());
            arg.value_name(value).value_parser(parse)
        }
    };
    // Coordinates may begin with a minus, and a place to look from is of no use without normals.
    match parameter.name {
        "sensor" => arg.allow_hyphen_values(true).requires("normals"),
        "bounds" => arg.allow_hyphen_values(true),
        _ => arg,
    }
}

fn help(parameter: &Parameter) -> String {
    match parameter.default_value().filter(|_| parameter.value.is_some()) {
        Some(value) => format!("{} [default: {value}]", parameter.help),
        None => parameter.help.to_owned(),
    }
}

/// Of these parameters, those that were typed.
fn typed(
    parameters: impl Iterator<Item = &'static Parameter>,
    matches: &ArgMatches,
) -> Vec<(&'static str, String)> {
    let given = parameters.filter(|p| matches.value_source(p.name) == Some(ValueSource::CommandLine));
    let value = |parameter: &Parameter| match parameter.value {
        None => matches.get_flag(parameter.name).to_string(),
        Some(_) => matches.get_one::<String>(parameter.name).cloned().unwrap_or_default(),
    };
    given.map(|parameter| (parameter.name, value(parameter))).collect()
}

impl Args for OptionArgs {
    fn augment_args(command: Command) -> Command {
        command.args(PARAMETERS.iter().map(arg))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for OptionArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        Ok(Self(typed(PARAMETERS.iter(), matches)))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for CascadeArgs {
    fn augment_args(command: Command) -> Command {
        command.args(of_cascade().map(|parameter| arg(parameter).conflicts_with(PREDICTIONS)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for CascadeArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        Ok(Self(typed(of_cascade(), matches)))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for ReadingArgs {
    fn augment_args(command: Command) -> Command {
        command.args(of_reading().map(arg))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for ReadingArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        Ok(Self(typed(of_reading(), matches)))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}
