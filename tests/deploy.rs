//! What is beside the program for those who run it, held against the program: the reference of the
//! settings, the manual's tables, and all that names a setting or a metric.
//!
//! When a setting is new, `densecloud serve --print-config > deploy/densecloud.toml` and a row in
//! docs/http.md are what is missing.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Command, Output};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|why| panic!("{path}: {why}"))
}

/// The program with nothing set in its environment.
fn serve(arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_densecloud"));
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("DENSECLOUD_"))
    {
        program.env_remove(name);
    }
    program.arg("serve").args(arguments).output().expect("the program starts")
}

fn reference() -> String {
    let output = serve(&["--print-config"]);
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// A setting as the program itself tells it.
struct Setting {
    #[expect(dead_code)]
    variable: String,
    default: String,
}

/// Every setting by its key.
fn settings() -> BTreeMap<String, Setting> {
    let mut settings = BTreeMap::new();
    let page = reference();
    let lines: Vec<_> = page.lines().collect();
    for two in lines.windows(2) {
        let Some((key, default)) = two[1].strip_prefix('#').and_then(|line| line.split_once(" = ")) else {
            continue;
        };
        if let Some((_, variable)) = two[0].strip_prefix("# --").and_then(|line| line.split_once(", ")) {
            let setting =
                Setting { variable: variable.to_owned(), default: default.trim_matches('"').to_owned() };
            settings.insert(key.to_owned(), setting);
        }
    }
    assert!(settings.len() > 20, "only {:?}", settings.keys());
    settings
}

#[test]
fn the_reference_file_is_what_the_program_prints() {
    assert!(
        read("deploy/densecloud.toml") == reference(),
        "run `densecloud serve --print-config > deploy/densecloud.toml`"
    );
}

#[test]
fn the_reference_file_with_all_of_it_in_force_is_the_defaults() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("all.toml");
    let text: String = reference()
        .lines()
        // What is not set by default has an example that need not exist.
        .filter(|line| !["#model = ", "#data-dir = "].iter().any(|none| line.starts_with(none)))
        .map(|line| {
            format!("{}\n", line.strip_prefix('#').filter(|rest| rest.contains(" = ")).unwrap_or(line))
        })
        .collect();
    std::fs::write(&file, text).expect("a file");
    let output = serve(&["--print-config", "--config", file.to_str().expect("UTF-8")]);
    assert!(output.status.success(), "{output:?}");
    let (all, plain) = (String::from_utf8(output.stdout).expect("UTF-8"), reference());
    for (all, plain) in all.lines().zip(plain.lines()) {
        assert_eq!(all.trim_start_matches('#'), plain.trim_start_matches('#'));
    }
    assert!(all.contains("\nport = 8080\n"), "{all}");
}

#[test]
fn the_manual_has_every_setting_with_its_default() {
    let manual = read("docs/http.md");
    let settings = settings();
    for (key, Setting { default, .. }) in &settings {
        let row = manual.lines().find_map(|line| line.strip_prefix(&format!("| `--{key}` |")));
        let row = row.unwrap_or_else(|| panic!("--{key} has no row in docs/http.md"));
        let told = row.split('|').next().unwrap_or_default().trim();
        // What has no default has an example's name in the reference, and nothing in the manual.
        let example = default.chars().all(|c| c.is_ascii_uppercase() || "[]_".contains(c));
        let expected = if example { "" } else { default };
        assert_eq!(told, expected, "--{key}: the manual, the program");
    }
    for line in manual.lines().filter_map(|line| line.strip_prefix("| `--")) {
        let key = line.split('`').next().unwrap_or_default();
        assert!(settings.contains_key(key), "the manual has --{key}, the program has not");
    }
}
