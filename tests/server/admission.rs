//! Who is let in, with how much, and until when.

use std::path::Path;
use std::sync::Arc;

use densecloud_cascade::Fake;
use densecloud_engine::EngineConfig;
use densecloud_server::{Access, Config, Keys};

use crate::support::{PLY, Reply, Scripted, Server, cloud, encode, wait_until};

const ALICE: &str = "authorization: Bearer alices-secret-key\r\n";
const BOB: &str = "authorization: Bearer bobs-own-secret-key\r\n";

fn keys(folder: &Path) -> Access {
    let path = folder.join("keys");
    std::fs::write(&path, "# both\nalice alices-secret-key\nbob bobs-own-secret-key\n").unwrap();
    #[cfg(unix)]
    {
        let owners = std::os::unix::fs::PermissionsExt::from_mode(0o600);
        std::fs::set_permissions(&path, owners).unwrap();
    }
    Access { keys: Some(Arc::new(Keys::read(&path).unwrap())), ..Access::default() }
}

fn body() -> Vec<u8> {
    encode(&cloud(100), PLY)
}

fn is_refused(reply: &Reply, status: u16, name: &str) {
    assert_eq!((reply.status, reply.problem_name().as_str()), (status, name), "{}", reply.text());
}

fn retry_after(reply: &Reply) -> u64 {
    reply.header("retry-after").and_then(|seconds| seconds.parse().ok()).expect("seconds")
}

#[test]
fn with_keys_one_is_needed_but_for_what_is_open() {
    let folder = tempfile::tempdir().unwrap();
    let access = Access { open_metrics: false, ..keys(folder.path()) };
    let server = Server::start(&Scripted::new(), Config { access, ..Config::default() });
    for (headers, status) in [
        ("", 401),
        ("authorization: Bearer nobodys-secret-key\r\n", 401),
        ("authorization: Basic YWxpY2U6eA==\r\n", 401),
        (ALICE, 200),
        ("x-api-key: bobs-own-secret-key\r\n", 200),
    ] {
        let reply = server.ask("POST", "/upsample?ratio=2", headers, &body());
        assert_eq!(reply.status, status, "{headers}: {}", String::from_utf8_lossy(&reply.body));
        if status == 401 {
            is_refused(&reply, 401, "unauthorized");
            assert_eq!(reply.header("www-authenticate"), Some("Bearer realm=\"densecloud\""));
            assert_eq!(reply.problem()["setting"], "--keys");
            assert!(!reply.text().contains("nobodys"), "{}", reply.text());
        }
    }
    for (path, status) in [
        ("/healthz", 200),
        ("/readyz", 200),
        ("/v2/health/ready", 200),
        ("/docs", 200),
        ("/metrics", 401),
        ("/v2/models/densecloud", 401),
        ("/nowhere", 401),
    ] {
        assert_eq!(server.get(path).status, status, "{path}");
    }
    let metrics = server.ask("GET", "/metrics", BOB, b"");
    let page = String::from_utf8_lossy(&metrics.body).into_owned();
    assert!(page.contains("densecloud_admitted_total 2"), "{page}");
    assert!(!page.contains("alice") && !page.contains("bob"), "no label grows with clients");
    // The protocol's own form of an error.
    let infer = server.ask("POST", "/v2/models/densecloud/infer", "", b"{}");
    assert_eq!((infer.status, infer.header("content-type")), (401, Some("application/json")));
}

#[test]
fn keys_that_are_read_again_count_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let access = keys(folder.path());
    let read = access.keys.clone().unwrap();
    let server = Server::start(&Scripted::new(), Config { access, ..Config::default() });
    let status = |headers: &str| server.ask("POST", "/upsample?ratio=2", headers, &body()).status;
    assert_eq!((status(ALICE), status(BOB)), (200, 200));
    std::fs::write(folder.path().join("keys"), "bob bobs-own-secret-key\n").unwrap();
    assert_eq!(read.reload().unwrap(), 1);
    assert_eq!((status(ALICE), status(BOB)), (401, 200));
    std::fs::write(folder.path().join("keys"), "alice alices-secret-key\nbroken\n").unwrap();
    assert!(read.reload().is_err());
    assert_eq!((status(ALICE), status(BOB)), (401, 200));
    for (outcome, count) in [("ok", 1.0), ("failed", 1.0)] {
        let metric = format!("densecloud_keys_reloads_total{{outcome=\"{outcome}\"}}");
        assert_eq!(server.metric(&metric), count, "{metric}");
    }
}

