//! Behind a proxy: links, events, and names of files.

use densecloud_server::{Access, Config};
use serde_json::Value;

use crate::support::{PLY, Reply, Scripted, Server, cloud, encode, wait_until};

fn json(reply: &Reply) -> Value {
    serde_json::from_slice(&reply.body).unwrap_or_else(|e| panic!("{e}: {}", reply.text()))
}

fn config(folder: &tempfile::TempDir) -> Config {
    Config { jobs: Some(densecloud_jobs::Settings::new(folder.path().to_owned())), ..Config::default() }
}

/// Every link that the server gives, for a job that is done.
fn links(server: &Server, at: &str, headers: &str) -> Vec<String> {
    let ask =
        |method: &str, path: &str, body: &[u8]| server.ask(method, &format!("{at}{path}"), headers, body);
    let body = encode(&cloud(60), PLY);
    let submitted = ask("POST", "/jobs?ratio=2", &body);
    let id = json(&submitted)["id"].as_str().expect("an id").to_owned();
    let job = format!("/jobs/{id}");
    wait_until("it is done", || json(&ask("GET", &job, b""))["state"] == "done");
    ask("POST", "/jobs?ratio=2", &body);
    let page = json(&ask("GET", "/jobs?limit=1", b""));
    let events = ask("GET", &format!("{job}/events"), b"").text();
    let last = events.lines().rfind(|line| line.starts_with("data: ")).expect("an event");
    let last: Value = serde_json::from_str(&last["data: ".len()..]).expect("JSON");
    let next = page["next"].as_str().expect("a page").split('?').next().expect("a path").to_owned();
    let all = [
        submitted.header("location").expect("a location").replace(&id, "ID"),
        json(&ask("GET", &job, b""))["result"]["url"].as_str().expect("a link").replace(&id, "ID"),
        last["result"]["url"].as_str().expect("a link").replace(&id, "ID"),
        next,
        json(&ask("GET", "/openapi.json", b""))["servers"][0]["url"].as_str().expect("a path").to_owned(),
    ];
    all.to_vec()
}

/// The same, as they should be.
fn expected(prefix: &str) -> Vec<String> {
    let root = if prefix.is_empty() { "/" } else { prefix };
    let job = format!("{prefix}/jobs/ID");
    vec![
        job.clone(),
        format!("{job}/result"),
        format!("{job}/result"),
        format!("{prefix}/jobs"),
        root.to_owned(),
    ]
}

#[test]
fn links_begin_with_the_base_path_and_requests_may() {
    let folder = tempfile::tempdir().expect("a folder");
    let base_path = "/clouds/v1".parse().expect("a path");
    let server = Server::start(&Scripted::new(), Config { base_path, ..config(&folder) });
    for at in ["", "/clouds/v1"] {
        assert_eq!(links(&server, at, ""), expected("/clouds/v1"), "{at}");
        assert_eq!(server.get(&format!("{at}/readyz")).status, 200);
        assert_eq!(server.get(&format!("{at}/v2/health/ready")).status, 200);
    }
    assert_eq!(server.get("/clouds/readyz").status, 404);
    // Nobody is trusted.
    assert_eq!(links(&server, "", "x-forwarded-prefix: /forged\r\n"), expected("/clouds/v1"));
}

#[test]
fn a_trusted_proxys_prefix_is_taken() {
    let folder = tempfile::tempdir().expect("a folder");
    let access = Access { trust_forwarded: true, ..Access::default() };
    let server = Server::start(&Scripted::new(), Config { access, ..config(&folder) });
    for (headers, prefix) in [
        ("", ""),
        ("x-forwarded-prefix: /x\r\n", "/x"),
        ("x-forwarded-prefix: /forged\r\nx-forwarded-prefix: /x/y/\r\n", "/x/y"),
        ("x-forwarded-prefix: //example.org\r\n", ""),
        ("x-forwarded-prefix: https://example.org/\r\n", ""),
    ] {
        assert_eq!(links(&server, "", headers), expected(prefix), "{headers:?}");
    }
}

