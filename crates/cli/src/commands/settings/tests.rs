use std::io::Write as _;

use clap::{CommandFactory, Parser};
use tempfile::NamedTempFile;

use super::*;

/// Any command will do; this one has an option of each kind.
#[derive(Debug, Parser)]
struct Program {
    #[command(subcommand)]
    command: Sub,
}

#[derive(Debug, clap::Subcommand)]
enum Sub {
    Serve(Options),
    Other,
}

#[derive(Debug, Args)]
struct Options {
    #[command(flatten)]
    settings: SettingsArgs,
    /// A whole number
    #[arg(long, env = "DENSECLOUD_TEST_WHOLE", default_value_t = 7)]
    whole: u16,
    /// A number
    #[arg(long, env = "DENSECLOUD_TEST_NUMBER", value_name = "X", default_value_t = 0.5)]
    number: f64,
    /// A text
    #[arg(long, env = "DENSECLOUD_TEST_TEXT", value_name = "WORDS")]
    text: Option<String>,
    /// A choice
    #[arg(long, env = "DENSECLOUD_TEST_CHOICE", default_value = "tea", value_parser = ["tea", "coffee"])]
    choice: String,
    /// A list
    #[arg(long, env = "DENSECLOUD_TEST_LIST", value_delimiter = ',')]
    list: Vec<String>,
    /// A list that is not empty by default
    #[arg(long, env = "DENSECLOUD_TEST_FULL", value_delimiter = ',', default_value = "a,b", value_parser = ["a", "b", "none"])]
    full: Vec<String>,
    /// The same, with nothing that stands for none
    #[arg(long, env = "DENSECLOUD_TEST_NEVER_EMPTY", default_value = "a")]
    never_empty: Vec<String>,
    /// A switch
    #[arg(long, env = "DENSECLOUD_TEST_SWITCH", requires = "text")]
    switch: bool,
    /// Excludes the number
    #[arg(long, env = "DENSECLOUD_TEST_ALONE", conflicts_with = "number")]
    alone: bool,
    /// Always set in the environment of a test by cargo
    #[arg(long, env = "CARGO_PKG_NAME", default_value = "none")]
    environment: String,
}

fn file(text: &str) -> NamedTempFile {
    let mut file = NamedTempFile::new().expect("a file");
    file.write_all(text.as_bytes()).expect("a file");
    file
}

fn parse_with(text: &str, more: &[&str]) -> Result<ArgMatches, Refused> {
    let file = file(text);
    let mut arguments: Vec<OsString> = ["densecloud", "serve", "--config"].map(OsString::from).to_vec();
    arguments.push(file.path().into());
    arguments.extend(more.iter().map(OsString::from));
    super::parse(&Program::command(), &arguments)
}

fn options(text: &str, more: &[&str]) -> Options {
    let matches = parse_with(text, more).unwrap_or_else(|why| panic!("{text}: {why:?}"));
    use clap::FromArgMatches;
    match Program::from_arg_matches(&matches).expect("options").command {
        Sub::Serve(options) => options,
        Sub::Other => panic!("another command"),
    }
}

fn told(text: &str, more: &[&str]) -> String {
    match parse_with(text, more).expect_err(text) {
        Refused::File(why) => why.to_string(),
        Refused::Arguments(why, file) => format!("{why}{}", if file.is_some() { "+file" } else { "" }),
    }
}

#[test]
fn every_kind_of_setting_is_read() {
    let all = "whole = 0x1_0\nnumber = 2\ntext = \"two words\"\nchoice = \"coffee\"\n\
               list = [\"a\", \"b\"]\nswitch = true\n";
    let read = options(all, &[]);
    assert_eq!((read.whole, read.number, read.text.as_deref()), (16, 2.0, Some("two words")));
    assert_eq!(
        (read.choice.as_str(), read.list, read.switch),
        ("coffee", vec!["a".into(), "b".into()], true)
    );
    assert_eq!(options("list = \"one\"\nswitch = false", &[]).list, ["one"]);
    assert_eq!(options("full = []\nlist = []", &[]).full, ["none"], "not the default");
    assert_eq!(options("full = []", &["--full=b"]).full, ["b"]);
    assert_eq!(options("", &[]).full, ["a", "b"]);
    let none = options("", &[]);
    assert_eq!((none.whole, none.number, none.text, none.switch), (7, 0.5, None, false));
}