#[test]
fn a_client_with_its_share_used_gets_429_and_others_are_served() {
    let folder = tempfile::tempdir().unwrap();
    let backend = Scripted::new();
    let sizes = EngineConfig { threads: 2, queue_points: 1000, client_points: 500, ..Default::default() };
    let config = Config { access: keys(folder.path()), ..Config::default() };
    let server = Server::start_cold(&backend, sizes, config);
    server.wait_for_ready();
    backend.shut();
    let first = server.begin("POST", "/upsample?ratio=4", ALICE, &body());
    server.wait_for_work();
    let refused = server.ask("POST", "/upsample?ratio=4", ALICE, &body());
    is_refused(&refused, 429, "client-share");
    assert_eq!(refused.problem()["setting"], "--client-points");
    assert_eq!(refused.problem()["limit"], 500);
    assert!(retry_after(&refused) >= 1);
    let others = server.begin("POST", "/upsample?ratio=4", BOB, &body());
    wait_until("the other's is queued", || server.engine.queued_points() == 800);
    // The tensor's points never come, so whatever answers has not waited for them.
    let json = r#"{"parameters":{"ratio":4},"inputs":[{"name":"points","datatype":"FP32","shape":[100,3],
        "parameters":{"binary_data_size":1200}}]}"#;
    let mut infer = server.connect();
    infer.send(
        format!(
            "POST /v2/models/densecloud/infer HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{ALICE}\
             inference-header-content-length: {}\r\ncontent-length: {}\r\n\r\n{json}",
            json.len(),
            json.len() + 1200
        )
        .as_bytes(),
    );
    let infer = infer.reply();
    assert_eq!(infer.status, 429, "{}", infer.text());
    assert!(infer.text().contains("--client-points"), "{}", infer.text());
    backend.open();
    assert_eq!((first.reply().status, others.reply().status), (200, 200));
    assert_eq!(server.metric("densecloud_refused_total{reason=\"client-share\"}"), 2.0);
    server.wait_for_no_work();
}

#[test]
fn what_cannot_be_admitted_is_refused_before_its_body() {
    let backend = Scripted::new();
    let sizes = EngineConfig { threads: 2, queue_points: 1000, client_points: 1000, ..Default::default() };
    let server = Server::start_cold(&backend, sizes, Config::default());
    server.wait_for_ready();
    backend.shut();
    let _first = server.begin("POST", "/upsample?ratio=6", "", &body());
    server.wait_for_work();
    // By its header: the points never come, so whatever answers has not waited for them.
    let header = "ply\nformat binary_little_endian 1.0\nelement vertex 101\nproperty float x\nproperty float y\n\
                  property float z\nend_header\n";
    let head = |length: usize| {
        format!(
            "POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {length}\r\n\r\n"
        )
    };
    let mut client = server.connect();
    client.send(head(header.len() + 1212).as_bytes());
    client.send(header.as_bytes());
    is_refused(&client.reply(), 503, "queue-full");
    // One that fits has its points from its header on.
    let mut slow = server.connect();
    slow.send(head(header.len() + 1212).replace("ratio=4", "points=400").as_bytes());
    slow.send(header.as_bytes());
    wait_until("its points are reserved", || server.engine.queued_points() == 1000);
    // Not one point is left: refused by its head, and not asked for its body.
    let mut client = server.connect();
    client.send(head(1000).replace("\r\n\r\n", "\r\nexpect: 100-continue\r\n\r\n").as_bytes());
    is_refused(&client.reply(), 503, "queue-full");
    drop(slow);
    wait_until("they are given back", || server.engine.queued_points() == 600);
    backend.open();
    server.wait_for_no_work();
}