#[test]
fn the_first_event_comes_at_once_and_is_not_to_be_held_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let backend = Scripted::new();
    let server = Server::start(&backend, config(&folder));
    backend.shut();
    let body = encode(&cloud(300), PLY);
    server.post("/jobs?ratio=4", &body);
    let queued = server.post("/jobs?ratio=4", &body);
    let path = queued.header("location").expect("a location").to_owned();
    // Nothing changes: the one before it does not end.
    let mut client = server.begin("GET", &format!("{path}/events"), "", b"");
    let mut text = String::new();
    while !text.contains("\"state\":\"queued\"") {
        text += &String::from_utf8(client.some()).expect("text");
    }
    let (head, _) = text.split_once("\r\n\r\n").expect("a head");
    for line in [
        "HTTP/1.1 200 OK",
        "content-type: text/event-stream",
        "cache-control: no-store",
        "x-accel-buffering: no",
    ] {
        assert!(head.lines().any(|found| found == line), "{line}: {head}");
    }
    backend.open();
}

#[test]
fn a_result_says_under_which_name_it_is_saved() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(&Scripted::new(), config(&folder));
    let body = encode(&cloud(60), PLY);
    let form = |target: &str, name: &str, accept: &str| {
        let part = format!("--b\r\ncontent-disposition: form-data; name=\"cloud\"{name}\r\n\r\n");
        let form = [part.as_bytes(), &body, b"\r\n--b--\r\n"].concat();
        server.ask(
            "POST",
            target,
            &format!("content-type: multipart/form-data; boundary=b\r\n{accept}"),
            &form,
        )
    };
    let saved = |reply: &Reply| reply.header("content-disposition").map(str::to_owned);
    let csv = "accept: text/csv\r\n";
    for (name, accept, expected) in [
        ("", "", "attachment; filename=\"dense.ply\""),
        ("; filename=\"my scan.v2.ply\"", "", "attachment; filename=\"my scan.v2-dense.ply\""),
        ("; filename=\"..\\\\up/scan.ply\"", csv, "attachment; filename=\"scan-dense.csv\""),
        (
            "; filename=\"Häuser.ply\"",
            csv,
            "attachment; filename=\"H_user-dense.csv\"; filename*=UTF-8''H%C3%A4user-dense.csv",
        ),
    ] {
        let live = form("/upsample?ratio=2", name, accept);
        assert_eq!((live.status, saved(&live).as_deref()), (200, Some(expected)));
        let kept = form("/jobs?ratio=2", name, accept);
        let path = format!("{}/result", kept.header("location").expect("a location"));
        wait_until("it is done", || server.get(&path).status == 200);
        assert_eq!(saved(&server.get(&path)).as_deref(), Some(expected));
        let part = server.ask("GET", &path, "range: bytes=0-9\r\n", b"");
        assert_eq!((part.status, saved(&part).as_deref()), (206, Some(expected)));
    }
    // What has only this is a file, too, whatever its field is called.
    let part = "--b\r\ncontent-disposition: form-data; name=\"scan\"; filename*=utf-8''%E7%82%B9.ply\r\n\r\n";
    let whole = [part.as_bytes(), &body, b"\r\n--b--\r\n"].concat();
    let kind = "content-type: multipart/form-data; boundary=b\r\n";
    let reply = server.ask("POST", "/upsample?ratio=2", kind, &whole);
    let name = "attachment; filename=\"_-dense.ply\"; filename*=UTF-8''%E7%82%B9-dense.ply";
    assert_eq!((reply.status, saved(&reply).as_deref()), (200, Some(name)));
    // As a browser sends a form in which no file was chosen.
    let none = b"--b\r\ncontent-disposition: form-data; name=\"cloud\"; filename=\"\"\r\n\r\n\r\n--b--\r\n";
    let reply = server.ask("POST", "/upsample?ratio=2", kind, none);
    assert!(reply.status == 400 && reply.text().contains("the form needs a file"), "{}", reply.text());
    let plain = server.post("/upsample?ratio=2", &body);
    assert_eq!(saved(&plain).as_deref(), Some("attachment; filename=\"dense.ply\""));
}
