//! What is beside the program for those who run it, held against the program: the reference of the
//! settings, the manual's tables, and all that names a setting or a metric.
//!
//! When a setting is new, `densecloud serve --print-config > deploy/densecloud.toml` and a row in
//! docs/http.md are what is missing.

mod fleet;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use serde_json::Value;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
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
        .filter(|line| {
            let none =
                ["model", "data-dir", "database", "database-password-file", "store", "keys", "base-path"];
            !none.iter().any(|none| line.starts_with(&format!("#{none} = ")))
        })
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

#[test]
fn the_table_of_limits_has_every_setting_that_is_one() {
    let (manual, limits) = (read("docs/http.md"), read("docs/limits.md"));
    let section = manual.split("\n### Limits\n").nth(1).and_then(|rest| rest.split("\n## ").next());
    let names =
        section.expect("a section").lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next());
    let names: Vec<_> = names.collect();
    assert!(names.len() > 20, "{names:?}");
    for name in names {
        assert!(limits.contains(&format!("`{name}`")), "{name} is not in docs/limits.md");
    }
}

/// Each variable that a file sets must be a setting's, and have a value that it takes.
fn check_variables<'a>(file: &str, set: impl Iterator<Item = &'a str>) {
    let settings = settings();
    let mut checked = 0;
    for assignment in set {
        let (variable, value) = assignment.split_once('=').expect("a value");
        checked += 1;
        if variable == "DENSECLOUD_CONFIG" {
            continue;
        }
        let known = settings.iter().find(|(_, setting)| setting.variable == variable);
        let (key, _) = known.unwrap_or_else(|| panic!("{file} sets {variable}, which is no setting"));
        let output = serve(&["--print-config", &format!("--{key}={value}")]);
        assert!(output.status.success(), "{file}: {assignment}: {output:?}");
    }
    assert!(checked > 0, "{file} sets nothing");
}

/// The command lines that a file runs must be taken, too.
fn check_command<'a>(file: &str, mut words: impl Iterator<Item = &'a str>) {
    assert_eq!(words.next(), Some("serve"), "{file}");
    let arguments: Vec<_> = words.collect();
    let output = serve(&[&["--print-config"], arguments.as_slice()].concat());
    assert!(output.status.success(), "{file}: {arguments:?}: {output:?}");
}

#[test]
fn the_systemd_unit_sets_what_there_is_and_waits_for_the_drain() {
    let unit = read("deploy/densecloud.service");
    let values = |name: &'static str| unit.lines().filter_map(move |line| line.strip_prefix(name));
    check_variables("the unit", values("Environment="));
    let command = values("ExecStart=").next().expect("a command");
    check_command("the unit", command.split(' ').skip(1));
    assert_eq!(values("RestartPreventExitStatus=").next(), Some("64"), "the code of a wrong setting");
    assert_eq!(values("ExecReload=").next(), Some("/bin/kill -HUP $MAINPID"));
    let settings = settings();
    let seconds = |key: &str| settings[key].default.parse::<f64>().expect("seconds");
    let stop: f64 = values("TimeoutStopSec=").next().expect("a timeout").parse().expect("seconds");
    assert!(stop > seconds("drain-lead") + seconds("drain-timeout"), "systemd would kill it before its end");
}

/// What the Dockerfile makes.
struct Image {
    environment: BTreeMap<String, String>,
    port: String,
    user: String,
    /// What that user may write to, and a volume.
    folder: String,
}

/// What follows a word of the Dockerfile, in each of its lines.
fn docker_lines(word: &str) -> Vec<String> {
    let file = read("Dockerfile");
    file.lines().filter_map(|line| line.strip_prefix(word)).map(|line| line.trim().to_owned()).collect()
}

/// The one that there is.
fn docker_line(word: &str) -> String {
    let [line] = &docker_lines(word)[..] else { panic!("one {word}") };
    line.clone()
}

fn image() -> Image {
    let set = docker_lines("ENV ").join(" ");
    let pairs = set.split(' ').map(|one| one.split_once('=').expect("a value"));
    Image {
        environment: pairs.map(|(name, value)| (name.to_owned(), value.to_owned())).collect(),
        port: docker_line("EXPOSE "),
        // The last is the finished image's.
        user: docker_lines("USER ").pop().expect("a user"),
        folder: docker_line("VOLUME "),
    }
}

