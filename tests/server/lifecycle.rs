//! From warm-up to the last byte.

use std::time::Duration;

use densecloud_cascade::Target;
use densecloud_engine::EngineConfig;
use densecloud_formats::Format;
use densecloud_server::{Config, ServeError};

use crate::support::{PLY, Reply, Scripted, Server, cloud, dense, encode, encode_result, narrow, wait_until};

#[test]
fn a_server_is_alive_at_once_and_ready_after_its_warm_up() {
    let backend = Scripted::new();
    backend.shut();
    let server = Server::start_cold(&backend, EngineConfig::default(), Config::default());
    assert_eq!(server.get("/healthz").status, 200);
    let reply = server.get("/readyz");
    assert_eq!((reply.status, reply.problem_name().as_str()), (503, "warming-up"));
    let reply = server.post("/upsample?ratio=4", &encode(&cloud(100), PLY));
    assert_eq!((reply.status, reply.problem_name().as_str()), (503, "warming-up"));
    backend.open();
    server.wait_for_ready();
    assert_eq!(server.get("/readyz").text(), "ready\n");
    assert_eq!(server.post("/upsample?ratio=4", &encode(&cloud(100), PLY)).status, 200);
}

#[test]
fn a_model_that_does_not_run_ends_the_server() {
    let backend = Scripted::new();
    backend.fail();
    let mut server = Server::start_cold(&backend, EngineConfig::default(), Config::default());
    assert!(matches!(server.join(), Err(ServeError::WarmUp(_))));
}

#[test]
fn settings_that_cannot_work_are_refused_at_the_start() {
    let mut config = Config::default();
    config.limits.held_bytes = 1;
    let mut server = Server::start_cold(&Scripted::new(), EngineConfig::default(), config);
    assert!(matches!(server.join(), Err(ServeError::Config(_))));
}

#[test]
fn a_stopping_server_says_so_finishes_what_it_has_and_ends() {
    let backend = Scripted::new();
    let mut server = Server::start(&backend, Config::default());
    backend.shut();
    let body = encode(&cloud(100), PLY);
    let mut client = server.connect();
    client.send_post("/upsample?ratio=4", &body);
    server.wait_for_work();
    server.stop();
    wait_until("readiness flips", || server.get("/readyz").status == 503);
    assert_eq!(server.get("/readyz").problem_name(), "draining");
    assert_eq!(server.get("/healthz").status, 200, "probes are answered to the end");
    let refused = server.post("/upsample?ratio=4", &body);
    assert_eq!((refused.status, refused.problem_name().as_str()), (503, "draining"));
    backend.open();
    let reply = client.reply();
    let expected = dense(cloud(100), Target::Ratio(4.0), 0);
    assert!(reply.body == encode_result(&expected, PLY, &reply), "{}", reply.status);
    assert!(server.join().is_ok());
    assert!(std::net::TcpStream::connect(server.address).is_err(), "the port is free");
}

#[test]
fn a_leaving_server_says_so_first_and_refuses_later() {
    let backend = Scripted::new();
    let mut config = Config::default();
    config.timeouts.lead = Duration::from_millis(500);
    let mut server = Server::start(&backend, config);
    backend.shut();
    let body = encode(&cloud(100), PLY);
    let mut client = server.connect();
    client.send_post("/upsample?ratio=4", &body);
    server.wait_for_work();
    server.stop();
    wait_until("readiness flips", || server.get("/readyz").status == 503);
    assert_eq!(server.get("/v2/health/ready").status, 503);
    // Told before anything else, so it shows whether work is taken, and takes none.
    let refused = || server.post("/upsample?ratio=99", &body);
    wait_until("work is refused", || refused().status == 503);
    assert_eq!(refused().problem_name(), "draining");
    backend.open();
    assert_eq!(client.reply().status, 200);
    assert!(server.join().is_ok());
}

