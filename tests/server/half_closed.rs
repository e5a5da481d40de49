//! Clients that close their sending side after a whole request: served, unless they are gone.

use densecloud_cascade::{Fake, Target};
use densecloud_server::Config;
use std::time::Duration;

use crate::support::{Client, PLY, Reply, Scripted, Server, cloud, dense, encode, encode_result, wait_until};

/// A request with its body, and the end of all sending.
fn ask(server: &Server, head: &str, body: &[u8]) -> Client {
    let mut client = server.connect();
    client.send(head.as_bytes());
    client.send(body);
    client.close_sending();
    client
}

fn upsample(version: &str, body: &[u8]) -> String {
    format!("POST /upsample?ratio=4 HTTP/{version}\r\nhost: x\r\ncontent-length: {}\r\n\r\n", body.len())
}

#[test]
fn a_client_that_sends_no_more_gets_its_whole_answer_and_nothing_else() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    let body = encode(&cloud(300), PLY);
    let expected = dense(cloud(300), Target::Ratio(4.0), 0);
    for version in ["1.1", "1.0"] {
        backend.shut();
        let mut client = ask(&server, &upsample(version, &body), &body);
        server.wait_for_work();
        // Meanwhile it is asked whether it is still there, with the first byte of its answer.
        let first = client.some();
        assert!(!first.is_empty() && b"HTTP/1.".starts_with(&first), "{first:?}");
        backend.open();
        let whole = [first, client.rest()].concat();
        assert!(whole.starts_with(format!("HTTP/{version} 200 OK\r\n").as_bytes()));
        let reply = Reply::parse(&whole).expect("a whole response");
        assert!(reply.body == encode_result(&expected, PLY, &reply), "{}", reply.status);
    }
    assert_eq!(server.metric("densecloud_requests_total{interface=\"http\",outcome=\"cancelled\"}"), 0.0);
}

#[test]
fn requests_that_came_together_are_all_answered() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(100), PLY);
    let post = [upsample("1.1", &body).as_bytes(), &body].concat();
    let get = b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n";
    let mut client = ask(&server, "", &[&get[..], &post, get].concat());
    let text = String::from_utf8_lossy(&client.rest()).into_owned();
    assert_eq!(text.matches("HTTP/1.1 200 OK\r\n").count(), 3, "{text}");
}

#[test]
fn a_request_that_is_not_whole_is_refused() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(100), PLY);
    let mut client = ask(&server, &upsample("1.1", &body), &body[..500]);
    let reply = Reply::parse(&client.rest()).expect("an answer");
    assert_eq!((reply.status, reply.problem_name().as_str()), (400, "interrupted-body"));
    assert!(ask(&server, "GET /healthz HTTP/1.1\r\nhost", b"").rest().is_empty());
}

#[test]
fn a_client_that_sends_no_more_and_leaves_stops_the_work() {
    let backend = Scripted::over(Fake::slow(Duration::from_millis(20)));
    let server = Server::start(&backend, Config::default());
    let body = encode(&cloud(1000), PLY);
    let head =
        format!("POST /upsample?ratio=16 HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n", body.len());
    let before = backend.batches();
    let mut client = ask(&server, &head, &body);
    // It has shown that it was there, and goes then.
    client.some();
    wait_until("it is being worked on", || backend.batches() > before);
    drop(client);
    server.wait_for_no_work();
    let cancelled = "densecloud_requests_total{interface=\"http\",outcome=\"cancelled\"}";
    wait_until("it is counted", || server.metric(cancelled) == 1.0);
}

#[test]
fn events_go_on_to_a_client_that_sends_no_more_and_end_with_one_that_is_gone() {
    let folder = tempfile::tempdir().expect("a folder");
    let jobs = Some(densecloud_jobs::Settings::new(folder.path().to_owned()));
    let backend = Scripted::new();
    let server = Server::start(&backend, Config { jobs, ..Config::default() });
    backend.shut();
    let reply = server.post("/jobs?ratio=4", &encode(&cloud(300), PLY));
    let job = reply.header("location").expect("a location").to_owned();
    let watch = || ask(&server, &format!("GET {job}/events HTTP/1.1\r\nhost: x\r\n\r\n"), b"");
    let (mut stays, mut leaves) = (watch(), watch());
    for client in [&mut stays, &mut leaves] {
        let mut start = Vec::new();
        // The first byte may have come before the rest.
        while start.len() < 12 {
            start.extend(client.some());
        }
        assert!(start.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&start));
    }
    drop(leaves);
    wait_until("one is left", || server.metric("densecloud_requests_in_flight") == 1.0);
    backend.open();
    let rest = String::from_utf8(stays.rest()).expect("text");
    assert!(rest.contains("event: done\n") && rest.ends_with("\r\n0\r\n\r\n"), "{rest}");
}