#[test]
fn the_container_is_started_with_what_there_is() {
    let (file, image) = (read("Dockerfile"), image());
    let words = |command: &str| -> Vec<String> { serde_json::from_str(command).expect("JSON") };
    let command = words(&docker_line("CMD "));
    check_command("the Dockerfile", command.iter().map(String::as_str));
    let set: Vec<_> = image.environment.iter().map(|(name, value)| format!("{name}={value}")).collect();
    check_variables("the Dockerfile", set.iter().map(String::as_str));
    assert_eq!(image.environment["DENSECLOUD_PORT"], image.port);
    // The folder of the jobs belongs to the user who runs the server, also as a new volume; with other words for the command
    // there is none, since jobs may be shared.
    assert_eq!(command[1..], ["--data-dir", &image.folder]);
    let made = format!("install -d -o {} -m 0700 {}", image.user, image.folder);
    assert!(file.contains(&made), "{made}");
    let (_, check) = file.split_once("HEALTHCHECK ").expect("a check");
    let (_, check) = check.split_once("CMD ").expect("its command");
    assert_eq!(
        words(check.lines().next().expect("a line")),
        [&words(&docker_line("ENTRYPOINT "))[..], &["healthcheck".into()]].concat()
    );
}

/// The program at work, with a folder for jobs, ended with the test.
struct Serving {
    child: Child,
    url: String,
    _folder: tempfile::TempDir,
}

