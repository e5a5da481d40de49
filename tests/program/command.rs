//! `densecloud serve` as a person runs it: with the model inside it, its log, and the `job` commands.

use crate::support::{Serving, agent, densecloud, run, sphere, within};

#[test]
fn the_server_gives_the_command_lines_bytes_and_stops_when_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(300)).expect("a file");
    let serving = Serving::start(&[]);
    // First text, then the binary PLY that the command line makes of it.
    for (input, output, ratio) in [("in.xyz", "dense.xyz", "3.7"), ("dense.ply", "denser.ply", "2")] {
        if input == "dense.ply" {
            let made = run(&["upsample", &path("in.xyz"), &path(input), "--ratio", "1.5"]);
            assert!(made.status.success(), "{made:?}");
        }
        let made = run(&["upsample", &path(input), &path(output), "--ratio", ratio, "--seed", "5"]);
        assert!(made.status.success(), "{made:?}");
        let body = std::fs::read(path(input)).expect("a file");
        let mut reply = ureq::post(serving.url(&format!("/upsample?ratio={ratio}&seed=5")))
            .send(&body[..])
            .expect("an answer");
        let served = reply.body_mut().read_to_vec().expect("a body");
        assert!(served == std::fs::read(path(output)).expect("a file"), "{input} at {ratio}");
    }
    serving.signal("TERM");
    assert_eq!(serving.end().code(), Some(0));
}

#[test]
fn the_command_line_leaves_a_job_and_fetches_what_upsample_would_have_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(300)).expect("a file");
    let serving = Serving::start(&["--data-dir", &path("jobs")]);
    // Others on the machine see nothing of it.
    let mode = std::fs::metadata(path("jobs")).expect("a folder").permissions();
    assert_eq!(std::os::unix::fs::PermissionsExt::mode(&mode) & 0o777, 0o700);
    let server = serving.url("");
    let job = |arguments: &[&str]| run(&[&["job", "--server", &server], arguments].concat());
    let submitted = job(&["submit", &path("in.xyz"), "--ratio", "3", "--seed", "5", "--accept", "model/e57"]);
    let id = String::from_utf8(submitted.stdout).expect("an id").trim().to_owned();
    let watched = job(&["watch", &id]);
    assert_eq!((watched.status.code(), watched.stdout.as_slice()), (Some(0), &b"done\n"[..]), "{watched:?}");
    assert!(String::from_utf8_lossy(&job(&["list"]).stdout).contains(&id));
    assert!(job(&["get", &id, &path("kept.e57")]).status.success());
    let made = run(&["upsample", &path("in.xyz"), &path("made.e57"), "--ratio", "3", "--seed", "5"]);
    assert!(made.status.success(), "{made:?}");
    let read = |name: &str| std::fs::read(path(name)).expect("a file");
    assert!(read("kept.e57") == read("made.e57"));
    assert!(job(&["cancel", &id]).status.success());
    let gone = job(&["get", &id, &path("gone.e57")]);
    assert_eq!(gone.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&gone.stderr).contains("no job"), "{gone:?}");
    assert!(!folder.path().join("gone.e57").exists());
}

#[test]
fn a_key_lets_a_client_in_and_is_in_no_log() {
    const KEY: &str = "only-between-us-two";
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let hash = "17a1b5e3a1d1b0b8f0d1c5b2a3e4f5061728394a5b6c7d8e9fa0b1c2d3e4f506";
    std::fs::write(path("keys"), format!("# hashed\nother sha256:{hash}\nme {KEY}\n")).expect("a file");
    let private = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(path("keys"), private).expect("permissions");
    let serving = Serving::start(&["--keys", &path("keys"), "--data-dir", &path("jobs"), "--log", "debug"]);
    let server = serving.url("");
    let list = |key: Option<&str>| {
        let mut command = densecloud();
        command.args(["job", "--server", &server, "list"]).env_remove("DENSECLOUD_KEY");
        command.envs(key.map(|key| ("DENSECLOUD_KEY", key))).output().expect("the program starts")
    };
    for (key, code) in [(None, 1), (Some("of-somebody-elses"), 1), (Some(KEY), 0)] {
        let output = list(key);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{stderr}");
        assert_eq!(stderr.contains("--keys"), code == 1, "{stderr}");
    }
    serving.signal("TERM");
    let log: Vec<String> = serving.log.iter().map(|event| event.to_string()).collect();
    assert!(log.iter().any(|line| line.contains("\"client\":\"me\"")), "{log:?}");
    assert!(!log.iter().any(|line| line.contains(KEY) || line.contains("somebody-elses")), "{log:?}");
}

#[test]
fn a_requests_id_is_in_its_answer_its_problem_and_the_log() {
    let serving = Serving::start(&[]);
    let agent = agent();
    let post = |target: &str, id: &str| {
        let request = agent.post(serving.url(target)).header("x-request-id", id);
        request.send(sphere(100).as_bytes()).expect("an answer")
    };
    for (target, id, status) in [
        ("/upsample?ratio=2", "fine-1", 200),
        ("/upsample?ratio=99", "wrong-2", 400),
        ("/nowhere", "lost-3", 404),
        ("/healthz", "method-4", 405),
        ("/v2/models/densecloud/infer", "tensor-5", 400),
        ("/jobs?ratio=2", "off-6", 501),
    ] {
        let mut answer = post(target, id);
        assert_eq!(
            (answer.status().as_u16(), &answer.headers()["x-request-id"]),
            (status, &id.parse().expect("an id"))
        );
        if answer.headers()["content-type"] == "application/problem+json" {
            let problem = answer.body_mut().read_to_string().expect("a problem");
            assert!(problem.contains(&format!("\"request_id\":\"{id}\"")), "{problem}");
        }
        drop(answer);
        // Probes leave no line.
        if target != "/healthz" {
            let event = serving.wait_for_event("request over");
            assert_eq!(
                (event["span"]["id"].as_str(), event["fields"]["status"].as_u64()),
                (Some(id), Some(status.into()))
            );
            for member in ["timestamp", "level"] {
                assert!(event[member].is_string(), "{event}");
            }
        }
    }
}
