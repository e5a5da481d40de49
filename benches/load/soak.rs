//! A long load of everything: answers, clients that leave, jobs, bad requests; and the memory meanwhile.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use densecloud_geometry::Rng;
use hyper::body::Bytes;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use crate::client::{Clients, half, whole};
use crate::mix::{Deck, Mix, Order, RATIO, TARGET};
use crate::server::Server;
use crate::tally::{Tally, median};

/// Of the capacity.
const LOAD: f64 = 0.8;
/// By how much memory may grow after the warm-up.
const GROWTH: f64 = 0.05;
/// Parts of the run: the first two are the warm-up, the third is what the rest is compared with.
const PARTS: usize = 10;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Action {
    Upsample,
    LeaveUpload,
    LeaveWork,
    LeaveAnswer,
    Job,
    CancelJob,
    Bad,
    Probe,
}

const ACTIONS: [(u64, Action); 8] = [
    (70, Action::Upsample),
    (3, Action::LeaveUpload),
    (4, Action::LeaveWork),
    (3, Action::LeaveAnswer),
    (8, Action::Job),
    (2, Action::CancelJob),
    (6, Action::Bad),
    (4, Action::Probe),
];

/// Mean points that an action gives the server to make; clients that leave before the answer count as none.
fn points(mix: &Mix) -> f64 {
    let all: u64 = ACTIONS.iter().map(|(weight, _)| weight).sum();
    let of = |(weight, action): &(u64, Action)| {
        let points = match action {
            Action::Upsample | Action::LeaveAnswer => mix.points(),
            Action::Job => mix.points_of(0),
            _ => 0.0,
        };
        *weight as f64 / all as f64 * points
    };
    ACTIONS.iter().map(of).sum()
}

struct Soak {
    clients: Arc<Clients>,
    mix: Arc<Mix>,
    tally: Mutex<Tally>,
    done: Mutex<BTreeMap<Action, u64>>,
}

pub(crate) async fn soak(
    server: &Server,
    clients: &Arc<Clients>,
    mix: &Arc<Mix>,
    capacity: f64,
    minutes: f64,
    seed: u64,
) -> bool {
    let soak = Arc::new(Soak {
        clients: Arc::clone(clients),
        mix: Arc::clone(mix),
        tally: Mutex::default(),
        done: Mutex::default(),
    });
    let length = Duration::from_secs_f64(60.0 * minutes);
    let start = Instant::now();
    let rate = LOAD * capacity / points(mix);
    let (memory, ()) = tokio::join!(sample(server, start, length), load(&soak, rate, length, seed));
    let idle = clients.idle().await;
    let left = clients.metric("densecloud_held_bytes").await;
    println!("\nsoak of {minutes} minutes at {rate:.2} requests/s");
    println!("done: {:?}", soak.done.lock().unwrap());
    let tally = soak.tally.lock().unwrap();
    println!("answers: {}", tally.summary());
    tally.print_faults();
    if !idle || left != Some(0.0) {
        println!("FAULT: work or memory is left when all clients are gone: {left:?} bytes");
    }
    let flat = report(&memory, length);
    tally.faults.is_empty() && idle && left == Some(0.0) && flat
}

/// The memory every few seconds: when, and how much.
async fn sample(server: &Server, start: Instant, length: Duration) -> Vec<(Duration, u64)> {
    let every = (length / 500).clamp(Duration::from_millis(100), Duration::from_secs(5));
    let mut samples = Vec::new();
    while start.elapsed() < length {
        samples.push((start.elapsed(), server.memory()));
        sleep(every).await;
    }
    samples
}

