//! `densecloud serve --data-dir` ended with SIGKILL at random moments under a load of jobs, again and
//! again: no job that was accepted is lost, none is done twice, and no result is anything but whole.
//!
//! `DENSECLOUD_KILLS=200 cargo test --test program kills` takes minutes; without it there are a few.

use std::collections::{BTreeMap, BTreeSet};
use std::hash::{BuildHasher, RandomState};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::Value;
use ureq::Agent;

use crate::support::{PATIENCE, Serving, agent, densecloud, sphere};

/// Starts it; `done` gets the jobs that it says it has done, each as often as it does.
fn start(data: &Path, done: &Arc<Mutex<Vec<String>>>) -> Serving {
    let done = Arc::clone(done);
    // So many attempts that no job is given up for being unlucky.
    let options = ["--job-attempts", "1000000", "--data-dir", data.to_str().expect("UTF-8")];
    Serving::launch(densecloud(), &options, move |event| {
        if event["message"] == "job done" {
            done.lock().expect("no panic").push(event["job"].as_str().expect("an id").to_owned());
        }
    })
}

/// A cloud, what is asked for, and what the command line makes of it.
struct Variant {
    input: String,
    seed: usize,
    expected: Vec<u8>,
}

impl Variant {
    const RATIO: &str = "4";

    fn make(folder: &Path, seed: usize) -> Self {
        let (from, to) = (folder.join("in.xyz"), folder.join("out.xyz"));
        let input = sphere(250 + 100 * seed);
        std::fs::write(&from, &input).expect("a file");
        let mut command = densecloud();
        command.arg("upsample").args([&from, &to]).args([
            "--ratio",
            Self::RATIO,
            "--seed",
            &seed.to_string(),
        ]);
        assert!(command.status().expect("the program starts").success());
        Self { input, seed, expected: std::fs::read(&to).expect("a file") }
    }
}

/// What the client knows: the jobs by their keys.
#[derive(Default)]
struct Known {
    /// Answered with 202 or 200.
    accepted: BTreeMap<usize, String>,
    /// Documents of jobs that were seen done.
    done: BTreeMap<String, Value>,
    next: usize,
}

/// Leaves jobs until the server is gone. A request that was not answered is made again in the next round,
/// under the same key.
fn load(agent: &Agent, url: &str, variants: &[Variant], known: &mut Known, most: usize) {
    for _ in 0..most {
        let Variant { input, seed, .. } = &variants[known.next % variants.len()];
        let answer = agent
            .post(format!("{url}/jobs?ratio={}&seed={seed}", Variant::RATIO))
            .header("idempotency-key", format!("key-{}", known.next))
            .send(input);
        let Ok(mut answer) = answer else { return };
        match answer.status().as_u16() {
            202 | 200 => {
                // A head that arrived is an answer: the job is on the disk.
                let place = answer.headers()["location"].to_str().expect("a location").to_owned();
                known.accepted.insert(known.next, place);
                known.next += 1;
            }
            503 => std::thread::sleep(Duration::from_millis(5)),
            other => panic!("{other}: {:?}", answer.body_mut().read_to_string()),
        }
    }
}

fn json(agent: &Agent, url: &str) -> Option<(u16, Value)> {
    let mut answer = agent.get(url).call().ok()?;
    let text = answer.body_mut().read_to_string().ok()?;
    Some((answer.status().as_u16(), serde_json::from_str(&text).expect("JSON")))
}

