//! `densecloud upsample --server` and `densecloud job`, with servers of ours and with what is none.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};

use crate::support::{Serving, densecloud, run, sphere, wide_sphere, within};

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

/// A result.
const DONE: &str = "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-type: text/plain; charset=utf-8\r\n\
                    densecloud-points-out: 1\r\ncontent-length: 6\r\n\r\n1 2 3\n";

fn answer(status: &str, headers: &str, body: &str) -> String {
    let length = body.len();
    format!("HTTP/1.1 {status}\r\nconnection: close\r\n{headers}content-length: {length}\r\n\r\n{body}")
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
    let cascade =
        ["--overlap", "3", "--inner", "1", "--max-displacement", "inf", "--max-distance", "2", "--no-polish"];
    let all = ["--keep-input", "--source-fields", "--normals", "estimate", "--sensor", "500000,-0.5,9"];
    for (ending, options) in [
        ("xyz", &["--ratio", "2.5", "--seed", "5"][..]),
        ("ply", &[]),
        ("laz", &["--points", "500"]),
        ("csv", &["--spacing", "0.08", "--quiet"]),
        // Without an ending, the input's format.
        ("", &["--density", "40"]),
        ("e57", &all),
        ("pcd", &cascade),
        ("npy", &["--attributes", "nx:drop"]),
    ] {
        // The last has attributes to drop.
        let input = if ending == "npy" { path("in.ply") } else { path("in.xyz") };
        if ending == "npy" {
            let made = run(&["upsample", &path("in.xyz"), &input, "--ratio", "1", "--normals", "estimate"]);
            assert!(made.status.success(), "{made:?}");
        }
        let named = |name: &str| if ending.is_empty() { name.to_owned() } else { format!("{name}.{ending}") };
        let (here, there) = (named("here"), named("there"));
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
        ("none.xyz", &[], 1, "none.xyz"),
        ("in.xyz", &["--attributes", "red:mean"], 64, "red"),
        ("in.xyz", &["--overlap", "0"], 64, "--overlap"),
        ("in.xyz", &["--model", "elsewhere"], 64, "--model"),
        ("in.xyz", &["--threads", "2"], 64, "--threads"),
    ] {
        let failed = run(&[&["upsample", &path(input), &path("gone.xyz")], options, &server[..]].concat());
        let stderr = String::from_utf8_lossy(&failed.stderr);
        assert_eq!(failed.status.code(), Some(code), "{options:?} {stderr}");
        assert!(stderr.contains(told), "{stderr}");
        assert!(!folder.path().join("gone.xyz").exists());
    }
    // The same here and there.
    for (options, code, told) in [
        (&["--points", "5"][..], 1, "points"),
        (&["--points", "0"], 64, "points"),
        (&["--ratio", "65"], 64, "65"),
        (&["--spacing", "1e9"], 1, "spacing"),
        (&["--spacing", "0"], 64, "spacing"),
        (&["--density", "1e12"], 1, "density"),
        (&["--density", "nan"], 64, "density"),
        (&["--normals", "estimate", "--sensor", "nan,0,0"], 64, "--sensor"),
        (&["--normals", "estimate", "--sensor", "0,-inf,0"], 64, "--sensor"),
        (&["--attributes", "red:mean"], 64, "red"),
    ] {
        for place in [&[][..], &server] {
            let failed = run(&[&["upsample", &path("in.xyz"), &path("gone.xyz")], options, place].concat());
            let stderr = String::from_utf8_lossy(&failed.stderr);
            assert_eq!(failed.status.code(), Some(code), "{options:?} {place:?} {stderr}");
            assert!(stderr.contains(told), "{stderr}");
        }
    }
    for url in ["https://host", "host:8080", "http://", "http://a b"] {
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
    let (url, requests) = canned(vec![
        refusal("503 Service Unavailable", "queue-full", "retry-after: 1\r\n"),
        refusal("429 Too Many Requests", "client-queue-full", "retry-after: 1\r\n"),
        DONE.to_owned(),
    ]);
    let output = upsample(&url, "out.xyz");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    assert!(stderr.contains("told so; trying again in 1 s (2 of 4)"), "{stderr}");
    assert_eq!(std::fs::read(path("out.xyz")).expect("a file"), b"1 2 3\n");
    for request in requests {
        let request = request.to_ascii_lowercase();
        assert!(request.starts_with("post /upsample?ratio=4 "), "{request}");
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
    let (url, _requests) = canned(vec![DONE.replace("content-length: 6", "content-length: 60")]);
    let output = upsample(&url, "none.xyz");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(!folder.path().join("none.xyz").exists() && !folder.path().join("none.xyz.part").exists());
}

#[test]
fn what_no_server_of_ours_would_answer_is_neither_a_result_nor_a_success() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(300)).expect("a file");
    let (input, output) = (path("in.xyz"), path("out.xyz"));
    let page = answer("200 OK", "content-type: text/html\r\n", "<form>log in</form>");
    let moved = answer("302 Found", "location: http://login.example/form\r\n", "");
    let nothing = "HTTP/1.1 204 No Content\r\nconnection: close\r\n\r\n".to_owned();
    let text = answer("200 OK", "content-type: text/plain\r\n", "1 2 3\n");
    let other = answer("200 OK", "content-type: application/json\r\n", "{\"other\":1}");
    let broken = answer("200 OK", "content-type: application/json\r\n", "{");
    for (arguments, answers) in [
        (&["upsample", &input, &output][..], &[&page, &moved, &nothing, &text, &other][..]),
        (&["job", "get", "1", &output], &[&page, &moved, &nothing, &text, &other]),
        (&["job", "submit", &input, "--ratio", "2"], &[&page, &moved, &nothing, &text, &other, &broken]),
        (&["job", "list"], &[&page, &moved, &nothing, &text, &other, &broken]),
        (&["job", "watch", "1"], &[&page, &moved, &nothing, &text, &other]),
        (&["job", "cancel", "1"], &[&page, &moved, &text]),
    ] {
        for &one in answers {
            let (url, requests) = canned(vec![one.clone()]);
            let failed = run(&[arguments, &["--server", &url]].concat());
            let stderr = String::from_utf8_lossy(&failed.stderr);
            assert_eq!(failed.status.code(), Some(1), "{arguments:?} {one} {stderr}");
            assert!(failed.stdout.is_empty(), "{arguments:?} {one} {failed:?}");
            assert!(stderr.contains(&url), "{stderr}");
            if one == &moved {
                assert!(stderr.contains("http://login.example/form"), "{stderr}");
            }
            assert_eq!(requests.iter().count(), 1);
            assert!(!folder.path().join("out.xyz").exists(), "{arguments:?} {one}");
        }
    }
    let (url, _requests) = canned(vec![nothing]);
    assert!(run(&["job", "cancel", "1", "--server", &url]).status.success());
}

