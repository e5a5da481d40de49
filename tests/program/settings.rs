//! Settings: where they come from, and what is wrong with them.

use crate::support::{Serving, agent, densecloud, run, sphere};

#[test]
fn a_file_sets_what_nothing_stronger_sets() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("densecloud.toml");
    // The options of every test here are given, too: a port of zero, one thread, JSON.
    std::fs::write(&file, "max-points-in = 50\nmax-points-out = 100\nport = 1\nlog-format = \"text\"\n")
        .expect("a file");
    let mut command = densecloud();
    command.env("DENSECLOUD_CONFIG", &file).env("DENSECLOUD_MAX_POINTS_OUT", "150");
    let serving = Serving::start_from(command, &[]);
    let refusal = |points: usize, ratio: u32| {
        let mut answer = serving.post(&format!("/upsample?ratio={ratio}"), sphere(points).as_bytes());
        answer.body_mut().read_to_string().expect("text")
    };
    assert!(refusal(51, 2).contains("more than 50;"), "{}", refusal(51, 2));
    assert!(refusal(40, 4).contains("\"limit\":150"), "{}", refusal(40, 4));
}

#[test]
fn an_empty_list_of_what_is_open_opens_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, keys) = (folder.path().join("densecloud.toml"), folder.path().join("keys"));
    let hash = "17a1b5e3a1d1b0b8f0d1c5b2a3e4f5061728394a5b6c7d8e9fa0b1c2d3e4f506";
    std::fs::write(&keys, format!("me sha256:{hash}\n")).expect("a file");
    std::fs::write(&file, "open = []\n").expect("a file");
    let (file, keys) = (file.to_str().expect("UTF-8"), keys.to_str().expect("UTF-8"));
    let serving = Serving::start(&["--config", file, "--keys", keys]);
    for target in ["/healthz", "/readyz", "/metrics", "/docs", "/openapi.json"] {
        let answer = agent().get(serving.url(target)).call().expect("an answer");
        assert_eq!(answer.status().as_u16(), 401, "{target}");
    }
}

#[test]
fn settings_are_checked_before_a_port_is_bound() {
    for (arguments, named) in [
        (&["serve", "--max-points-in", "0"][..], "--max-points-in"),
        (&["serve", "--max-held-bytes", "5"], "--max-held-bytes"),
        (&["serve", "--log", "=loud="], "--log"),
        (&["serve", "--stall-timeout", "soon"], "--stall-timeout"),
        (&["serve", "--head-timeout", "1e19"], "ten years"),
        (&["serve", "--drain-timeout", "1e19"], "ten years"),
        (&["serve", "--host", "127.0.0.1:80"], "--host \"127.0.0.1:80\""),
        (&["serve", "--max-memory", "much"], "--max-memory"),
        (&["serve", "--open", "doors"], "--open"),
        (&["serve", "--open", "none,health"], "--open"),
        (&["serve", "--keys", "/nowhere/keys"], "/nowhere/keys"),
        (&["serve", "--keys", concat!(env!("CARGO_MANIFEST_DIR"), "/../../LICENSE-MIT")], "line 1"),
        (&["serve", "--no-such-option"], "--no-such-option"),
        (&["serve", "--model", "/nowhere"], "--model"),
        (&["serve", "--data-dir", "Cargo.toml"], "--data-dir"),
        (&["serve", "--data-dir", "Cargo.toml/jobs"], "--data-dir"),
        (&["serve", "--config", "/nowhere.toml"], "/nowhere.toml"),
        (&["serve", "--config", "Cargo.toml"], "Cargo.toml:1: no setting is called `package`"),
        (&["serve", "--cors-origin", "example.org"], "https://example.org"),
        (&["serve", "--cors-origin", "*,https://example.org"], "--cors-origin"),
        (&["serve", "--print-config", "--max-points-in", "0"], "--max-points-in"),
        (&["no-such-command"], "no-such-command"),
    ] {
        let output = run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{stderr}");
        assert!(stderr.contains(named), "{stderr}");
    }
}

#[test]
fn a_port_that_is_taken_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();
    let output = run(&["serve", "--port", &port]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let why = stderr.lines().find_map(|line| line.strip_prefix("densecloud: "));
    let why = why.unwrap_or_else(|| panic!("for people: {stderr}"));
    assert!(why.contains(&port) && why.contains("--port"), "{why}");
    assert!(stderr.contains(&format!("ERROR failed why={why}")), "in the log, too: {stderr}");
}

#[test]
fn settings_that_are_broken_are_a_server_that_is_not_healthy() {
    let folder = tempfile::tempdir().expect("a folder");
    let (broken, missing) = (folder.path().join("broken.toml"), folder.path().join("missing.toml"));
    std::fs::write(&broken, "port = \"none\"\n").expect("a file");
    for (name, value) in [("CONFIG", broken.as_path()), ("CONFIG", &missing), ("PORT", "none".as_ref())] {
        let mut command = densecloud();
        let ended = command.env(format!("DENSECLOUD_{name}"), value).arg("healthcheck").output();
        let ended = ended.expect("the program starts");
        assert_eq!(ended.status.code(), Some(1), "{name}: {ended:?}");
    }
}
