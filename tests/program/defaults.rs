//! A file of defaults for the commands.

use std::process::{Command, Output};

use crate::support::{densecloud, sphere, within};

/// The program without files and variables of whoever runs the test, with a folder of its own for them.
fn program(home: &str, arguments: &[&str]) -> Command {
    let mut command = densecloud();
    command.args(arguments).env("XDG_CONFIG_HOME", home).env_remove("DENSECLOUD_CONFIG");
    command
}

fn stdout(output: &Output) -> String {
    assert!(output.status.success(), "{output:?}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn what_is_typed_goes_first_then_the_environment_then_the_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(100)).expect("a file");
    std::fs::create_dir(path("densecloud")).expect("a folder");
    std::fs::write(path("densecloud/config.toml"), "[inspect]\nratio = 3\n").expect("a file");
    let other = "port = 1\n[inspect]\nratio = 8.5\n[upsample]\nratio = 8\nthreads = 1\nkeep-input = true\n";
    std::fs::write(path("other.toml"), other).expect("a file");
    let (input, other) = (path("in.xyz"), path("other.toml"));
    let ratio = |more: &[&str], file: Option<&str>| {
        let mut inspect = program(&path(""), &[&["inspect", &input, "--json"], more].concat());
        let output = inspect.envs(file.map(|file| ("DENSECLOUD_CONFIG", file))).output().expect("an end");
        let json: serde_json::Value = serde_json::from_str(&stdout(&output)).expect("JSON");
        json["upsampling"]["ratio"].as_f64().expect("a number")
    };
    assert_eq!(ratio(&[], None), 3.0, "its own folder's");
    assert_eq!(ratio(&[], Some(&other)), 8.5, "the environment's");
    assert_eq!(
        ratio(&["--config", &path("densecloud/config.toml")], Some(&other)),
        3.0,
        "the one that is typed"
    );
    assert_eq!(ratio(&["--ratio", "2"], Some(&other)), 2.0);

    let out = path("out.xyz");
    let upsample = |more: &[&str]| {
        let arguments =
            [&["upsample", &input, &out, "--config", &other, "--json", "--dry-run"], more].concat();
        let output = program(&path(""), &arguments).output().expect("an end");
        let events = stdout(&output);
        let estimate: serde_json::Value =
            serde_json::from_str(events.lines().nth(1).expect("two")).expect("JSON");
        estimate["points_out"].as_u64()
    };
    assert_eq!(upsample(&[]), Some(800));
    // Another goal that is typed is not refused for the default one.
    assert_eq!(upsample(&["--points", "300"]), Some(300));

    let mut config = program(&path(""), &["config", "--config", &other]);
    let page = stdout(&config.env("DENSECLOUD_THREADS", "2").output().expect("an end"));
    for line in
        ["port = 1  # line 1", "inspect.ratio = 8.5  # line 3", "upsample.keep-input = true  # line 7"]
    {
        assert!(page.contains(&format!("{line}\n")), "{page}");
    }
    assert!(page.contains("upsample.threads = 1  # line 6; DENSECLOUD_THREADS goes before it\n"), "{page}");
    assert!(page.contains("DENSECLOUD_THREADS is set in the environment: upsample"), "{page}");
}

#[test]
fn what_no_command_knows_is_refused_with_its_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(100)).expect("a file");
    for (text, told) in [
        ("[inspect]\nratoi = 8\n", ":2: [inspect] no setting is called `ratoi`; did you mean `ratio`?"),
        ("\nratio = 8\n", ":2: no setting is called `ratio`"),
        ("[inspcet]\nratio = 8\n", ":1: no setting is called `inspcet`"),
        ("[tiles]\nratio = 8\n", ":1: no setting is called `tiles`"),
        ("[upsample]\nratio = 65\n", ":2: [upsample] `ratio` cannot be \"65\""),
        ("[upsample]\nkeep-input = 1\n", ":2: [upsample] `keep-input` must be true or false"),
        ("[inspect]\nconfig = \"x\"\n", ":2: [inspect] no setting is called `config`"),
        ("[inspect]\nratio = \n", ":2: "),
    ] {
        std::fs::write(path("wrong.toml"), text).expect("a file");
        for arguments in [&["inspect", &*path("in.xyz")][..], &["config"]] {
            let mut command = program(&path(""), arguments);
            let output = command.env("DENSECLOUD_CONFIG", path("wrong.toml")).output().expect("an end");
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(64), "{text:?} {arguments:?}: {stderr}");
            assert!(stderr.contains(told) && output.stdout.is_empty(), "{text:?}: {stderr}");
        }
    }
    let missing = program(&path(""), &["inspect", &path("in.xyz"), "--config", "/nowhere.toml"]).output();
    assert_eq!(missing.expect("an end").status.code(), Some(64));
}
