//! What the server does under load, and whether its memory stays flat under a long one.
//!
//! ```text
//! cargo bench --bench load -- [OPTIONS] [-- OPTIONS OF densecloud serve]
//! cargo bench --bench load -- --soak 120
//! ```
//!
//! Starts the program's own server, measures its capacity with a few clients that each wait for their answer, then
//! sends requests at times that do not depend on the answers (a Poisson process), at 0.5 to 10 times that capacity.
//! Every answer is read to its end and compared with the first for the same cloud, which was parsed and counted: what
//! is not whole and right is not goodput. A latency counts from when the request was due.

#![allow(clippy::unwrap_used, reason = "a panic is how a measurement that cannot go on is told")]

mod client;
mod load;
mod mix;
mod server;
mod soak;
mod tally;

use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use clap::Parser;

use client::Clients;
use mix::Mix;
use server::Server;

#[derive(Debug, Parser)]
#[command(name = "load", about = "Loads a server of its own and tells how it bears it")]
struct Arguments {
    /// Seconds of each load, and of the measurement of the capacity
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,

    /// Loads, as multiples of the capacity
    #[arg(long, value_delimiter = ',', default_values_t = [0.5, 1.0, 2.0, 5.0, 10.0])]
    factors: Vec<f64>,

    /// Instead: minutes at 0.8 of the capacity, with clients that leave, jobs and bad requests; fails when a request
    /// does, or when memory grows by more than 5 %
    #[arg(long, value_name = "MINUTES")]
    soak: Option<f64>,

    /// Points out a second to take as the capacity, instead of measuring it
    #[arg(long)]
    capacity: Option<f64>,

    /// How much of the load each client makes: one number a client, each with an address of its own (127.0.0.2 and on)
    #[arg(long, value_delimiter = ',', default_values_t = [1.0, 1.0, 1.0, 1.0])]
    shares: Vec<f64>,

    /// Key that a client sends as `Authorization: Bearer KEY`; the first is the first client's, and so on round
    #[arg(long)]
    key: Vec<String>,

    /// Header of every request, such as `x-request-timeout: 5`
    #[arg(long, value_name = "NAME: VALUE")]
    header: Vec<String>,

    /// Seconds after which a client leaves
    #[arg(long, default_value_t = 60.0)]
    patience: f64,

    /// Chooses arrivals and clouds
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Options of `densecloud serve`
    #[arg(last = true)]
    serve: Vec<String>,
}

fn main() -> ExitCode {
    // Cargo tells every benchmark that it is one.
    let arguments = Arguments::parse_from(std::env::args().filter(|a| a != "--bench"));
    let mix = Arc::new(Mix::new());
    let server = Server::start(&arguments.serve, arguments.soak.is_some());
    let clients = Arc::new(Clients {
        address: server.address,
        shares: arguments.shares.clone(),
        keys: arguments.key.clone(),
        headers: arguments.header.clone(),
        patience: Duration::from_secs_f64(arguments.patience),
    });
    // One thread: the processors are the server's.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let passed = runtime.block_on(async {
        let capacity = match arguments.capacity {
            Some(capacity) => capacity,
            None => load::capacity(&clients, &mix, &arguments).await,
        };
        match arguments.soak {
            Some(minutes) => soak::soak(&server, &clients, &mix, capacity, minutes, arguments.seed).await,
            None => load::loads(&server, &clients, &mix, capacity, &arguments).await,
        }
    });
    let passed = server.stop() && passed;
    if passed { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
