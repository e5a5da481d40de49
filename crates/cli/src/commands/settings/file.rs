//! Reading the file.

use std::error::Error;
use std::ffi::OsString;
use std::fmt::Write;
use std::path::Path;

use clap::{Arg, Command};
use toml::de::{DeTable, DeValue};

use super::kind::Kind;
use super::{CliError, is_list, key};

/// One line of the file that sets something.
pub(super) struct Entry<'a> {
    pub(super) setting: &'a Arg,
    /// As it would be typed; nothing for a switch that is off.
    pub(super) typed: Vec<OsString>,
}

/// Reads the file and checks each entry by itself.
///
/// # Errors
/// All that is wrong, each with its line.
pub(super) fn read<'a>(path: &Path, settings: &[&'a Arg]) -> Result<Vec<Entry<'a>>, CliError> {
    let shown = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| {
        CliError::Usage(format!("cannot read the settings in {shown} (--config): {error}"))
    })?;
    let line = |at: usize| 1 + text.as_bytes().iter().take(at).filter(|&&byte| byte == b'\n').count();
    let table = DeTable::parse(&text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        CliError::Usage(format!("{shown}:{}: {}", line(at), error.message()))
    })?;
    let (mut entries, mut wrong) = (Vec::new(), Vec::new());
    for (name, value) in table.get_ref() {
        match entry(name.get_ref(), value.get_ref(), settings) {
            Ok(entry) => entries.push(entry),
            Err(why) => wrong.push((line(name.span().start), why)),
        }
    }
    if wrong.is_empty() {
        return Ok(entries);
    }
    wrong.sort();
    let mut told = String::new();
    for (line, why) in &wrong {
        // A string takes whatever is written to it.
        let _ = writeln!(told, "{shown}:{line}: {why}");
    }
    told.push_str("`densecloud serve --print-config` without the file shows every setting");
    Err(CliError::Usage(told))
}

/// What stands for nothing in a list that has something by default.
const NONE: &str = "none";

fn entry<'a>(name: &str, value: &DeValue<'_>, settings: &[&'a Arg]) -> Result<Entry<'a>, String> {
    let Some(setting) = settings.iter().find(|setting| key(setting) == name) else {
        return Err(unknown(name, settings));
    };
    let kind = Kind::of(setting);
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
    Ok(Entry { setting, typed })
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