#[test]
fn a_server_that_ends_an_upload_early_is_heard_and_asked_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    // More than the system holds of what a server does not read.
    std::fs::write(path("in.ply"), wide_sphere(20_000, 100)).expect("a file");
    let upsample = |url: &str| run(&["upsample", &path("in.ply"), &path("out.xyz"), "--server", url]);
    let serving = Serving::start(&["--max-points-in", "50"]);
    let refused = upsample(&serving.url(""));
    let stderr = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("--max-points-in"), "{stderr}");
    // One that goes away without a word, and comes back full, then less so.
    let full = refusal("503 Service Unavailable", "queue-full", "retry-after: 1\r\n");
    let (url, _requests) = canned(vec![begun(""), begun(&full), begun(DONE)]);
    let served = upsample(&url);
    let stderr = String::from_utf8_lossy(&served.stderr);
    assert!(served.status.success(), "{stderr}");
    assert!(stderr.contains("ended the upload early"), "{stderr}");
    assert!(stderr.contains("told so (request r-1); trying again in 1 s (2 of 4)"), "{stderr}");
    // A pipe that never ends does not keep the refusal back.
    let mut endless = Command::new("yes").arg("1 2 3").stdout(Stdio::piped()).spawn().expect("yes starts");
    let (url, _requests) = canned(vec![begun(&full)]);
    let mut piped = densecloud();
    piped.args(["upsample", "-", "-", "--server", &url]).stdin(endless.stdout.take().expect("piped"));
    let refused = piped.output().expect("an end");
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    assert!(String::from_utf8_lossy(&refused.stderr).contains("told so"), "{refused:?}");
    // It holds the pipe's end.
    drop(piped);
    endless.wait().expect("its pipe is closed");
}

/// An answer of one that asked for the body first.
fn begun(answer: &str) -> String {
    format!("HTTP/1.1 100 Continue\r\n\r\n{answer}")
}

