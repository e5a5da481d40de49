//! What applies to the commands, and where it comes from.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use clap::{Arg, Command};

use super::file::{self, Entry};
use super::{CliError, VARIABLE, is_in_environment, key, known, own_file};

/// The file's lines as they are understood, with what goes before each, and the variables that are set. Values of variables may be
/// secrets, and are not shown.
///
/// # Errors
/// As of a command that goes by the file.
pub(in crate::commands) fn applied(mut program: Command, named: Option<&Path>) -> Result<String, CliError> {
    program.build();
    let mut page = String::new();
    match named.map(PathBuf::from).or_else(own_file) {
        Some(path) if named.is_some() || path.exists() => {
            let _ = writeln!(page, "# {}", path.display());
            file::read(&path, &known(&program))?.iter().for_each(|entry| page.push_str(&line(entry)));
        }
        Some(path) => {
            let _ = writeln!(
                page,
                "# no file: neither --config nor {VARIABLE} names one, and there is no {}",
                path.display()
            );
        }
        None => page.push_str("# no file, and no folder of your own where one could be\n"),
    }
    variables(&program).iter().for_each(|(name, commands)| {
        let _ = writeln!(page, "# {name} is set in the environment: {}", commands.join(", "));
    });
    Ok(page)
}

/// `command.key = value`, with its line.
fn line(entry: &Entry<'_>) -> String {
    let table = entry.table.as_ref().map(|table| format!("{table}.")).unwrap_or_default();
    let values: Vec<_> = entry.typed.iter().map(|typed| value(&typed.to_string_lossy())).collect();
    let value = match &values[..] {
        [] => "false".to_owned(),
        [one] => one.clone(),
        many => format!("[{}]", many.join(", ")),
    };
    let weaker = entry.setting.get_env().filter(|_| is_in_environment(entry.setting));
    let weaker =
        weaker.map(|name| format!("; {} goes before it", name.to_string_lossy())).unwrap_or_default();
    format!("{table}{} = {value}  # line {}{weaker}\n", key(entry.setting), entry.line)
}

/// The value of an option that was typed; nothing is a switch's.
fn value(typed: &str) -> String {
    match typed.split_once('=') {
        None => "true".to_owned(),
        Some((_, value)) if value.parse::<f64>().is_ok_and(f64::is_finite) => value.to_owned(),
        Some((_, value)) => toml::Value::from(value).to_string(),
    }
}

/// The variables that are set, and the commands that heed each.
fn variables(program: &Command) -> Vec<(String, Vec<String>)> {
    let mut found: Vec<(String, Vec<String>)> = Vec::new();
    for command in program.get_subcommands() {
        for name in
            command.get_arguments().filter(|option| is_in_environment(option)).filter_map(Arg::get_env)
        {
            let (name, command) = (name.to_string_lossy().into_owned(), command.get_name().to_owned());
            match found.iter_mut().find(|(one, _)| *one == name) {
                Some((_, commands)) => commands.push(command),
                None => found.push((name, vec![command])),
            }
        }
    }
    found
}
