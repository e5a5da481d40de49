//! Which form the log was to have, where the settings are not taken.

use std::ffi::OsString;
use std::path::Path;

use toml::de::DeTable;

use super::{has_settings, place};

/// The setting, its value for JSON, and the file's own.
const FORMAT: (&str, &str) = ("log-format", "DENSECLOUD_LOG_FORMAT");
const JSON: &str = "json";
const FILE: (&str, &str) = ("config", "DENSECLOUD_CONFIG");
/// With it, nothing is served, and nothing logged.
const PRINT: &str = "--print-config";

/// Whether a server with these arguments (the program's name first) would log in JSON, as far as can be told: whatever is
/// wrong with the rest, whoever reads its log reads JSON.
pub(in crate::commands) fn logs_json(arguments: &[OsString]) -> bool {
    let Some(at) = place(arguments) else { return false };
    let (command, options) = (&arguments[at], &arguments[at + 1..]);
    if !has_settings(command) || options.iter().any(|option| option == PRINT) {
        return false;
    }
    let set = |(option, variable)| typed(options, option).or_else(|| std::env::var_os(variable));
    let format = set(FORMAT).or_else(|| in_file(Path::new(&set(FILE)?)));
    format.is_some_and(|format| format == JSON)
}

/// What follows an option, behind a `=` or as the next argument.
fn typed(options: &[OsString], name: &str) -> Option<OsString> {
    options.iter().enumerate().find_map(|(i, option)| {
        let value = option.to_str()?.strip_prefix("--")?.strip_prefix(name)?;
        match value.strip_prefix('=') {
            Some(value) => Some(value.into()),
            None if value.is_empty() => options.get(i + 1).cloned(),
            None => None,
        }
    })
}

/// What a file says of it, whatever else is in there.
fn in_file(path: &Path) -> Option<OsString> {
    let text = std::fs::read_to_string(path).ok()?;
    let (table, _) = DeTable::parse_recoverable(&text);
    Some(table.get_ref().get(FORMAT.0)?.get_ref().as_str()?.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn logs_json(arguments: &[&str]) -> bool {
        let arguments: Vec<_> = arguments.iter().map(OsString::from).collect();
        super::logs_json(&arguments)
    }

    #[test]
    fn the_form_of_the_log_is_known_whatever_else_is_wrong() {
        for (arguments, expected) in [
            (&["densecloud", "serve", "--no-such", "--log-format", "json"][..], true),
            (&["densecloud", "serve", "--log-format=json", "--port", "x"], true),
            (&["densecloud", "serve", "--log-format=text"], false),
            (&["densecloud", "serve", "--log-format"], false),
            (&["densecloud", "serve", "--log-formats=json"], false),
            (&["densecloud", "serve", "--log-format=json", "--print-config"], false),
            (&["densecloud", "upsample", "--log-format=json"], false),
            (&["densecloud", "-q", "serve", "--log-format=json"], true),
            (&["densecloud", "serve"], false),
            (&["densecloud"], false),
            (&[], false),
        ] {
            assert_eq!(logs_json(arguments), expected, "{arguments:?}");
        }
    }

    #[test]
    fn a_file_tells_it_even_if_it_is_broken() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("x.toml");
        for (text, expected) in [
            ("log-format = \"json\"\n", true),
            ("port = many\nlog-format = \"json\"\nx = [\n", true),
            ("log-format = \"text\"\n", false),
            ("log-format = 5\n", false),
            ("", false),
        ] {
            std::fs::write(&path, text).expect("a file");
            let file = path.to_str().expect("UTF-8");
            assert_eq!(logs_json(&["densecloud", "serve", "--config", file]), expected, "{text:?}");
            assert!(!logs_json(&["densecloud", "serve", "--config", file, "--log-format=text"]), "{text:?}");
        }
        assert!(!logs_json(&["densecloud", "serve", "--config=/nowhere.toml"]));
    }
}