#[test]
fn the_command_line_goes_first_then_the_environment_then_the_file() {
    let text = "whole = 8\nnumber = 1.5\nenvironment = \"file\"\nlist = [\"file\"]";
    let read = options(text, &["--whole=9", "--list=typed"]);
    assert_eq!((read.whole, read.number, read.list), (9, 1.5, vec!["typed".into()]));
    assert_eq!(read.environment, env!("CARGO_PKG_NAME"));
    assert_eq!(options(text, &["--environment=typed"]).environment, "typed");
}

#[test]
fn what_is_wrong_is_told_with_its_line_and_what_to_do() {
    for (text, words) in [
        ("\nwohle = 1", &[":2: ", "`wohle`", "did you mean `whole`?"][..]),
        ("zzz = 1", &[":1: no setting is called `zzz`"]),
        ("config = \"x\"", &["no setting is called `config`"]),
        ("[serve]\nwhole = 1", &[":1: no setting is called `serve`"]),
        ("whole = \"1\"", &[":1: `whole` must be a whole number, not string"]),
        ("whole = 1.5", &["`whole` must be a whole number, not float"]),
        ("whole = 70000", &["`whole` cannot be \"70000\"", "70000 is not in 0..=65535"]),
        ("number = true", &["`number` must be a number, not boolean"]),
        ("text = 5", &["`text` must be text in quotes, not integer"]),
        ("text = [\"a\"]", &["not array"]),
        ("switch = \"yes\"", &["`switch` must be true or false, not string"]),
        ("list = [1]", &["or an array of such, not integer"]),
        ("\nnever-empty = []", &[":2: `never-empty` cannot be empty"]),
        ("choice = \"milk\"", &["it is one of tea, coffee"]),
        ("whole = 1\n\nwhole = 2", &[":3: duplicate key"]),
        ("whole = ", &[":1: "]),
        ("whole = 1.5\nnumber = \"\"", &[":1: `whole`", ":2: `number`", "--print-config"]),
    ] {
        let told = told(text, &[]);
        for words in words {
            assert!(told.contains(words), "{text:?}: {words:?} is not in {told:?}");
        }
    }
}

#[test]
fn a_file_that_is_not_there_is_an_error() {
    let missing = ["densecloud", "serve", "--config", "/nowhere/x.toml"].map(OsString::from);
    match super::parse(&Program::command(), &missing) {
        Err(Refused::File(why)) => assert!(why.to_string().contains("/nowhere/x.toml"), "{why}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn options_and_file_are_weighed_together() {
    assert!(options("text = \"x\"", &["--switch"]).switch, "the file has what the option requires");
    assert!(told("switch = true", &[]).contains("--text"));
    assert!(told("number = 2\nalone = true", &[]).contains("+file"), "they exclude each other");
    let typed = told("whole = 3", &["--whole=many"]);
    assert!(typed.contains("many") && !typed.contains("+file"), "not the file's fault: {typed}");
}

#[test]
fn other_commands_have_no_file() {
    let other = super::parse(&Program::command(), &["densecloud", "other"].map(OsString::from));
    assert_eq!(other.expect("a command").subcommand_name(), Some("other"));
}

#[test]
fn the_page_says_the_same_when_it_is_read() {
    let all = ["--whole=3", "--number=1e3", "--text=a \"b\"\\", "--choice=coffee", "--list=a,b", "--switch"];
    let command = Program::command();
    let typed = parse_with("", &all).expect("options");
    let page = page(&command, &typed);
    assert!(page.contains("\nwhole = 3\n") && page.contains("\n#alone = false\n"), "{page}");
    let again = options(&page, &[]);
    assert_eq!((again.whole, again.number, again.text.as_deref()), (3, 1000.0, Some("a \"b\"\\")));
    assert_eq!((again.list, again.switch, again.alone), (vec!["a".into(), "b".into()], true, false));
}