#[test]
fn a_response_that_is_being_sent_is_sent_whole() {
    let mut server = Server::start(&Scripted::new(), Config::default());
    let mut client = server.connect();
    client.send_post("/upsample?ratio=64", &encode(&cloud(1000), densecloud_formats::Format::TEXT));
    let start = client.some();
    assert!(start.starts_with(b"HTTP/1.1 200"));
    server.stop();
    // The server may already be gone when all of it fitted into the system's buffers.
    wait_until("readiness flips", || !server.is_ready());
    let whole = [start, client.rest()].concat();
    assert_eq!(Reply::parse(&whole).expect("a whole response").text().lines().count(), 64_000);
    assert!(server.join().is_ok());
}

#[test]
fn every_request_that_was_accepted_is_answered_whole_however_old_it_is() {
    let backend = Scripted::new();
    let mut server = Server::start(&backend, Config::default());
    let (small, text) = (encode(&cloud(300), PLY), encode(&cloud(2000), Format::TEXT));
    // Being sent: more than the system buffers, to clients that read nothing more for now.
    let reading: Vec<_> = (0..2)
        .map(|_| {
            let mut client = narrow(&server);
            client.send_post("/upsample?ratio=64", &text);
            let start = client.some();
            assert!(start.starts_with(b"HTTP/1.1 200"));
            (client, start)
        })
        .collect();
    // Worked on or queued: there are two workers, and the gate is shut.
    backend.shut();
    let mut queued: Vec<_> = (0..5).map(|_| server.connect()).collect();
    for client in &mut queued {
        client.send_post("/upsample?ratio=4", &small);
    }
    // Being received: the head and half of the body.
    let mut uploading: Vec<_> = (0..2).map(|_| server.connect()).collect();
    for client in &mut uploading {
        let head = format!(
            "POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {}\r\n\r\n",
            small.len()
        );
        client.send(head.as_bytes());
        client.send(&small[..small.len() / 2]);
    }
    // Points of uploads are reserved with their headers.
    wait_until("all are accepted", || {
        server.engine.queued_points() == 7 * 1200 && server.metric("densecloud_requests_in_flight") == 9.0
    });
    server.stop();
    wait_until("readiness flips", || server.get("/readyz").status == 503);
    let refused = server.post("/upsample?ratio=4", &small);
    assert_eq!((refused.status, refused.problem_name().as_str()), (503, "draining"));
    backend.open();
    for client in &mut uploading {
        client.send(&small[small.len() / 2..]);
    }
    let expected = dense(cloud(300), Target::Ratio(4.0), 0);
    for client in queued.into_iter().chain(uploading) {
        let reply = client.reply();
        assert_eq!(reply.status, 200);
        assert!(reply.body == encode_result(&expected, PLY, &reply));
    }
    for (mut client, start) in reading {
        let whole = [start, client.rest()].concat();
        assert_eq!(Reply::parse(&whole).expect("a whole response").text().lines().count(), 128_000);
    }
    assert!(server.join().is_ok());
}

#[test]
fn what_is_not_done_by_the_deadline_is_cancelled() {
    let backend = Scripted::new();
    let mut config = Config::default();
    config.timeouts.drain = Duration::from_millis(100);
    let mut server = Server::start(&backend, config);
    backend.shut();
    let mut client = server.connect();
    client.send_post("/upsample?ratio=4", &encode(&cloud(100), PLY));
    let mut half = server.connect();
    half.send(b"POST /upsample?ratio=4 HTTP/1.1\r\n");
    server.wait_for_work();
    server.stop();
    assert!(server.join().is_ok(), "and that is no failure");
    assert_eq!(Reply::parse(&client.rest()), None);
    half.rest();
    backend.open();
    server.wait_for_no_work();
}

#[test]
fn an_idle_server_stops_at_once_whatever_connections_are_open() {
    let mut config = Config::default();
    // So long that waiting for it would run into the test's own limit.
    config.timeouts.head = Duration::from_secs(600);
    config.timeouts.drain = Duration::from_secs(600);
    let mut server = Server::start(&Scripted::new(), config);
    let idle = server.connect();
    let mut kept = server.connect();
    kept.send(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n");
    assert!(kept.some().starts_with(b"HTTP/1.1 200"));
    server.stop();
    assert!(server.join().is_ok());
    drop((idle, kept));
}
