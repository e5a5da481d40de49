//! Faults that are not the client's: a worker that panics, a database that another program holds.

use densecloud_cascade::Target;
use densecloud_server::Config;
use serde_json::Value;

use crate::support::{Client, PLY, Scripted, Server, cloud, dense, encode, encode_result, wait_until};

#[test]
fn a_worker_that_panics_costs_one_request_a_500_and_nothing_else() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    let body = encode(&cloud(300), PLY);
    // More often than there are workers: each must have come back.
    for _ in 0..5 {
        backend.panic();
        let reply = server.post("/upsample?ratio=4", &body);
        assert_eq!((reply.status, reply.problem_name().as_str()), (500, "internal"));
        assert!(!reply.text().contains("secret"), "{}", reply.text());
    }
    let reply = server.post("/upsample?ratio=4", &body);
    assert_eq!(reply.status, 200);
    assert!(reply.body == encode_result(&dense(cloud(300), Target::Ratio(4.0), 0), PLY, &reply));
    assert_eq!(server.engine.queued_points(), 0);
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
    assert_eq!(server.metric("densecloud_requests_total{interface=\"http\",outcome=\"internal\"}"), 5.0);
}

#[test]
fn a_panic_under_one_request_leaves_those_beside_it_alone() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    backend.shut();
    let body = encode(&cloud(300), PLY);
    let mut clients: Vec<Client> = (0..4).map(|_| server.connect()).collect();
    for client in &mut clients {
        client.send_post("/upsample?ratio=4", &body);
    }
    wait_until("all are taken", || server.engine.queued_points() == 4 * 1200);
    backend.panic();
    backend.open();
    let mut statuses: Vec<u16> = clients.into_iter().map(|client| client.reply().status).collect();
    statuses.sort_unstable();
    assert_eq!(statuses, [200, 200, 200, 500]);
}

fn json(bytes: &[u8]) -> Value {
    serde_json::from_slice(bytes).expect("JSON")
}

#[test]
fn a_job_under_which_a_worker_panics_fails_and_the_next_is_done() {
    let folder = tempfile::tempdir().expect("a folder");
    let backend = Scripted::new();
    let config =
        Config { jobs: Some(densecloud_jobs::Settings::new(folder.path().to_owned())), ..Config::default() };
    let server = Server::start(&backend, config);
    let body = encode(&cloud(300), PLY);
    for (panics, state) in [(true, "failed"), (false, "done")] {
        if panics {
            backend.panic();
        }
        let reply = server.post("/jobs?ratio=4", &body);
        let place = reply.header("location").expect("a location").to_owned();
        wait_until(state, || json(&server.get(&place).body)["state"] == state);
        assert!(!server.get(&place).text().contains("secret"));
    }
}

#[test]
fn a_database_that_another_program_locks_is_told_of_and_nothing_is_lost() {
    let folder = tempfile::tempdir().expect("a folder");
    let backend = Scripted::new();
    let config =
        Config { jobs: Some(densecloud_jobs::Settings::new(folder.path().to_owned())), ..Config::default() };
    let server = Server::start(&backend, config);
    let body = encode(&cloud(300), PLY);
    let submit = |key: &str| {
        let mut client = server.connect();
        let head = format!(
            "POST /jobs?ratio=4 HTTP/1.1\r\nhost: x\r\nconnection: close\r\nidempotency-key: {key}\r\n\
             content-length: {}\r\n\r\n",
            body.len()
        );
        client.send(head.as_bytes());
        client.send(&body);
        client
    };
    let place = |client: Client| client.reply().header("location").expect("a location").to_owned();
    let is = |place: &str, state: &str| json(&server.get(place).body)["state"] == state;
    let before = place(submit("before"));
    wait_until("it is done", || is(&before, "done"));
    let done = "densecloud_jobs{state=\"done\"}";
    assert_eq!(server.metric(done), 1.0);
    // Its end falls into the time of the lock.
    backend.shut();
    let running = place(submit("running"));
    wait_until("it runs", || is(&running, "running"));
    let mut watching = server.connect();
    watching
        .send(format!("GET {running}/events HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").as_bytes());
    let mut events = watching.some();

    let other = rusqlite::Connection::open(folder.path().join("jobs.sqlite")).expect("a database");
    other.execute_batch("BEGIN EXCLUSIVE").expect("a lock");
    backend.open();
    // More than there are threads for blocking work: those are for everybody.
    let waiting: Vec<Client> = (0..20).map(|i| submit(&format!("during-{i}"))).collect();
    let reply = server.post("/upsample?ratio=4", &body);
    assert_eq!(reply.status, 200, "who needs no database does not wait for it");
    assert_eq!(server.get("/healthz").status, 200);
    assert_eq!(server.metric(done), 1.0, "as it was last");
    for client in waiting {
        let reply = client.reply();
        assert_eq!((reply.status, reply.problem_name().as_str()), (503, "jobs-busy"));
    }
    assert!(is(&before, "done"), "what can be read is read");
    other.execute_batch("ROLLBACK").expect("no lock");

    events.extend(watching.rest());
    let events = String::from_utf8(events).expect("text");
    assert!(events.contains("event: done") && !events.contains("event: deleted"), "{events}");
    for place in [running, place(submit("during-0"))] {
        wait_until("it is done", || is(&place, "done"));
        let kept = server.get(&format!("{place}/result"));
        assert!(kept.body == encode_result(&dense(cloud(300), Target::Ratio(4.0), 0), PLY, &kept));
    }
    let listed = json(&server.get("/jobs").body);
    assert_eq!(listed["jobs"].as_array().expect("jobs").len(), 3, "{listed}");
    let left = std::fs::read_dir(folder.path().join("files")).expect("a folder").count();
    assert_eq!(left, 3, "results and nothing else");
}

#[test]
fn names_of_jobs_lead_nowhere_else() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("secret"), "a secret").expect("a file");
    let data = folder.path().join("data");
    let config = Config { jobs: Some(densecloud_jobs::Settings::new(data.clone())), ..Config::default() };
    let server = Server::start(&Scripted::new(), config);
    // What a job's files are called, its database, and files beside them.
    std::fs::write(data.join("files/known.out"), "a secret").expect("a file");
    for name in [
        "known",
        "known.out",
        "..%2fsecret",
        "..%2f..%2fsecret",
        "%2e%2e%2fjobs.sqlite",
        "..%5csecret",
        "%00",
        "a%00b",
        "'%20OR%201=1",
    ] {
        for (method, rest) in [("GET", ""), ("GET", "/result"), ("GET", "/events"), ("DELETE", "")] {
            let mut client = server.connect();
            let head =
                format!("{method} /jobs/{name}{rest} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n");
            client.send(head.as_bytes());
            let reply = client.reply();
            assert_eq!((reply.status, reply.problem_name().as_str()), (404, "no-such-job"), "{head}");
            assert!(!reply.text().contains("a secret"));
        }
    }
    for kept in [folder.path().join("secret"), data.join("files/known.out"), data.join("jobs.sqlite")] {
        assert!(kept.exists(), "{kept:?}");
    }
}
