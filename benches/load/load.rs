//! The capacity, and loads as multiples of it.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use densecloud_geometry::Rng;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, sleep_until, timeout};

use crate::Arguments;
use crate::client::{Clients, whole};
use crate::mix::{Deck, Mix, Order, TARGET};
use crate::server::Server;
use crate::tally::{Tally, quantile};

/// Clients that wait for each answer: enough that no processor waits for a request.
const CLOSED: usize = 8;

/// Points out a second when a few clients ask one after another.
pub(crate) async fn capacity(clients: &Arc<Clients>, mix: &Arc<Mix>, arguments: &Arguments) -> f64 {
    let tally = Arc::new(Mutex::new(Tally::default()));
    let length = Duration::from_secs_f64(arguments.seconds);
    let start = Instant::now();
    let deck = Arc::new(Mutex::new(Deck::new(mix, Rng::stream(arguments.seed, 0))));
    let mut tasks = JoinSet::new();
    for number in 0..CLOSED {
        let (clients, mix, tally) = (Arc::clone(clients), Arc::clone(mix), Arc::clone(&tally));
        let deck = Arc::clone(&deck);
        tasks.spawn(async move {
            while start.elapsed() < length {
                let order = deck.lock().unwrap().draw();
                let client = number % clients.shares.len();
                if !request(&clients, &mix, &tally, client, order, Instant::now(), start + length).await {
                    // Refused: to ask again at once would only keep the server busy with refusals.
                    sleep(Duration::from_millis(100)).await;
                }
            }
        });
    }
    while tasks.join_next().await.is_some() {}
    let tally = tally.lock().unwrap();
    tally.print_faults();
    let (points, answers) =
        (tally.points as f64 / arguments.seconds, tally.answers as f64 / arguments.seconds);
    println!(
        "capacity, {CLOSED} clients: {answers:.2} requests/s, {points:.0} points out/s; {}",
        tally.summary()
    );
    assert!(points > 0.0, "nothing was answered");
    points
}

/// One request, due at `due`; answers that come before `end` are goodput. Whether it was answered with a cloud.
async fn request(
    clients: &Clients,
    mix: &Mix,
    tally: &Mutex<Tally>,
    client: usize,
    order: Order,
    due: Instant,
    end: Instant,
) -> bool {
    let asked = clients.ask(client, "POST", TARGET, &[], whole(order.body.clone()));
    let answer = timeout(clients.patience, asked).await;
    let now = Instant::now();
    let mut tally = tally.lock().unwrap();
    match answer {
        Err(_) => tally.left += 1,
        Ok(Err(broken)) => tally.fault(broken),
        Ok(Ok(answer)) => {
            *tally.statuses.entry(answer.status).or_default() += 1;
            match answer.status {
                200 => match mix.check(&order, &answer.body) {
                    Err(wrong) => tally.fault(wrong),
                    Ok(()) => {
                        tally.accepted.push(now - due);
                        if now <= end {
                            tally.points += order.points_out;
                            tally.answers += 1;
                            *tally.by_client.entry(client).or_default() += 1;
                        }
                    }
                },
                429 | 503 | 504 | 507 => {
                    tally.refused.push(answer.told.saturating_duration_since(due.into_std()));
                    if answer.status != 504 && !answer.headers.contains_key("retry-after") {
                        tally.fault(format!("{} without Retry-After", answer.status));
                    }
                }
                other => tally.fault(format!("{other}: {}", String::from_utf8_lossy(&answer.body))),
            }
            return answer.status == 200;
        }
    }
    false
}

/// Prints a table with a row a load; false where anything happened that must not.
pub(crate) async fn loads(
    server: &Server,
    clients: &Arc<Clients>,
    mix: &Arc<Mix>,
    capacity: f64,
    arguments: &Arguments,
) -> bool {
    println!(
        "\n| load | offered, points/s (requests/s) | goodput, points/s (requests/s) | accepted p50, p95, p99, ms | refused | \
         time to refuse p50, p99, ms | peak memory, MB | statuses |\n|---|---|---|---|---|---|---|---|"
    );
    let mut goodputs = Vec::new();
    let mut passed = true;
    for (number, &factor) in arguments.factors.iter().enumerate() {
        passed &= clients.idle().await;
        server.forget_peak();
        let tally = Arc::new(Mutex::new(Tally::default()));
        let rate = factor * capacity / mix.points();
        let (offered, points) = open(clients, mix, &tally, rate, arguments, number as u64).await;
        let peak = server.peak();
        let tally = tally.lock().unwrap();
        let seconds = arguments.seconds;
        let of = |share| quantile(&tally.accepted, share);
        println!(
            "| {factor} | {:.0} ({:.1}) | {:.0} ({:.1}) | {}, {}, {} | {:.0} % | {}, {} | {:.0} | {} |",
            points as f64 / seconds,
            offered as f64 / seconds,
            tally.points as f64 / seconds,
            tally.answers as f64 / seconds,
            of(0.5),
            of(0.95),
            of(0.99),
            100.0 * tally.refused.len() as f64 / offered.max(1) as f64,
            quantile(&tally.refused, 0.5),
            quantile(&tally.refused, 0.99),
            peak as f64 / 1e6,
            tally.summary(),
        );
        if clients.shares.len() > 1 {
            eprintln!("answers by client: {:?}", tally.by_client);
        }
        tally.print_faults();
        passed &= tally.faults.is_empty();
        goodputs.push(tally.points as f64);
    }
    let best = goodputs.iter().copied().fold(0.0, f64::max);
    let shares: Vec<_> = goodputs.iter().map(|g| format!("{:.0} %", 100.0 * g / best)).collect();
    println!("\ngoodput as a share of the best: {}", shares.join(", "));
    passed
}

/// Sends requests at times drawn beforehand, whatever becomes of them; gives how many, and the points that they ask for,
/// when the last is over.
async fn open(
    clients: &Arc<Clients>,
    mix: &Arc<Mix>,
    tally: &Arc<Mutex<Tally>>,
    rate: f64,
    arguments: &Arguments,
    number: u64,
) -> (usize, u64) {
    let mut deck = Deck::new(mix, Rng::stream(arguments.seed, 200 + number));
    let mut random = Rng::stream(arguments.seed, 100 + number);
    let start = Instant::now();
    let end = start + Duration::from_secs_f64(arguments.seconds);
    let mut due = start;
    let mut tasks = JoinSet::new();
    let mut points = 0;
    loop {
        due += Duration::from_secs_f64(-(1.0 - random.f64()).ln() / rate);
        if due > end {
            break;
        }
        let (order, client) = (deck.draw(), clients.draw(&mut random));
        points += order.points_out;
        let (clients, mix, tally) = (Arc::clone(clients), Arc::clone(mix), Arc::clone(tally));
        sleep_until(due).await;
        tasks.spawn(async move { request(&clients, &mix, &tally, client, order, due, end).await });
    }
    let offered = tasks.len();
    while tasks.join_next().await.is_some() {}
    (offered, points)
}