#[test]
fn what_is_let_in_counts_as_waiting_before_it_has_come() {
    let backend = Scripted::over(Fake::slow(std::time::Duration::from_millis(3)));
    let queue_time = Some(std::time::Duration::from_secs(600));
    let sizes = EngineConfig { threads: 2, client_points: u64::MAX, queue_time, ..Default::default() };
    let request = std::time::Duration::from_secs(1_000_000);
    let timeouts = densecloud_server::Timeouts { request, ..Default::default() };
    let server = Server::start_cold(&backend, sizes, Config { timeouts, ..Config::default() });
    server.wait_for_ready();
    // Some twenty minutes of work, of which nothing but the header comes.
    let begin = || {
        let mut client = server.connect();
        let header = "ply\nformat binary_little_endian 1.0\nelement vertex 100000\nproperty float x\n\
                      property float y\nproperty float z\nend_header\n";
        let length = header.len() + 1_200_000;
        client.send(
            format!(
                "POST /upsample?ratio=40 HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {length}\r\n\r\n\
                 {header}"
            )
            .as_bytes(),
        );
        client
    };
    // Two threads are idle, so the third is the first to wait.
    let first = [begin(), begin(), begin()];
    wait_until("three are let in", || server.engine.queued_points() == 12_000_000);
    for _ in 0..3 {
        let refused = begin().reply();
        is_refused(&refused, 503, "queue-long");
        assert_eq!(refused.problem()["setting"], "--queue-time");
        assert!(retry_after(&refused) >= 1);
    }
    assert_eq!(server.post("/upsample?ratio=2", &body()).status, 200, "small ones have a queue of their own");
    drop(first);
    server.wait_for_no_work();
    drop(begin());
    wait_until("one more was let in", || server.metric("densecloud_admitted_total") == 5.0);
    server.wait_for_no_work();
}

#[test]
fn a_cloud_that_tells_no_size_takes_points_by_a_guess_before_it_is_read() {
    let server = Server::start(&Scripted::new(), Config::default());
    let broken = "0 0 0\n1 0 0\n0 1 0\n0 0 one\n";
    assert_eq!(server.post("/upsample?ratio=4", broken.as_bytes()).status, 400);
    assert_eq!(server.metric("densecloud_admitted_total"), 1.0);
    let json = r#"{"parameters":{"ratio":4},"inputs":[{"name":"points","datatype":"FP32","shape":[4,3],"data":[1,2,3,4,5,6]}]}"#;
    assert_eq!(server.post("/v2/models/densecloud/infer", json.as_bytes()).status, 400);
    assert_eq!(server.metric("densecloud_admitted_total"), 2.0);
    server.wait_for_no_work();
    // What a guess is above is judged by what is read.
    let limits = densecloud_server::Limits { points_in: 100, ..Default::default() };
    let server = Server::start(&Scripted::new(), Config { limits, ..Config::default() });
    let text = encode(&cloud(100), densecloud_formats::Format::TEXT);
    let commented = [b"# one of many\n".repeat(200), text].concat();
    assert_eq!(server.post("/upsample?ratio=2", &commented).status, 200);
}

#[test]
fn a_requests_own_deadline_counts_the_queue_and_is_told_with_what_it_was_spent_for() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    let fine = server.ask("POST", "/upsample?ratio=4", "x-request-timeout: 60\r\n", &body());
    assert_eq!(fine.status, 200);
    for value in ["0", "-1", "soon", "nan"] {
        let refused =
            server.ask("POST", "/upsample?ratio=4", &format!("x-request-timeout: {value}\r\n"), &body());
        is_refused(&refused, 400, "invalid-parameter");
        assert_eq!(refused.problem()["parameter"], "X-Request-Timeout");
    }
    backend.shut();
    let late = server.ask("POST", "/upsample?ratio=4", "x-request-timeout: 0.3\r\n", &body());
    is_refused(&late, 504, "deadline");
    let detail = late.problem()["detail"].as_str().unwrap().to_owned();
    for part in ["0.3 s", "of upload", "in the queue", "at work", "--request-timeout"] {
        assert!(detail.contains(part), "{part}: {detail}");
    }
    backend.open();
    server.wait_for_no_work();
}

#[test]
fn a_deadline_that_the_backlog_rules_out_is_refused_at_once() {
    let fake = Fake::slow(std::time::Duration::from_millis(3));
    let backend = Scripted::over(fake.clone());
    let server = Server::start(&backend, Config::default());
    let many = encode(&cloud(20_000), PLY);
    // Of the warm-up.
    let before = fake.batches();
    let large = server.begin("POST", "/upsample?ratio=16", "", &many);
    wait_until("it is at work", || fake.batches() > before);
    let refused = server.ask("POST", "/upsample?ratio=16", "x-request-timeout: 2\r\n", &many);
    is_refused(&refused, 503, "too-late");
    assert!(retry_after(&refused) >= 1);
    drop(large);
    server.wait_for_no_work();
}

