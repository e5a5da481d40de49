//! What the database tells: that somebody changed something.

use std::collections::HashSet;
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{sleep, timeout};

use super::connection::Database;
use super::connector::Connector;
use super::trouble::whole;
use crate::records::Change;

type Wake = Arc<dyn Fn(Change) + Send + Sync>;

/// Before a connection that was lost is made anew; twice as long after each that fails, up to the other.
const PAUSES: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(5)];
/// How long nothing is told before it is looked whether the server is there.
const SILENCE: Duration = Duration::from_secs(15);

/// Listens as long as the database is there.
pub(super) fn start(database: &Database, wake: Wake) {
    let connector = database.connector();
    database.runtime().spawn(async move {
        let mut pause = PAUSES[0];
        loop {
            let mut heard = false;
            if let Err(error) = listen(&connector, &wake, &mut heard).await {
                tracing::warn!(
                    error = whole(&*error),
                    "the database tells nothing; it is asked now and then"
                );
            }
            pause = if heard { PAUSES[0] } else { PAUSES[1].min(2 * pause) };
            sleep(pause).await;
        }
    });
}

/// Until the connection is lost. `heard` is whether there was one.
async fn listen(
    connector: &Connector,
    wake: &Wake,
    heard: &mut bool,
) -> Result<(), Box<dyn Error + Send + Sync>> {
    let mut tasks = JoinSet::new();
    let (teller, mut told) = unbounded_channel();
    let client = timeout(connector.deadline, connector.connect(&mut tasks, teller)).await??;
    timeout(connector.deadline, client.batch_execute(&format!("LISTEN {}", connector.schema))).await??;
    *heard = true;
    // Whatever happened before is not told.
    pass_on(wake, HashSet::from([Change::Waits, Change::Other])).await?;
    loop {
        match timeout(SILENCE, told.recv()).await {
            Ok(Some(first)) => pass_on(wake, gather(first, &mut told)).await?,
            Ok(None) => return Err("the connection is lost".into()),
            Err(_) => timeout(connector.deadline, client.batch_execute("")).await??,
        }
    }
}

/// What has been told meanwhile, each once.
fn gather(first: String, told: &mut UnboundedReceiver<String>) -> HashSet<Change> {
    let mut changes = HashSet::from([change(&first)]);
    while let Ok(next) = told.try_recv() {
        changes.insert(change(&next));
    }
    changes
}

/// Whatever a later version tells is something.
fn change(told: &str) -> Change {
    match told.split_once(' ') {
        None if told == "waits" => Change::Waits,
        Some(("over", id)) => Change::Over(id.to_owned()),
        _ => Change::Other,
    }
}

/// On a thread that may wait: this one must go on, or nobody hears of the database.
async fn pass_on(wake: &Wake, changes: HashSet<Change>) -> Result<(), tokio::task::JoinError> {
    let wake = Arc::clone(wake);
    spawn_blocking(move || changes.into_iter().for_each(|change| wake(change))).await
}
