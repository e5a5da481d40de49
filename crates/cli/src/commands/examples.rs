//! Tests of the examples in each command's help: every command has some, and each is taken as it is written. A new command
//! needs no line here: `#[command(after_help = "Examples:\n  densecloud …")]` beside its arguments is enough.

use clap::Command;

use super::program;

/// What begins the part of the help that has them; it ends at an empty line.
const TITLE: &str = "Examples:\n";
/// What ends a command in a line of a shell.
const ENDS: [&str; 6] = ["|", "&&", ">", ">>", ";", "#"];

/// All commands that do something, with what is typed for them.
fn leaves(command: &Command, path: &str, found: &mut Vec<(String, Command)>) {
    let path = format!("{path} {}", command.get_name()).trim_start().to_owned();
    let below: Vec<_> = command.get_subcommands().filter(|one| one.get_name() != "help").collect();
    below.iter().for_each(|one| leaves(one, &path, found));
    found.push((path, command.clone()));
}

fn commands() -> Vec<(String, Command)> {
    let mut found = Vec::new();
    leaves(&program(), "", &mut found);
    found
}

/// The lines of a command's examples.
fn examples(command: &Command) -> Vec<String> {
    let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let Some((_, examples)) = help.split_once(TITLE) else { return Vec::new() };
    examples.lines().take_while(|line| !line.is_empty()).map(str::to_owned).collect()
}

/// The words of a line of a shell from `densecloud` to the command's end. A variable stands for 1, as does what xargs adds.
fn words(line: &str) -> Option<Vec<String>> {
    let start = line.match_indices("densecloud ").map(|(at, _)| at).find(|at| {
        line[..*at].chars().next_back().is_none_or(|before| before.is_whitespace() || before == '(')
    })?;
    let (mut words, mut word, mut quoted) = (Vec::new(), String::new(), false);
    for letter in line[start..].chars() {
        match letter {
            '\'' => quoted = !quoted,
            ')' if !quoted => break,
            ' ' if !quoted => words.push(std::mem::take(&mut word)),
            letter => word.push(letter),
        }
    }
    words.push(word);
    let ends = words.iter().position(|word| ENDS.contains(&word.as_str())).unwrap_or(words.len());
    words.truncate(ends);
    words.extend(line[..start].contains("xargs").then(|| "1".to_owned()));
    words.iter_mut().filter(|word| word.starts_with('$')).for_each(|word| *word = "1".to_owned());
    Some(words.into_iter().filter(|word| !word.is_empty()).collect())
}

#[test]
fn every_command_has_examples() {
    for (path, command) in commands() {
        let own = examples(&command).iter().filter_map(|line| words(line)).any(|words| {
            let typed = words.join(" ");
            typed == path || typed.starts_with(&format!("{path} "))
        });
        assert!(
            own,
            "`{path}` needs an example of its own: #[command(after_help = \"Examples:\\n  {path} …\")]"
        );
    }
}

#[test]
fn every_example_is_taken_as_it_is_written() {
    for (path, command) in commands() {
        for words in examples(&command).iter().filter_map(|line| words(line)) {
            let taken = program().try_get_matches_from(&words);
            if let Some(why) = taken.err().filter(clap::Error::use_stderr) {
                panic!("an example of `{path}`, {words:?}: {why}");
            }
        }
    }
}

#[test]
fn a_line_of_a_shell_is_cut_where_the_command_ends() {
    for (line, expected) in [
        ("  densecloud view scan.las", Some("densecloud view scan.las")),
        ("  id=$(densecloud job submit a --ratio 4)", Some("densecloud job submit a --ratio 4")),
        ("  cat a | densecloud upsample - - > b", Some("densecloud upsample - -")),
        ("  seq 3 | xargs -n 1 densecloud tiles run work", Some("densecloud tiles run work 1")),
        ("  densecloud job get $id '{a} b'   # why", Some("densecloud job get 1 {a} b")),
        ("  curl http://densecloud/", None),
    ] {
        assert_eq!(words(line).map(|words| words.join(" ")).as_deref(), expected);
    }
}