/// Looks at all jobs: they are there, and what was done stays as it was. False when the server is gone.
fn check(agent: &Agent, url: &str, variants: &[Variant], known: &mut Known) -> bool {
    for (key, place) in &known.accepted {
        let Some((status, job)) = json(agent, &format!("{url}{place}")) else { return false };
        assert_eq!(status, 200, "{place} is lost: {job}");
        if let Some(before) = known.done.get(place) {
            assert_eq!(&job, before, "what is done stays as it is");
            continue;
        }
        assert!(["queued", "running", "done"].contains(&job["state"].as_str().expect("a state")), "{job}");
        let Ok(mut answer) = agent.get(format!("{url}{place}/result")).call() else { return false };
        let status = answer.status().as_u16();
        let Ok(bytes) = answer.body_mut().read_to_vec() else { return false };
        if job["state"] == "done" {
            assert_eq!(status, 200);
            assert!(bytes == variants[key % variants.len()].expected, "{place}: not the library's result");
            known.done.insert(place.clone(), job);
        } else if status == 200 {
            assert!(
                bytes == variants[key % variants.len()].expected,
                "{place}: done in between, but not whole"
            );
        } else {
            assert_eq!(status, 409);
        }
    }
    true
}

#[test]
fn no_kill_loses_a_job_or_does_one_twice() {
    let rounds = std::env::var("DENSECLOUD_KILLS").map_or(6, |text| text.parse().expect("a number"));
    let seed = RandomState::new().hash_one("kills");
    println!("seed {seed}");
    let mut state = seed | 1;
    // Xorshift: where the kills fall need not be the same twice.
    let mut random = |below: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state % below
    };
    let folder = tempfile::tempdir().expect("a folder");
    let variants: Vec<_> = (0..4).map(|seed| Variant::make(folder.path(), seed)).collect();
    let data = folder.path().join("data");
    let agent = agent();
    let logged = Arc::new(Mutex::new(Vec::new()));
    let mut known = Known::default();
    let (mut cold, mut busy) = (0, 0);
    for _ in 0..rounds {
        let serving = start(&data, &logged);
        let url = serving.url("");
        // Some are killed while they warm up and look after what is left of the last.
        if random(4) == 0 {
            cold += 1;
            std::thread::sleep(Duration::from_millis(random(150)));
            serving.kill();
            continue;
        }
        serving.wait_for("ready");
        let longest = [50, 800][random(2) as usize];
        let delay = Duration::from_millis(random(longest));
        std::thread::scope(|scope| {
            let client = scope.spawn(|| {
                if check(&agent, &url, &variants, &mut known) {
                    // A backlog that stays small, so that the last server is done with it in time.
                    let waiting = known.accepted.len() - known.done.len();
                    load(&agent, &url, &variants, &mut known, 8_usize.saturating_sub(waiting));
                }
            });
            let start = Instant::now();
            while start.elapsed() < delay {
                std::thread::sleep(Duration::from_millis(1));
            }
            busy += usize::from(!client.is_finished());
            serving.kill();
            client.join().expect("the client is content");
        });
    }
    let serving = start(&data, &logged);
    serving.wait_for("ready");
    let url = serving.url("");
    load(&agent, &url, &variants, &mut known, 4);
    let start = Instant::now();
    while known.done.len() < known.accepted.len() {
        assert!(start.elapsed() < PATIENCE, "{} of {}", known.done.len(), known.accepted.len());
        assert!(check(&agent, &url, &variants, &mut known));
    }
    // Each key is one job, and there are no others.
    let places: BTreeSet<_> = known.accepted.values().collect();
    assert_eq!(places.len(), known.accepted.len());
    let outputs = || {
        let entries = std::fs::read_dir(data.join("files")).expect("a folder");
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
    };
    assert_eq!(outputs().filter(|name| name.ends_with(".out")).count(), places.len());
    assert_eq!(outputs().count(), places.len(), "nothing else is left");
    serving.signal("TERM");
    assert_eq!(serving.end().code(), Some(0));
    let logged = logged.lock().expect("no panic").clone();
    let once: BTreeSet<_> = logged.iter().collect();
    assert_eq!(once.len(), logged.len(), "a job was done twice");
    let interrupted = known.done.values().filter(|job| job["attempts"] != 1).count();
    println!(
        "{rounds} kills, {cold} of them before it was ready, {busy} under a request; {} jobs, {interrupted} of them \
         started more than once",
        known.done.len()
    );
}
