//! Writing the file.

use std::fmt::Write;

use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Command};

use super::kind::Kind;
use super::{given, is_list, key, of_serve};

/// Characters in a line of the page.
const WIDTH: usize = 100;

/// All settings as a file, those at their defaults commented out.
pub(in crate::commands) fn page(command: &Command, matches: &ArgMatches) -> String {
    let mut page = String::from(
        "# Settings of `densecloud serve` and `densecloud worker`; give them this file with --config or DENSECLOUD_CONFIG.\n\
         # Options on the command line go before variables in the environment, these before this file.\n\
         # Each setting is here with its default, its option and its variable.\n",
    );
    let Some(serve) = given(matches) else { return page };
    for setting in of_serve(command) {
        page.push('\n');
        let mut help = setting.get_help().map(ToString::to_string).unwrap_or_default();
        let choices = setting.get_possible_values();
        if !choices.is_empty() && Kind::of(setting) != Kind::Switch {
            let names: Vec<_> = choices.iter().map(|one| one.get_name()).collect();
            let _ = write!(help, ": {}", names.join(", "));
        }
        comment(&mut page, &help);
        let variable = setting.get_env().unwrap_or_default().to_string_lossy();
        let value = match Kind::of(setting) {
            Kind::Switch => String::new(),
            _ => format!(" {}", value_name(setting)),
        };
        comment(&mut page, &format!("--{}{value}, {variable}", key(setting)));
        let _ = writeln!(page, "{}", line(setting, serve));
    }
    page
}

/// `key = value`, behind a `#` where nothing sets it.
fn line(setting: &Arg, serve: &ArgMatches) -> String {
    let (id, kind) = (setting.get_id().as_str(), Kind::of(setting));
    let set = serve.value_source(id).is_some_and(|source| source != ValueSource::DefaultValue);
    let raw = serve.get_raw(id).into_iter().flatten();
    let values: Vec<_> = match kind {
        // A switch has no raw value where its option was typed.
        Kind::Switch => vec![serve.get_flag(id).to_string()],
        _ => raw.map(|value| kind.toml(value)).collect(),
    };
    let value = match values.as_slice() {
        values if is_list(setting) => format!("[{}]", values.join(", ")),
        [value, ..] => value.clone(),
        // Nothing is the default, so an example of what it would be.
        [] => toml::Value::from(value_name(setting)).to_string(),
    };
    format!("{}{} = {value}", if set { "" } else { "#" }, key(setting))
}

/// What the help calls its value.
fn value_name(setting: &Arg) -> String {
    let named = setting.get_value_names().and_then(|names| names.first()).map(ToString::to_string);
    named.unwrap_or_else(|| key(setting).to_uppercase())
}

/// Adds words as comment lines.
fn comment(page: &mut String, words: &str) {
    let mut length = WIDTH;
    for word in words.split_whitespace() {
        if length + 1 + word.chars().count() > WIDTH {
            if page.ends_with(|last: char| last != '\n') {
                page.push('\n');
            }
            page.push('#');
            length = 1;
        }
        page.push(' ');
        page.push_str(word);
        length += 1 + word.chars().count();
    }
    page.push('\n');
}
