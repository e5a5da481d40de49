//! What is made of the commands' own description: completions of shells, and manual pages.

use std::collections::BTreeSet;
use std::process::Command;

use crate::support::{densecloud, run, within};

fn printed(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success() && output.stderr.is_empty(), "{arguments:?}: {output:?}");
    String::from_utf8(output.stdout).expect("text")
}

/// The commands that the help lists.
fn commands() -> BTreeSet<String> {
    let help = printed(&["help"]);
    let lines =
        help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let names = lines.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    let names: BTreeSet<_> =
        names.filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect();
    assert!(names.contains("upsample") && names.contains("help"), "{help}");
    names
}

#[test]
fn every_shell_is_told_of_every_command() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = printed(&["completions", shell]);
        for command in commands() {
            assert!(script.contains(&command), "{shell}: {command}");
        }
        assert!(script.contains("keep-input"), "{shell}: options");
    }
    assert_eq!(run(&["completions", "cmd"]).status.code(), Some(64));
}

#[test]
fn bash_completes_commands_and_options() {
    if Command::new("bash").arg("-c").arg("true").status().is_err() {
        return;
    }
    let complete = "eval \"$($1 completions bash)\"; COMP_WORDS=(densecloud \"${@:2}\"); \
                    COMP_CWORD=$(($# - 1)); _densecloud densecloud \"${@: -1}\" \"${@: -2:1}\"; echo \"${COMPREPLY[@]}\"";
    let completed = |words: &[&str]| {
        let program = densecloud().get_program().to_owned();
        let mut bash = Command::new("bash");
        bash.args(["--noprofile", "--norc", "-c", complete, "bash"]).arg(program).args(words);
        let output = bash.output().expect("bash");
        assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
        String::from_utf8(output.stdout).expect("text").trim().to_owned()
    };
    assert_eq!(completed(&["ups"]), "upsample");
    assert_eq!(completed(&["upsample", "--keep-i"]), "--keep-input");
    assert_eq!(completed(&["tiles", "jo"]), "join");
}

#[test]
fn every_command_has_a_manual_page() {
    let page = printed(&["man"]);
    assert!(page.contains(".TH densecloud 1"), "{page}");
    let folder = tempfile::tempdir().expect("a folder");
    let pages = within(&folder)("share/man1");
    assert_eq!(printed(&["man", "--dir", &pages]), "");
    for command in commands().into_iter().filter(|command| command != "help") {
        assert!(page.contains(&format!("densecloud\\-{command}(1)")), "{command}: {page}");
        let own = std::fs::read_to_string(format!("{pages}/densecloud-{command}.1")).expect("a page");
        assert!(own.contains(&format!(".TH densecloud-{command} 1")) && own.contains("Examples:"), "{own}");
    }
    assert!(std::path::Path::new(&pages).join("densecloud-tiles-join.1").exists());
}