#[test]
fn watching_goes_on_when_the_server_comes_back_and_ends_when_the_job_is_gone() {
    let events = |states: &[&str]| {
        let event =
            |state: &&str| format!("event: progress\ndata: {{\"state\":\"{state}\",\"position\":0}}\n\n");
        let text: String = states.iter().map(event).collect();
        answer("200 OK", "content-type: text/event-stream\r\n", &text)
    };
    let draining = refusal("503 Service Unavailable", "draining", "retry-after: 5\r\n");
    let (url, requests) = canned(vec![events(&["queued"]), draining, events(&["queued", "done"])]);
    let watched = run(&["job", "watch", "1", "--server", &url]);
    assert!(watched.status.success() && watched.stdout == b"done\n", "{watched:?}");
    assert_eq!(requests.iter().count(), 3);
    for gone in [refusal("404 Not Found", "no-such-job", ""), refusal("501 Not Implemented", "jobs-off", "")]
    {
        let (url, requests) = canned(vec![events(&["queued"]), gone]);
        let watched = run(&["job", "watch", "1", "--server", &url]);
        assert_eq!(watched.status.code(), Some(1), "{watched:?}");
        assert!(String::from_utf8_lossy(&watched.stderr).contains("told so"), "{watched:?}");
        assert_eq!(requests.iter().count(), 2);
    }
}

#[test]
fn who_reads_no_further_is_no_failure_and_a_full_disk_is_one_of_this_machine() {
    let list = || {
        let job = "{\"id\":\"a1\",\"state\":\"done\",\"points_in\":1,\"points_out\":2}";
        answer("200 OK", "content-type: application/json\r\n", &format!("{{\"jobs\":[{job}]}}"))
    };
    let listed = |stdout: Stdio| {
        let (url, _requests) = canned(vec![list()]);
        densecloud().args(["job", "list", "--server", &url]).stdout(stdout).output().expect("an end")
    };
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let unread = listed(writer.into());
    assert!(unread.status.success() && unread.stderr.is_empty(), "{unread:?}");
    if cfg!(target_os = "linux") {
        let full = || Stdio::from(File::options().write(true).open("/dev/full").expect("a device"));
        let submitted = "{\"id\":\"a1\",\"state\":\"queued\"}";
        let (url, _requests) =
            canned(vec![answer("202 Accepted", "content-type: application/json\r\n", submitted)]);
        let mut submit = densecloud();
        submit.args(["job", "submit", "Cargo.toml", "--ratio", "2", "--server", &url]).stdout(full());
        let submitted = submit.output().expect("an end");
        assert!(String::from_utf8_lossy(&submitted.stderr).contains("the job is a1"), "{submitted:?}");
        let mut inspect = densecloud();
        inspect.args(["serve", "--print-config"]).stdout(full());
        for failed in [submitted, listed(full()), inspect.output().expect("an end")] {
            assert_eq!(failed.status.code(), Some(1), "{failed:?}");
            assert!(String::from_utf8_lossy(&failed.stderr).contains("No space left"), "{failed:?}");
        }
    }
    // A reader that leaves while a result is written to it: not the server's fault.
    let folder = tempfile::tempdir().expect("a folder");
    let pipe = within(&folder)("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo is there").success());
    let long = "1 2 3\n".repeat(1 << 20);
    let (url, _requests) =
        canned(vec![answer("200 OK", "content-type: text/plain\r\ndensecloud-points-out: 1\r\n", &long)]);
    let leaving = std::thread::spawn({
        let pipe = pipe.clone();
        move || File::open(pipe).and_then(|mut pipe| pipe.read_exact(&mut [0; 6])).expect("a line")
    });
    let got = run(&["job", "get", "1", &pipe, "--server", &url]);
    leaving.join().expect("no panic");
    let stderr = String::from_utf8_lossy(&got.stderr);
    assert_eq!(got.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains(&format!("{pipe}: Broken pipe")), "{stderr}");
}

#[test]
fn a_proxy_is_for_other_machines_and_is_named() {
    let list = |server: &str, excepted: &str| {
        let mut command = densecloud();
        for name in ["ALL_PROXY", "all_proxy", "HTTPS_PROXY", "https_proxy", "HTTP_PROXY", "NO_PROXY"] {
            command.env_remove(name);
        }
        // Nobody listens there.
        command.env("http_proxy", "http://me:secret@127.0.0.1:1").env("no_proxy", excepted);
        command.args(["job", "list", "--server", server]).output().expect("an end")
    };
    let (url, _requests) =
        canned(vec![answer("200 OK", "content-type: application/json\r\n", "{\"jobs\":[]}")]);
    let here = list(&url, "");
    assert!(here.status.success(), "{here:?}");
    for (excepted, named) in [("", true), ("elsewhere.invalid", false)] {
        let there = list("http://elsewhere.invalid:8080", excepted);
        let stderr = String::from_utf8_lossy(&there.stderr);
        assert_eq!(there.status.code(), Some(1), "{stderr}");
        assert_eq!(stderr.contains("the proxy 127.0.0.1:1"), named, "{stderr}");
        assert!(!stderr.contains("secret"), "{stderr}");
    }
}