/// Prints the memory by parts of the run; whether it stayed flat: in the least of each part, which is what stays when
/// little is being worked on, and in the medians. These go with what else the machine does, too: the busier it is, the
/// more requests are at work at a time.
fn report(samples: &[(Duration, u64)], length: Duration) -> bool {
    let part = |i: usize| {
        let within = |t: Duration| (t.as_secs_f64() / length.as_secs_f64() * PARTS as f64) as usize == i;
        let part: Vec<f64> =
            samples.iter().filter(|(t, _)| within(*t)).map(|(_, bytes)| *bytes as f64 / 1e6).collect();
        (part.iter().copied().fold(f64::INFINITY, f64::min), median(part))
    };
    let parts: Vec<(f64, f64)> = (0..PARTS).map(part).collect();
    println!(
        "\n| part of the run | memory, MB, least | beside the first after the warm-up | median | beside |\n\
         |---|---|---|---|---|"
    );
    let growth = |i: usize| (parts[i].0 / parts[2].0 - 1.0, parts[i].1 / parts[2].1 - 1.0);
    for (i, (least, median)) in parts.iter().enumerate() {
        let share = |growth: f64| if i < 2 { "warm-up".into() } else { format!("{:+.1} %", 100.0 * growth) };
        let (by_least, by_median) = growth(i);
        let (by_least, by_median) = (share(by_least), share(by_median));
        println!("| {} % | {least:.1} | {by_least} | {median:.1} | {by_median} |", (i + 1) * 100 / PARTS);
    }
    let (by_least, by_median) = growth(PARTS - 1);
    let flat = by_least.max(by_median) <= GROWTH;
    if !flat {
        println!("FAULT: memory grew");
    }
    flat
}

async fn load(soak: &Arc<Soak>, rate: f64, length: Duration, seed: u64) {
    let mut random = Rng::stream(seed, 1000);
    let start = Instant::now();
    let mut due = start;
    let mut tasks = JoinSet::new();
    let mut deck = Deck::new(&soak.mix, Rng::stream(seed, 1001));
    let mut number = 0;
    loop {
        due += Duration::from_secs_f64(-(1.0 - random.f64()).ln() / rate);
        if due > start + length {
            break;
        }
        sleep_until(due).await;
        while tasks.try_join_next().is_some() {}
        let soak = Arc::clone(soak);
        let order = deck.draw();
        number += 1;
        let random = Rng::stream(seed, 10_000 + number);
        tasks.spawn(async move { soak.act(order, random).await });
    }
    while tasks.join_next().await.is_some() {}
}

/// Why an action did not go as it should: with a fault, or because the server was busy, which is no fault.
enum Not {
    Right(String),
    Now,
}

impl Soak {
    async fn act(&self, order: Order, mut random: Rng) {
        let mut place = random.below(ACTIONS.iter().map(|(weight, _)| weight).sum());
        let chosen = ACTIONS.iter().find(|(weight, _)| {
            let found = place < *weight;
            place = place.saturating_sub(*weight);
            found
        });
        let action = chosen.map_or(Action::Upsample, |(_, action)| *action);
        let done = timeout(self.clients.patience, self.perform(action, order, &mut random)).await;
        let mut tally = self.tally.lock().unwrap();
        match done {
            Ok(Ok(())) => *self.done.lock().unwrap().entry(action).or_default() += 1,
            Ok(Err(Not::Now)) => {}
            Ok(Err(Not::Right(why))) => tally.fault(format!("{action:?}: {why}")),
            Err(_) => tally.fault(format!("{action:?}: not over after {:?}", self.clients.patience)),
        }
    }

    async fn perform(&self, action: Action, order: Order, random: &mut Rng) -> Result<(), Not> {
        let client = self.clients.draw(random);
        let brief = Duration::from_secs_f64(0.2 * random.f64());
        let body = whole(order.body.clone());
        match action {
            Action::Upsample => {
                let answer = self.ask(client, "POST", TARGET, &[], order.body.clone(), 200).await?;
                self.mix.check(&order, &answer).map_err(Not::Right)
            }
            Action::LeaveUpload => {
                let left =
                    timeout(brief, self.clients.leave_early(client, "POST", TARGET, half(&order.body)));
                match left.await {
                    Err(_) => Ok(()),
                    Ok(answered) => self.refused_early(answered),
                }
            }
            Action::LeaveWork => {
                // Answered or not, when it leaves.
                let _ = timeout(brief, self.clients.leave_early(client, "POST", TARGET, body)).await;
                Ok(())
            }
            Action::LeaveAnswer => {
                self.clients.leave_early(client, "POST", TARGET, body).await.map_err(Not::Right)
            }
            Action::Job => self.job(client, random, false).await,
            Action::CancelJob => self.job(client, random, true).await,
            Action::Bad => self.bad(client, random).await,
            Action::Probe => {
                let target = ["/healthz", "/readyz", "/metrics", "/openapi.json"][random.below(4) as usize];
                self.ask(client, "GET", target, &[], Bytes::new(), 200).await.map(|_| ())
            }
        }
    }

