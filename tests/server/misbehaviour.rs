//! Clients that stall, leave, or never say what they want.

use std::time::Duration;

use densecloud_cascade::Fake;
use densecloud_formats::Format;
use densecloud_server::Config;

use crate::support::{Client, PATIENCE, PLY, Reply, Scripted, Server, cloud, encode, narrow, wait_until};

/// Impatient, so that tests are quick.
fn impatient() -> Config {
    let mut config = Config::default();
    config.timeouts.head = Duration::from_secs(1);
    config.timeouts.keep_alive = Duration::from_secs(1);
    config.timeouts.stall = Duration::from_secs(1);
    config
}

#[test]
fn a_connection_without_a_whole_head_is_closed() {
    let server = Server::start(&Scripted::new(), impatient());
    let starts = [
        &b""[..],
        b"P",
        b"POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\n",
        // Half, and all, of what HTTP/2 begins with: there hyper has no timer.
        b"PRI * HTTP/2.0\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    ];
    let clients = starts.map(|start| {
        let mut client = server.connect();
        client.send(start);
        client
    });
    for mut client in clients {
        // Ends, with whatever the server had to say, instead of running into the read's timeout.
        client.rest();
    }
    let mut client = server.connect();
    client.send(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n");
    assert!(Reply::parse(&client.rest()).is_some(), "answered, kept open a while, then closed");
}

#[test]
fn an_idle_connection_has_a_time_of_its_own_and_a_slow_head_after_it_the_heads() {
    let mut config = impatient();
    // Until the end of the test: so what closes the connection is not this.
    config.timeouts.keep_alive = Duration::from_secs(600);
    let server = Server::start(&Scripted::new(), config);
    let ask = b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n";
    let mut kept = server.connect();
    kept.send(ask);
    assert!(kept.some().starts_with(b"HTTP/1.1 200"));
    // Others come and go for longer than a head may take.
    let mut slow = server.connect();
    slow.send(b"GET /healthz HTTP/1.1\r\n");
    slow.rest();
    kept.send(ask);
    assert!(kept.some().starts_with(b"HTTP/1.1 200"), "still open");
    kept.send(&ask[..9]);
    assert_eq!(kept.rest(), b"", "a head that does not come to its end is not waited for");
}

#[test]
fn the_rest_of_an_upload_that_was_refused_is_not_taken_for_a_head() {
    let mut config = impatient();
    config.timeouts.keep_alive = Duration::from_secs(600);
    let server = Server::start(&Scripted::new(), config);
    let mut client = server.connect();
    client.send(b"POST /upsample?ratio=many HTTP/1.1\r\nhost: x\r\ncontent-length: 3\r\n\r\n1");
    assert!(client.some().starts_with(b"HTTP/1.1 400 "));
    client.send(b" ");
    // Others come and go for longer than a head may take.
    let mut slow = server.connect();
    slow.send(b"GET /healthz HTTP/1.1\r\n");
    slow.rest();
    client.send(b"2GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n");
    assert!(client.some().starts_with(b"HTTP/1.1 200 "), "still open");
}

#[test]
fn an_upload_that_stands_still_is_given_up() {
    let server = Server::start(&Scripted::new(), impatient());
    let mut client = server.connect();
    client.send(b"POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\ncontent-length: 1000\r\n\r\n1 2 3\n");
    let reply = client.reply();
    assert_eq!((reply.status, reply.problem_name().as_str()), (408, "upload-stalled"));
    assert_eq!(reply.problem()["setting"], "--stall-timeout");
}

#[test]
fn a_client_that_leaves_in_the_middle_of_its_upload_is_forgotten() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut client = server.connect();
    client.send(b"POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\ncontent-length: 1000\r\n\r\n1 2 3\n");
    wait_until("the upload is held", || server.metric("densecloud_held_bytes") == 6.0);
    drop(client);
    wait_until("it is forgotten", || {
        server.metric("densecloud_held_bytes") == 0.0 && server.metric("densecloud_requests_in_flight") == 0.0
    });
}

#[test]
fn a_client_that_leaves_stops_the_work() {
    let backend = Scripted::over(Fake::slow(Duration::from_millis(20)));
    let server = Server::start(&backend, Config::default());
    let body = encode(&cloud(1000), PLY);
    // How much work it would have been: a level of n points is 3 n / 32 patches.
    let patches: usize = [1000, 2000, 4000, 8000].iter().map(|n| 3 * n / 32).sum();
    let before = backend.batches();
    let mut client = server.connect();
    client.send_post("/upsample?ratio=16", &body);
    wait_until("it is being worked on", || backend.batches() > before);
    drop(client);
    server.wait_for_no_work();
    let done = backend.batches() - before;
    assert!(done < patches / 16, "{done} batches were run of at least {}", patches / 16);
    let cancelled = "densecloud_requests_total{interface=\"http\",outcome=\"cancelled\"}";
    wait_until("it is counted", || server.metric(cancelled) == 1.0);
    assert_eq!(server.metric("densecloud_held_bytes"), 0.0);
}

/// 128,000 points as text: some 7 MB, more than the system buffers.
const LARGE: &str = "/upsample?ratio=64";

fn large() -> Vec<u8> {
    encode(&cloud(2000), Format::TEXT)
}

#[test]
fn a_slow_reader_holds_nothing_but_its_result() {
    let mut config = Config::default();
    // Until the end of the test.
    config.timeouts.stall = Duration::from_secs(600);
    let server = Server::start(&Scripted::new(), config);
    let mut slow = narrow(&server);
    slow.send_post(LARGE, &large());
    let start = slow.some();
    assert!(start.starts_with(b"HTTP/1.1 200"));
    assert_eq!(server.engine.queued_points(), 0, "the engine is done with it");
    assert_eq!(server.metric("densecloud_held_bytes"), 128_000.0 * 24.0);
    let other = server.post("/upsample?ratio=2", &encode(&cloud(100), PLY));
    assert_eq!(other.status, 200, "others are served meanwhile");
    let whole = [start, slow.rest()].concat();
    let reply = Reply::parse(&whole).expect("a whole response");
    assert_eq!(reply.text().lines().count(), 128_000);
    wait_until("it is given back", || server.metric("densecloud_held_bytes") == 0.0);
}

#[test]
fn a_reader_that_stops_reading_is_cut_off() {
    let server = Server::start(&Scripted::new(), impatient());
    let mut stalled = narrow(&server);
    stalled.send_post(LARGE, &large());
    let start = stalled.some();
    assert!(start.starts_with(b"HTTP/1.1 200"));
    wait_until("its memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
    let whole = [start, stalled.rest()].concat();
    assert_eq!(Reply::parse(&whole), None, "the response must not look complete");
    let cancelled = "densecloud_requests_total{interface=\"http\",outcome=\"cancelled\"}";
    wait_until("it is counted", || server.metric(cancelled) == 1.0);
}

#[test]
fn a_reader_that_stops_reading_on_http2_ends_its_own_answer_alone() {
    use http_body_util::{BodyExt, Full};
    use hyper::Request;
    use hyper::body::Bytes;
    use hyper_util::rt::{TokioExecutor, TokioIo};
    use tokio::task::block_in_place;

    let backend = Scripted::new();
    let server = Server::start(&backend, impatient());
    let request = |method: &str, target: &str, body: Vec<u8>| {
        let url = format!("http://{}{target}", server.address);
        Request::builder().method(method).uri(url).body(Full::new(Bytes::from(body))).unwrap()
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    runtime.block_on(async {
        let stream = tokio::net::TcpStream::connect(server.address).await.unwrap();
        let mut builder = hyper::client::conn::http2::Builder::new(TokioExecutor::new());
        builder.initial_stream_window_size(1 << 16);
        let (mut sender, connection) = builder.handshake(TokioIo::new(stream)).await.unwrap();
        tokio::spawn(connection);
        let stalled = sender.send_request(request("POST", LARGE, large())).await.unwrap();
        assert_eq!(stalled.status(), 200);
        backend.shut();
        let small = encode(&cloud(100), PLY);
        let working = tokio::spawn(sender.send_request(request("POST", "/upsample?ratio=2", small)));
        block_in_place(|| server.wait_for_work());
        // Neither keeps what asks again and again alive what is not read, nor does that end what is worked on.
        let result = 200.0 * 24.0;
        let given_back = async {
            while block_in_place(|| server.metric("densecloud_held_bytes")) > result {
                let probe = sender.send_request(request("GET", "/healthz", Vec::new())).await.unwrap();
                assert_eq!(probe.status(), 200);
            }
        };
        tokio::time::timeout(PATIENCE, given_back).await.expect("it is given back");
        backend.open();
        let answer = working.await.unwrap().expect("the other is answered");
        let length: usize = answer.headers()["content-length"].to_str().unwrap().parse().unwrap();
        assert_eq!(answer.into_body().collect().await.unwrap().to_bytes().len(), length);
        assert!(stalled.into_body().collect().await.is_err(), "it must not look complete");
    });
    let cancelled = "densecloud_requests_total{interface=\"http\",outcome=\"cancelled\"}";
    assert_eq!(server.metric(cancelled), 1.0);
}

#[test]
fn one_address_does_not_take_all_connections() {
    let mut config = Config::default();
    config.limits.client_connections = 3;
    let server = Server::start(&Scripted::new(), config);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let from = |address: &str| {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.bind(format!("{address}:0").parse().unwrap()).unwrap();
        let stream = runtime.block_on(socket.connect(server.address)).unwrap().into_std().unwrap();
        stream.set_nonblocking(false).unwrap();
        Client::of(stream)
    };
    let served = |mut client: Client| {
        client.try_send(b"GET /healthz HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n");
        Reply::parse(&client.rest()).is_some_and(|reply| reply.status == 200)
    };
    let idle: Vec<Client> = (0..3).map(|_| from("127.0.0.2")).collect();
    wait_until("no further one is served", || !served(from("127.0.0.2")));
    assert!(served(from("127.0.0.3")), "those of others are");
    drop(idle);
    wait_until("there is room again", || served(from("127.0.0.2")));
}

#[test]
fn a_head_that_drips_is_given_up_however_steadily_it_drips() {
    let server = Server::start(&Scripted::new(), impatient());
    let head = b"POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\nx-more: ";
    // The second begins as HTTP/2 does, and goes on with settings that never end.
    for start in [&head[..], b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\x40\0\x04\0\0\0\0\0"] {
        let mut client = server.connect();
        client.send(start);
        wait_until("the connection ends", || !client.try_send(b"x"));
    }
    assert_eq!(server.metric("densecloud_requests_in_flight"), 0.0);
}

#[test]
fn an_upload_that_drips_is_ended_by_the_deadline() {
    let mut config = Config::default();
    // Each drop is in time for the first, and all of them together too late for the second.
    config.timeouts.stall = Duration::from_secs(600);
    config.timeouts.request = Duration::from_secs(1);
    let server = Server::start(&Scripted::new(), config);
    let mut client = server.connect();
    client.send(
        b"POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 1000000\r\n\r\n",
    );
    let refused = "densecloud_requests_total{interface=\"http\",outcome=\"deadline\"}";
    wait_until("it is given up", || {
        client.try_send(b"1 2 3\n");
        server.metric(refused) == 1.0
    });
    let reply = client.reply();
    assert_eq!((reply.status, reply.problem_name().as_str()), (504, "deadline"));
    wait_until("its memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
}

#[test]
fn writers_that_stall_hold_their_bytes_and_no_worker() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(500), PLY);
    // More than there are workers, and threads for blocking work.
    let stalled: Vec<_> = (0..40)
        .map(|_| {
            let mut client = server.connect();
            let length = body.len();
            client.send(
                format!("POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\ncontent-length: {length}\r\n\r\n")
                    .as_bytes(),
            );
            client.send(&body[..300]);
            client
        })
        .collect();
    wait_until("all have arrived", || server.metric("densecloud_held_bytes") == 40.0 * 300.0);
    assert_eq!(server.post("/upsample?ratio=4", &body).status, 200, "others are served meanwhile");
    // Reserved since their headers came.
    assert_eq!(server.engine.queued_points(), 40 * 2000);
    drop(stalled);
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
    server.wait_for_no_work();
}
