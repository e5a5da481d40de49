//! Reading the file.

use std::error::Error;
use std::ffi::OsString;
use std::fmt::Write;
use std::path::Path;

use clap::{Arg, Command};
use toml::de::{DeTable, DeValue};

use super::kind::Kind;
use super::{CliError, Settings, is_list, key};

/// One line of the file that sets something.
pub(super) struct Entry<'a> {
    pub(super) setting: &'a Arg,
    /// As it would be typed; nothing for a switch that is off.
    pub(super) typed: Vec<OsString>,
    /// The table that it is in, or none of the server's.
    pub(super) table: Option<String>,
    pub(super) line: usize,
}

/// A file while it is read, and what is wrong with it, each with its line.
struct Source<'s, 'a> {
    text: &'s str,
    commands: &'s [Settings<'a>],
    entries: Vec<Entry<'a>>,
    wrong: Vec<(usize, String)>,
}

/// Reads the file, and checks each entry by itself.
///
/// # Errors
/// All that is wrong, each with its line.
pub(super) fn read<'a>(path: &Path, commands: &[Settings<'a>]) -> Result<Vec<Entry<'a>>, CliError> {
    let shown = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| {
        CliError::Usage(format!("cannot read the settings in {shown} (--config): {error}"))
    })?;
    let mut source = Source { text: &text, commands, entries: Vec::new(), wrong: Vec::new() };
    let table = DeTable::parse(&text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        CliError::Usage(format!("{shown}:{}: {}", source.line(at), error.message()))
    })?;
    source.read(table.get_ref(), None);
    let Source { entries, mut wrong, .. } = source;
    if wrong.is_empty() {
        return Ok(entries);
    }
    wrong.sort();
    let mut told = String::new();
    for (line, why) in &wrong {
        // A string takes whatever is written to it.
        let _ = writeln!(told, "{shown}:{line}: {why}");
    }
    told.push_str("`densecloud serve --print-config` without the file shows every setting of the server; those of other commands are \
                   their options, in a table of the command's name: [upsample]");
    Err(CliError::Usage(told))
}

impl<'a> Source<'_, 'a> {
    fn line(&self, at: usize) -> usize {
        1 + self.text.as_bytes().iter().take(at).filter(|&&byte| byte == b'\n').count()
    }

    /// Reads a table of the file: that of the server's settings, which is the file itself, or a command's.
    fn read(&mut self, table: &DeTable<'_>, command: Option<&str>) {
        for (name, value) in table {
            let (at, name) = (self.line(name.span().start), name.get_ref());
            let known = |name: &str| self.commands.iter().any(|one| one.command == Some(name));
            match value.get_ref() {
                DeValue::Table(below) if command.is_none() && known(name) => self.read(below, Some(name)),
                value => self.set(at, name, value, command),
            }
        }
    }

    fn set(&mut self, line: usize, name: &str, value: &DeValue<'_>, command: Option<&str>) {
        let Some(known) = self.commands.iter().find(|one| one.command == command) else { return };
        match entry(name, value, known) {
            Ok((setting, typed)) => {
                let table = command.map(str::to_owned);
                self.entries.push(Entry { setting, typed, table, line });
            }
            Err(why) => {
                let table = command.map(|command| format!("[{command}] ")).unwrap_or_default();
                self.wrong.push((line, table + &why));
            }
        }
    }
}

/// What stands for nothing in a list that has something by default.
const NONE: &str = "none";

fn entry<'a>(
    name: &str,
    value: &DeValue<'_>,
    known: &Settings<'a>,
) -> Result<(&'a Arg, Vec<OsString>), String> {
    let Some(setting) = known.options.iter().find(|setting| key(setting) == name) else {
        return Err(unknown(name, &known.options));
    };
    let kind = known.kind(setting);
    let values: Vec<_> = match value {
        DeValue::Array(values) if is_list(setting) => values.iter().map(|value| value.get_ref()).collect(),
        value => vec![value],
    };
    let mut typed = Vec::new();
    // Nothing typed would leave the default, which is something.
    if values.is_empty() && !setting.get_default_values().is_empty() {
        if !setting.get_possible_values().iter().any(|one| one.get_name() == NONE) {
            return Err(format!("`{name}` cannot be empty; leave it out for its default"));
        }
        typed.push(OsString::from(format!("--{name}={NONE}")));
    }
    for value in values {
        let value = kind.typed(value).ok_or_else(|| {
            let list = if is_list(setting) { ", or an array of such" } else { "" };
            format!("`{name}` must be {}{list}, not {}", kind.name(), value.type_str())
        })?;
        match kind {
            Kind::Switch if value == "true" => typed.push(OsString::from(format!("--{name}"))),
            Kind::Switch => {}
            _ => {
                check(setting, &value).map_err(|why| format!("`{name}` cannot be {value:?}: {why}"))?;
                typed.push(OsString::from(format!("--{name}={value}")));
            }
        }
    }
    Ok((setting, typed))
}

/// Asks the option itself what it thinks of a value.
fn check(setting: &Arg, value: &str) -> Result<(), String> {
    let alone = Arg::new("value").value_parser(setting.get_value_parser().clone()).allow_hyphen_values(true);
    let Err(error) =
        Command::new("check").no_binary_name(true).arg(alone).try_get_matches_from(["--", value])
    else {
        return Ok(());
    };
    let choices: Vec<_> = setting.get_possible_values().iter().map(|one| one.get_name().to_owned()).collect();
    Err(match error.source() {
        _ if !choices.is_empty() => format!("it is one of {}", choices.join(", ")),
        Some(why) => why.to_string(),
        None => "the option does not take it".to_owned(),
    })
}

/// How alike two names must be for one to be a slip of the other; by the Jaro distance.
const ALIKE: f64 = 0.7;

fn unknown(name: &str, settings: &[&Arg]) -> String {
    let alike = |setting: &&&Arg| strsim::jaro(name, key(setting));
    let nearest = settings.iter().max_by(|a, b| alike(a).total_cmp(&alike(b)));
    match nearest.filter(|setting| alike(setting) > ALIKE) {
        Some(setting) => format!("no setting is called `{name}`; did you mean `{}`?", key(setting)),
        None => format!("no setting is called `{name}`"),
    }
}