impl Serving {
    fn start() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let mut child = Command::new(env!("CARGO_BIN_EXE_densecloud"))
            .args(["serve", "--port=0", "--threads=1", "--log-format=json", "--data-dir"])
            .arg(folder.path())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut log = BufReader::new(child.stderr.take().expect("piped")).lines().map_while(Result::ok);
        let mut told = |message: &str| {
            let events = log.by_ref().filter_map(|line| serde_json::from_str::<Value>(&line).ok());
            let mut fields = events.map(|event| event["fields"].clone());
            fields
                .find(|fields| fields["message"] == message)
                .unwrap_or_else(|| panic!("it ended before {message:?}"))
        };
        let url = format!("http://{}", told("listening")["address"].as_str().expect("an address"));
        told("ready");
        // Nobody reads on; the rest must not fill the pipe.
        std::thread::spawn(move || log.for_each(drop));
        Self { child, url, _folder: folder }
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Each series' labels, as the program tells them once it has done something.
fn series() -> BTreeMap<String, BTreeSet<String>> {
    let serving = Serving::start();
    let cloud: String = (0..100).map(|i| format!("{} {} {}\n", i % 5, i / 5 % 5, i / 25)).collect();
    for door in ["upsample", "jobs"] {
        ureq::post(format!("{}/{door}?ratio=2", serving.url)).send(cloud.as_bytes()).expect("an answer");
    }
    // The first answer may still be on its way into the figures when the next request comes, and the job at work.
    let last = ["densecloud_request_duration_seconds_bucket", "densecloud_step_seconds_bucket"];
    for _ in 0..600 {
        let mut answer = ureq::get(format!("{}/metrics", serving.url)).call().expect("a page");
        let page = answer.body_mut().read_to_string().expect("text");
        if last.iter().all(|name| page.contains(name)) {
            return page.lines().filter(|line| !line.starts_with('#')).filter_map(labels).collect();
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    panic!("no request was counted, or no step of a job");
}

/// The name and the labels' names of `name{label="value",...} 1`.
fn labels(line: &str) -> Option<(String, BTreeSet<String>)> {
    let (series, _) = line.rsplit_once(' ')?;
    let (name, labels) = series.split_once('{').unwrap_or((series, ""));
    let names =
        labels.split(',').filter_map(|label| label.split_once("=\"")).map(|(name, _)| name.to_owned());
    Some((name.to_owned(), names.collect()))
}

/// What Prometheus adds to every series.
const ADDED: [&str; 2] = ["instance", "job"];

/// Whether a series' outcome has such a value: a problem, or one that the row of the series in the manual has.
fn is_outcome(name: &str, value: &str, manual: &str) -> bool {
    let row = manual.lines().find(|line| line.starts_with(&format!("| `{name}`"))).unwrap_or_default();
    let listed = row.split("`outcome` (").nth(1).and_then(|rest| rest.split(')').next()).unwrap_or_default();
    let named = row.contains(&format!("`{value}`")) || listed.split(", ").any(|one| one == value);
    named || manual.contains(&format!("| `{value}` |"))
}

/// Checks a query's names of series, of labels, and of outcomes; gives how many series it names.
fn check_query(query: &str, series: &BTreeMap<String, BTreeSet<String>>, manual: &str) -> usize {
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let (mut found, mut seen, mut rest) = (0, BTreeSet::new(), query);
    while let Some(start) = rest.find(word) {
        let (name, after) =
            rest[start..].split_at(rest[start..].find(|c| !word(c)).unwrap_or(rest[start..].len()));
        rest = after;
        if !name.starts_with("densecloud_") && !name.starts_with("process_") {
            continue;
        }
        let labels = series.get(name).unwrap_or_else(|| panic!("there is no {name}, which is in {query}"));
        (found, seen) = (found + 1, seen.union(labels).cloned().collect());
        let Some(selector) = after.strip_prefix('{').and_then(|after| after.split_once('}')) else {
            continue;
        };
        for matcher in selector.0.split(',') {
            let (label, value) = matcher.split_once(['=', '!']).expect("a matcher");
            assert!(labels.contains(label) || ADDED.contains(&label), "{name} has no label {label}: {query}");
            let values = value.trim_matches(|c| "=~\"".contains(c)).split('|');
            for value in values.filter(|_| label == "outcome") {
                assert!(is_outcome(name, value, manual), "no outcome of {name} is called {value}: {query}");
            }
        }
        rest = selector.1;
    }
    for grouped in query.split("by (").skip(1) {
        for label in grouped.split(')').next().unwrap_or_default().split(", ") {
            assert!(seen.contains(label) || ADDED.contains(&label), "nothing has a label {label}: {query}");
        }
    }
    found
}

/// All values of one name, however deep.
fn find<'a>(value: &'a Value, name: &str, found: &mut Vec<&'a str>) {
    match value {
        Value::Object(members) => {
            found.extend(members.get(name).and_then(Value::as_str));
            members.values().for_each(|value| find(value, name, found));
        }
        Value::Array(values) => values.iter().for_each(|value| find(value, name, found)),
        _ => {}
    }
}

#[test]
fn the_dashboard_and_the_alerts_ask_for_what_the_program_tells() {
    let (series, manual) = (series(), read("docs/http.md"));
    let dashboard: Value = serde_json::from_str(&read("deploy/grafana.json")).expect("JSON");
    let mut queries = Vec::new();
    find(&dashboard["panels"], "expr", &mut queries);
    find(&dashboard["templating"], "query", &mut queries);
    let found: usize = queries.iter().map(|query| check_query(query, &series, &manual)).sum();
    assert!(found > 20, "only {found} in {queries:?}");
    // The rules' only other words in their lines are their own names and prose.
    let alerts = read("deploy/alerts.yml");
    let rules: Vec<_> =
        alerts.split("expr:").skip(1).map(|rule| rule.split("labels:").next().unwrap_or(rule)).collect();
    for rule in &rules {
        assert!(check_query(rule, &series, &manual) > 0, "{rule}");
    }
    assert!(rules.len() > 3, "{alerts}");
    for (name, told) in series.iter().filter(|(name, _)| name.starts_with("densecloud_")) {
        let family =
            ["_bucket", "_sum", "_count"].iter().find_map(|end| name.strip_suffix(end)).unwrap_or(name);
        assert!(queries.iter().any(|query| query.contains(family)), "{name} {told:?} is in no panel");
    }
}

/// Of a series, and of a problem.
const MANUAL: &str = "| `densecloud_x` | `outcome` (ok, lost) |\n| `internal` |";

#[test]
fn a_query_for_what_is_not_there_is_found_out() {
    let series = BTreeMap::from([labels("densecloud_x{outcome=\"ok\",le=\"1\"} 1").expect("a series")]);
    let check = |query: &'static str| {
        let series = series.clone();
        std::panic::catch_unwind(move || check_query(query, &series, MANUAL)).ok()
    };
    assert_eq!(
        check("sum by (le) (rate(densecloud_x{job=\"a\",outcome=~\"ok|lost|internal\"}[1m])) / densecloud_x"),
        Some(2)
    );
    for wrong in [
        "densecloud_y",
        "densecloud_x{state=\"a\"}",
        "densecloud_x{outcome=\"fine\"}",
        "sum by (stage) (densecloud_x)",
    ] {
        assert_eq!(check(wrong), None, "{wrong}");
    }
}
