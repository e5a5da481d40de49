//! `densecloud upsample --server`.

use std::io::{BufRead, BufReader, Write};
use std::sync::mpsc::{Receiver, channel};

use crate::support::{Serving, densecloud, run, sphere, within};

/// A server that answers each request with the next of these, and tells what it was sent.
fn canned(answers: Vec<String>) -> (String, Receiver<String>) {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}", listener.local_addr().expect("an address"));
    let (sender, requests) = channel();
    std::thread::spawn(move || {
        for answer in answers {
            let (mut stream, _) = listener.accept().expect("a client");
            let mut reader = BufReader::new(stream.try_clone().expect("a stream"));
            let mut head = String::new();
            while !head.ends_with("\r\n\r\n") {
                reader.read_line(&mut head).expect("a head");
            }
            let _ = sender.send(head);
            stream.write_all(answer.as_bytes()).expect("an answer");
        }
    });
    (url, requests)
}

fn refusal(status: &str, kind: &str, retry_after: &str) -> String {
    let body = format!(
        "{{\"type\":\"urn:densecloud:problem:{kind}\",\"title\":\"x\",\"detail\":\"told so\",\"request_id\":\"r-1\"}}"
    );
    format!(
        "HTTP/1.1 {status}\r\nconnection: close\r\n{retry_after}content-type: application/problem+json\r\n\
         content-length: {}\r\n\r\n{body}",
        body.len()
    )
}

#[test]
fn upsample_has_a_server_make_the_bytes_that_it_would_have_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let read = |name: &str| std::fs::read(path(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    std::fs::write(path("in.xyz"), sphere(300)).expect("a file");
    let serving = Serving::start(&[]);
    let server = ["--server", &serving.url("/")];
    let all = ["--keep-input", "--source-fields", "--normals", "estimate", "--sensor", "500000,-0.5,9"];
    for (ending, options) in [
        ("xyz", &["--ratio", "2.5", "--seed", "5"][..]),
        ("ply", &[]),
        ("laz", &["--points", "500"]),
        ("csv", &["--spacing", "0.08", "--quiet"]),
        ("dense", &["--density", "40"]),
        ("e57", &all),
        ("npy", &["--attributes", "nx:drop"]),
    ] {
        // The last has attributes to drop.
        let input = if ending == "npy" { path("in.ply") } else { path("in.xyz") };
        if ending == "npy" {
            let made = run(&["upsample", &path("in.xyz"), &input, "--ratio", "1", "--normals", "estimate"]);
            assert!(made.status.success(), "{made:?}");
        }
        let (here, there) = (format!("here.{ending}"), format!("there.{ending}"));
        let made = run(&[&["upsample", &input, &path(&here)], options].concat());
        assert!(made.status.success(), "{made:?}");
        let sent = run(&[&["upsample", &input, &path(&there)], options, &server[..]].concat());
        assert!(sent.status.success(), "{sent:?}");
        assert!(read(&here) == read(&there), "{ending}");
        assert_eq!(sent.stderr.is_empty(), options.contains(&"--quiet"), "{sent:?}");
        let beside = |name: &str| std::fs::read(path(&format!("{name}.provenance.txt"))).ok();
        assert_eq!(beside(&here), beside(&there), "{ending}");
    }
    // By pipes, too.
    let mut piped = densecloud();
    piped.args(["upsample", "-", "-", "--ratio", "2.5", "--seed", "5"]).args(server);
    piped.stdin(std::fs::File::open(path("in.xyz")).expect("a file"));
    assert!(piped.output().expect("an end").stdout == read("here.xyz"));
    // What is wrong is told as it would be here, and leaves no file.
    std::fs::write(path("bad.xyz"), "1 2 3\n4 five 6\n").expect("a file");
    for (input, options, code, told) in [
        ("bad.xyz", &["--ratio", "2"][..], 1, "line 2"),
        ("in.xyz", &["--points", "5"], 1, "points"),
        ("none.xyz", &[], 1, "none.xyz"),
        ("in.xyz", &["--attributes", "red:mean"], 64, "red"),
        ("in.xyz", &["--overlap", "3"], 64, "--overlap"),
        ("in.xyz", &["--no-polish"], 64, "--no-polish"),
        ("in.xyz", &["--model", "elsewhere"], 64, "--model"),
        ("in.xyz", &["--threads", "2"], 64, "--threads"),
    ] {
        let failed = run(&[&["upsample", &path(input), &path("gone.xyz")], options, &server[..]].concat());
        let stderr = String::from_utf8_lossy(&failed.stderr);
        assert_eq!(failed.status.code(), Some(code), "{options:?} {stderr}");
        assert!(stderr.contains(told), "{stderr}");
        assert!(!folder.path().join("gone.xyz").exists());
    }
    for url in ["https://host", "host:8080", "http://"] {
        let failed = run(&["upsample", &path("in.xyz"), "-", "--server", url]);
        assert_eq!(failed.status.code(), Some(64), "{failed:?}");
    }
}

#[test]
fn a_server_that_is_full_is_asked_again_and_given_the_key() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(300)).expect("a file");
    let upsample = |url: &str, output: &str| {
        let mut command = densecloud();
        command.args(["upsample", &path("in.xyz"), &path(output), "--server", url]);
        command.env("DENSECLOUD_KEY", "opensesame").output().expect("an end")
    };
    let done = "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-type: text/plain; charset=utf-8\r\n\
                content-length: 6\r\n\r\n1 2 3\n";
    let (url, requests) = canned(vec![
        refusal("503 Service Unavailable", "queue-full", "retry-after: 1\r\n"),
        refusal("429 Too Many Requests", "client-queue-full", "retry-after: 1\r\n"),
        done.to_owned(),
    ]);
    let output = upsample(&url, "out.xyz");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    assert!(stderr.contains("told so; trying again in 1 s (2 of 4)"), "{stderr}");
    assert_eq!(std::fs::read(path("out.xyz")).expect("a file"), b"1 2 3\n");
    for request in requests {
        let request = request.to_ascii_lowercase();
        assert!(request.starts_with("post /upsample?ratio=4&seed=0 "), "{request}");
        assert!(request.contains("authorization: bearer opensesame\r\n"), "{request}");
    }
    // Not for longer than a person would, not where there is no time to wait, and not what will not pass.
    for (status, kind, retry_after) in [
        ("503 Service Unavailable", "queue-full", "retry-after: 3600\r\n"),
        ("503 Service Unavailable", "queue-full", ""),
        ("413 Payload Too Large", "body-too-large", "retry-after: 1\r\n"),
    ] {
        let (url, _requests) = canned(vec![refusal(status, kind, retry_after)]);
        let output = upsample(&url, "none.xyz");
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        assert!(String::from_utf8_lossy(&output.stderr).contains("told so"), "{output:?}");
    }
    // An answer that breaks off is no result.
    let (url, _requests) = canned(vec![done.replace("content-length: 6", "content-length: 60")]);
    let output = upsample(&url, "none.xyz");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(!folder.path().join("none.xyz").exists() && !folder.path().join("none.xyz.part").exists());
}
