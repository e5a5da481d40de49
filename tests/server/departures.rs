//! Clients that leave, at every stage of every kind of request: what they were given is given back.

use std::io::Write;
use std::net::TcpStream;
use std::time::Duration;

use densecloud_cascade::Fake;
use densecloud_server::Config;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use serde_json::json;

use crate::support::{Client, PLY, Scripted, Server, cloud, encode, wait_until};

/// What a client asks for.
#[derive(Debug, Clone, Copy)]
enum Asks {
    Upsample,
    Gzip,
    Infer,
    Job,
    Events,
    Result,
}

/// When it leaves.
#[derive(Debug, Clone, Copy)]
enum Leaves {
    /// When this share of its request has been sent.
    Sending(f64),
    /// When all of it has been, and so many milliseconds have passed.
    Waiting(u64),
    /// When it has read something of the answer.
    Reading,
    /// When it has read all of it.
    Answered,
}

fn departures() -> impl Strategy<Value = Vec<(Asks, Leaves)>> {
    let asks = prop::sample::select(vec![
        Asks::Upsample,
        Asks::Upsample,
        Asks::Gzip,
        Asks::Infer,
        Asks::Job,
        Asks::Events,
        Asks::Result,
    ]);
    let leaves = prop_oneof![
        (0.0..1.0).prop_map(Leaves::Sending),
        (0_u64..60).prop_map(Leaves::Waiting),
        Just(Leaves::Reading),
        Just(Leaves::Answered),
    ];
    prop::collection::vec((asks, leaves), 1..6)
}

/// The bytes of a request; `job` is one that is done.
fn request(asks: Asks, job: &str) -> Vec<u8> {
    let body = encode(&cloud(400), PLY);
    let post = |target: &str, headers: &str, body: &[u8]| {
        let length = body.len();
        let head = format!(
            "POST {target} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{headers}content-length: {length}\r\n\r\n"
        );
        [head.as_bytes(), body].concat()
    };
    let get =
        |target: &str| format!("GET {target} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").into_bytes();
    match asks {
        Asks::Upsample => post("/upsample?ratio=16", "", &body),
        Asks::Gzip => {
            let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            encoder.write_all(&body).unwrap();
            post("/upsample?ratio=16", "content-encoding: gzip\r\n", &encoder.finish().unwrap())
        }
        Asks::Infer => {
            let points: Vec<f64> = cloud(400).into_flattened();
            let input = json!({ "name": "points", "datatype": "FP32", "shape": [400, 3], "data": points });
            let json = json!({ "parameters": { "ratio": 16 }, "inputs": [input] }).to_string();
            post("/v2/models/densecloud/infer", "", json.as_bytes())
        }
        Asks::Job => post("/jobs?ratio=4", "", &body),
        Asks::Events => get(&format!("{job}/events")),
        Asks::Result => get(&format!("{job}/result")),
    }
}

fn depart(mut client: Client, asks: Asks, leaves: Leaves, job: &str) {
    let bytes = request(asks, job);
    if let Leaves::Sending(share) = leaves {
        client.send(&bytes[..(share * bytes.len() as f64) as usize]);
        return;
    }
    client.send(&bytes);
    match leaves {
        Leaves::Sending(_) => {}
        Leaves::Waiting(milliseconds) => std::thread::sleep(Duration::from_millis(milliseconds)),
        Leaves::Reading => {
            client.some();
        }
        Leaves::Answered => {
            client.rest();
        }
    }
}

#[test]
fn whoever_leaves_at_whatever_stage_gives_back_what_it_was_given() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut config =
        Config { jobs: Some(densecloud_jobs::Settings::new(folder.path().to_owned())), ..Config::default() };
    // So few that a place that is not given back is soon missed.
    config.limits.connections = 8;
    // 16x of 400 points is some hundred batches, and so takes longer than the clients wait.
    let server = Server::start(&Scripted::over(Fake::slow(Duration::from_millis(1))), config);
    let reply = server.post("/jobs?ratio=4", &encode(&cloud(400), PLY));
    let job = reply.header("location").expect("a location").to_owned();
    wait_until("there is a result", || server.get(&format!("{job}/result")).status == 200);
    let count = |line: &str| server.metric(line) == 0.0;
    let proptest = ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() };
    let tested = TestRunner::new(proptest).run(&departures(), |departures| {
        std::thread::scope(|scope| {
            for (asks, leaves) in departures {
                let (client, job) = (server.connect(), &job);
                scope.spawn(move || depart(client, asks, leaves, job));
            }
        });
        wait_until("all is given back", || {
            server.engine.queued_points() == 0
                && count("densecloud_held_bytes")
                && count("densecloud_requests_in_flight")
                && count("densecloud_jobs{state=\"queued\"}")
                && count("densecloud_jobs{state=\"running\"}")
        });
        Ok(())
    });
    tested.expect("all is given back");
    // Every connection's place is free again.
    let all: Vec<TcpStream> = (0..8).map(|_| TcpStream::connect(server.address).unwrap()).collect();
    for stream in all {
        let mut client = Client::of(stream);
        client.send_post("/upsample?ratio=2", &encode(&cloud(100), PLY));
        assert_eq!(client.reply().status, 200);
    }
}

#[test]
fn a_request_that_is_reset_on_http2_stops_and_its_connection_goes_on() {
    use http_body_util::{BodyExt, Full};
    use hyper::Request;
    use hyper::body::Bytes;
    use hyper_util::rt::{TokioExecutor, TokioIo};
    use tokio::task::block_in_place;

    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    backend.shut();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let request = || {
        let body = Full::new(Bytes::from(encode(&cloud(300), PLY)));
        Request::post(format!("http://{}/upsample?ratio=4", server.address)).body(body).unwrap()
    };
    runtime.block_on(async {
        let stream = tokio::net::TcpStream::connect(server.address).await.unwrap();
        let (mut sender, connection) =
            hyper::client::conn::http2::handshake(TokioExecutor::new(), TokioIo::new(stream)).await.unwrap();
        tokio::spawn(connection);
        let waiting = tokio::spawn(sender.send_request(request()));
        block_in_place(|| server.wait_for_work());
        waiting.abort();
        // Counted until the work has stopped, which the gate holds up.
        block_in_place(|| {
            wait_until("it is cancelled", || server.metric("densecloud_requests_in_flight") == 0.0);
            backend.open();
            server.wait_for_no_work();
            wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
        });
        let answer = sender.send_request(request()).await.unwrap();
        assert_eq!(answer.status(), 200);
        assert_eq!(answer.headers()["densecloud-points-out"], "1200");
        let length: usize = answer.headers()["content-length"].to_str().unwrap().parse().unwrap();
        assert_eq!(answer.into_body().collect().await.unwrap().to_bytes().len(), length);
    });
}