    /// Half an upload may be refused for what the server is busy with, and for nothing else.
    fn refused_early(&self, answered: Result<(), String>) -> Result<(), Not> {
        match answered {
            Ok(()) => Err(Not::Now),
            Err(why) => Err(Not::Right(why)),
        }
    }

    /// The body of an answer that must have this status.
    async fn ask(
        &self,
        client: usize,
        method: &str,
        target: &str,
        headers: &[(&str, &str)],
        body: Bytes,
        status: u16,
    ) -> Result<Vec<u8>, Not> {
        let answer = self.clients.ask(client, method, target, headers, whole(body)).await;
        let answer = answer.map_err(Not::Right)?;
        *self.tally.lock().unwrap().statuses.entry(answer.status).or_default() += 1;
        if answer.status == status {
            return Ok(answer.body);
        }
        if [429, 503].contains(&answer.status) && answer.headers.contains_key("retry-after") {
            return Err(Not::Now);
        }
        let text = String::from_utf8_lossy(&answer.body).into_owned();
        Err(Not::Right(format!("{method} {target}: {}, not {status}: {text}", answer.status)))
    }

    /// Leaves a job and fetches its result, or cancels it; forgets it in the end.
    async fn job(&self, client: usize, random: &mut Rng, cancel: bool) -> Result<(), Not> {
        let order = self.mix.draw(0, random);
        let key = format!("soak-{:016x}", random.next_u64());
        let headers = [("idempotency-key", key.as_str())];
        let target = format!("/jobs?ratio={RATIO}");
        let job = self.ask(client, "POST", &target, &headers, order.body.clone(), 202).await?;
        let id = read(&job)?["id"].as_str().unwrap_or_default().to_owned();
        let place = format!("/jobs/{id}");
        if cancel {
            sleep(Duration::from_secs_f64(0.2 * random.f64())).await;
        } else {
            loop {
                let job = read(&self.ask(client, "GET", &place, &[], Bytes::new(), 200).await?)?;
                match job["state"].as_str() {
                    Some("done") => break,
                    Some("queued" | "running") => sleep(Duration::from_millis(200)).await,
                    _ => return Err(Not::Right(format!("a job that ended otherwise: {job}"))),
                }
            }
            let result = self.ask(client, "GET", &format!("{place}/result"), &[], Bytes::new(), 200).await?;
            self.mix.check(&order, &result).map_err(Not::Right)?;
        }
        // 200 is a job that was cancelled, and is now over; 204 one that was, and is forgotten.
        loop {
            let answer = self.clients.ask(client, "DELETE", &place, &[], whole(Bytes::new())).await;
            match answer.map_err(Not::Right)?.status {
                200 => {}
                204 => return Ok(()),
                429 | 503 => sleep(Duration::from_millis(200)).await,
                other => return Err(Not::Right(format!("DELETE of a job: {other}"))),
            }
        }
    }

    async fn bad(&self, client: usize, random: &mut Rng) -> Result<(), Not> {
        let order = self.mix.draw(0, random);
        let (target, body, status): (_, Bytes, _) = match random.below(6) {
            0 => ("/upsample?ratio=65", order.body, 400),
            1 => ("/upsample?ratio=4&colour=red", order.body, 400),
            2 => (TARGET, order.body.slice(..order.body.len() - 1), 400),
            3 => (TARGET, Bytes::from_static(b"PK\x03\x04 a ZIP file"), 415),
            4 => (TARGET, Bytes::from_static(b"1 2 3\n4 5 6\n"), 422),
            _ => ("/nowhere", Bytes::new(), 404),
        };
        self.ask(client, "POST", target, &[], body, status).await.map(|_| ())
    }
}

fn read(bytes: &[u8]) -> Result<serde_json::Value, Not> {
    serde_json::from_slice(bytes).map_err(|error| Not::Right(format!("not JSON: {error}")))
}