#[test]
fn work_too_big_for_memory_gets_507_and_the_server_lives() {
    let sizes = EngineConfig { threads: 2, memory: 2 << 20, ..Default::default() };
    let folder = tempfile::tempdir().unwrap();
    let config =
        Config { jobs: Some(densecloud_jobs::Settings::new(folder.path().to_owned())), ..Config::default() };
    let server = Server::start_cold(&Scripted::new(), sizes, config);
    server.wait_for_ready();
    for path in ["/upsample", "/jobs"] {
        for format in [PLY, densecloud_formats::Format::TEXT] {
            let refused = server.post(&format!("{path}?ratio=64"), &encode(&cloud(100), format));
            is_refused(&refused, 507, "too-big-for-memory");
            assert_eq!(refused.problem()["setting"], "--max-memory");
        }
    }
    assert_eq!(server.post("/upsample?ratio=4", &body()).status, 200);
    assert_eq!(server.engine.queued_points(), 0);
}

#[test]
fn jobs_are_their_clients_own() {
    let folder = tempfile::tempdir().unwrap();
    let settings = densecloud_jobs::Settings {
        client_queued: 2,
        ..densecloud_jobs::Settings::new(folder.path().join("jobs"))
    };
    let config = Config { access: keys(folder.path()), jobs: Some(settings), ..Config::default() };
    let backend = Scripted::new();
    let server = Server::start(&backend, config);
    let submit =
        |key: &str| server.ask("POST", "/jobs?ratio=4", &format!("{key}idempotency-key: same\r\n"), &body());
    let (mine, yours) = (submit(ALICE), submit(BOB));
    assert_eq!((mine.status, yours.status), (202, 202), "each has its own names");
    let path = mine.header("location").unwrap().to_owned();
    assert_ne!(Some(path.as_str()), yours.header("location"));
    wait_until("it is done", || server.ask("GET", &path, ALICE, b"").text().contains("\"done\""));
    for (method, target) in [
        ("GET", path.clone()),
        ("GET", format!("{path}/result")),
        ("GET", format!("{path}/events")),
        ("DELETE", path.clone()),
    ] {
        is_refused(&server.ask(method, &target, BOB, b""), 404, "no-such-job");
        is_refused(&server.ask(method, &target, "", b""), 401, "unauthorized");
    }
    let list = server.ask("GET", "/jobs", BOB, b"").text();
    assert!(!list.contains(&path["/jobs/".len()..]), "{list}");
    assert_eq!(server.ask("GET", &format!("{path}/result"), ALICE, b"").status, 200);
    assert_eq!(server.ask("DELETE", &path, ALICE, b"").status, 204);
    // And so is their share.
    backend.shut();
    let keep = |key: &str| server.ask("POST", "/jobs?ratio=4", key, &body());
    assert_eq!((keep(ALICE).status, keep(ALICE).status), (202, 202));
    let refused = keep(ALICE);
    is_refused(&refused, 429, "client-jobs");
    assert_eq!(refused.problem()["setting"], "--client-jobs");
    assert_eq!(keep(BOB).status, 202);
    backend.open();
    wait_until("it has room again", || keep(ALICE).status == 202);
    wait_until("all are done", || server.metric("densecloud_jobs{state=\"queued\"}") == 0.0);
    server.wait_for_no_work();
}

#[test]
fn behind_a_proxy_clients_are_told_apart_by_what_it_forwards() {
    let backend = Scripted::new();
    let sizes = EngineConfig { threads: 2, queue_points: 2000, client_points: 500, ..Default::default() };
    let access = Access { trust_forwarded: true, ..Access::default() };
    let server = Server::start_cold(&backend, sizes, Config { access, ..Config::default() });
    server.wait_for_ready();
    backend.shut();
    let of = |hops: &str| format!("x-forwarded-for: {hops}\r\n");
    let first = server.begin("POST", "/upsample?ratio=4", &of("10.0.0.1"), &body());
    server.wait_for_work();
    let same = server.ask("POST", "/upsample?ratio=4", &of("10.0.0.9, 10.0.0.1"), &body());
    is_refused(&same, 429, "client-share");
    let same = server.ask("POST", "/upsample?ratio=4", &of("10.0.0.1:4711"), &body());
    is_refused(&same, 429, "client-share");
    let other = server.begin("POST", "/upsample?ratio=4", &of("10.0.0.1, 10.0.0.2"), &body());
    wait_until("the other's is queued", || server.engine.queued_points() == 800);
    backend.open();
    assert_eq!((first.reply().status, other.reply().status), (200, 200));
}
