//! Calls that wait for the database, each to a deadline.

use std::cell::Cell;
use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll, Wake};
use std::thread::{self, Thread};
use std::time::Duration;

use deadpool_postgres::{Client, GenericClient, Transaction};
use tokio::task::unconstrained;
use tokio::time::{Instant, sleep, timeout_at};
use tokio_postgres::{IsolationLevel, Row};

use super::clock::TIME;
use super::connection::Database;
use super::rows::Values;
use super::trouble::{Failed, away, failed, lost, passes, unsure, whole};
use crate::error::{StoreError, Trouble};

/// Attempts at a call whose connection is lost.
const ATTEMPTS: u32 = 4;
/// Before the second attempt; twice as long before each later one.
const PAUSE: Duration = Duration::from_millis(20);

/// Waits for the lock that whoever changes anything has: so changes come one after another, and no two wait for each other. It
/// is given in the order in which it is asked for, which that of a row is not.
const TURN: &str = "SELECT pg_advisory_xact_lock('totals'::regclass::bigint)";
/// Begins a change that others see, and go on from, before it is on the disk.
const BEGIN: &str = "BEGIN; SET LOCAL synchronous_commit = off; \
                     SELECT pg_advisory_xact_lock('totals'::regclass::bigint)";
/// Is answered when all that was kept before is on the disk, and wherever else the server's settings want it.
const FLUSH: &str = "SELECT pg_logical_emit_message(true, 'densecloud', '')";

/// How far a call is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Nothing of it will stay where it ends now.
    Open,
    /// The database has been told to keep it, and has not said that it did.
    Keeping,
}

impl Database {
    /// A question, asked again where the connection is lost meanwhile.
    pub(super) fn read<T>(
        &self,
        question: impl AsyncFn(&Client) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        self.within(&Cell::new(Stage::Open), async |_| self.ask(&question).await)
    }

    async fn ask<T>(&self, question: &impl AsyncFn(&Client) -> Result<T, Failed>) -> Result<T, Failed> {
        let client = self.client().await?;
        let answer = question(&client).await;
        client.give_back(answer)
    }

    /// Several questions at one moment: what happens between them is not seen.
    pub(super) fn look<T>(
        &self,
        questions: impl AsyncFn(&Transaction<'_>) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        self.within(&Cell::new(Stage::Open), async |_| {
            let mut client = self.client().await?;
            let answer = async {
                let moment = client.get().build_transaction().isolation_level(IsolationLevel::RepeatableRead);
                let transaction = moment.read_only(true).start().await?;
                let answer = questions(&transaction).await?;
                transaction.commit().await?;
                Ok(answer)
            }
            .await;
            client.give_back(answer)
        })
    }

    /// A change, with no other beside it: all of it, or nothing. Where it is not known whether it was kept, it is tried
    /// again, and told so by `true`: it may find that it has happened.
    pub(super) fn write<T>(
        &self,
        change: impl AsyncFn(&Transaction<'_>, bool) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        let stage = Cell::new(Stage::Open);
        self.within(&stage, async |again| {
            let locked = async |transaction: &Transaction<'_>| {
                self.lock(transaction).await?;
                change(transaction, again).await
            };
            self.change(&stage, locked).await
        })
    }

    /// As [`Database::write`], for a change of one statement that returns a row of each that it changed: says whether there
    /// is one. Others wait for the database's work at it alone, neither for the network nor for the disk. Where it is not
    /// known whether it was kept, it is tried again, and then `happened` is asked, where nothing was left to change.
    pub(super) fn set(
        &self,
        sql: &str,
        values: Values<'_>,
        happened: impl AsyncFn(&Client) -> Result<bool, Failed>,
    ) -> Result<bool, StoreError> {
        let stage = Cell::new(Stage::Open);
        self.within(&stage, async |again| {
            let changed = !self.at_once(&stage, sql, values).await?.is_empty();
            Ok(changed || again && self.ask(&happened).await?)
        })
    }

    /// As [`Database::set`], but gives the rows, and is not tried again where it may have been kept.
    pub(super) fn take<T>(
        &self,
        sql: &str,
        values: Values<'_>,
        read: impl Fn(&Row) -> Result<T, Failed>,
    ) -> Result<Vec<T>, StoreError> {
        let stage = Cell::new(Stage::Open);
        self.within(&stage, async |again| {
            if again {
                return Err(Failed::Refused(unsure("it was cut off")));
            }
            self.at_once(&stage, sql, values).await?.iter().map(&read).collect()
        })
    }

    /// Sends all of a change together, and then waits for the disk, when others already have the lock.
    async fn at_once(&self, stage: &Cell<Stage>, sql: &str, values: Values<'_>) -> Result<Vec<Row>, Failed> {
        let client = self.client().await?;
        let changed = async {
            let lock = client.prepare_cached(&lock()).await?;
            let change = client.prepare_cached(sql).await?;
            let asked = std::time::Instant::now();
            stage.set(Stage::Keeping);
            // In this order, each before the one before it is answered.
            let (begun, locked, changed, kept, flushed) = tokio::join!(
                biased;
                client.batch_execute(BEGIN),
                client.query_one(&lock, &[]),
                client.query(&change, values),
                client.batch_execute("COMMIT"),
                client.batch_execute(FLUSH),
            );
            begun?;
            self.clock.set(locked?.try_get(0)?, asked);
            let changed = changed?;
            kept?;
            flushed.map_err(not_flushed)?;
            Ok(changed)
        }
        .await;
        known(stage, &changed);
        client.give_back(changed)
    }

    async fn change<T>(
        &self,
        stage: &Cell<Stage>,
        change: impl AsyncFn(&Transaction<'_>) -> Result<T, Failed>,
    ) -> Result<T, Failed> {
        let mut client = self.client().await?;
        let changed = async {
            let transaction = client.get().transaction().await?;
            let value = change(&transaction).await?;
            stage.set(Stage::Keeping);
            transaction.commit().await?;
            Ok(value)
        }
        .await;
        known(stage, &changed);
        client.give_back(changed)
    }

    async fn lock(&self, transaction: &Transaction<'_>) -> Result<(), Failed> {
        let lock = transaction.prepare_cached(&lock()).await?;
        let asked = std::time::Instant::now();
        let (turn, locked) =
            tokio::join!(biased; transaction.batch_execute(TURN), transaction.query_one(&lock, &[]));
        turn?;
        self.clock.set(locked?.try_get(0)?, asked);
        Ok(())
    }

    /// Makes sure of the tables; nobody else works with them so far.
    pub(super) fn prepare<T>(
        &self,
        change: impl AsyncFn(&Transaction<'_>) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        self.within(&Cell::new(Stage::Open), async |_| {
            let mut client = self.client().await?;
            let changed = async {
                let transaction = client.get().transaction().await?;
                let value = change(&transaction).await?;
                transaction.commit().await?;
                Ok(value)
            }
            .await;
            client.give_back(changed)
        })
    }

    /// Does something until it has an answer, or the deadline is over. `again` is whether an earlier attempt may
    /// have been kept.
    fn within<T>(
        &self,
        stage: &Cell<Stage>,
        attempt: impl AsyncFn(bool) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        let kept = Cell::new(false);
        let all = async {
            let mut pause = PAUSE;
            for count in 1.. {
                let outcome = attempt(kept.get()).await;
                kept.set(kept.get() || stage.get() == Stage::Keeping);
                match outcome {
                    Ok(value) => return Ok(value),
                    Err(Failed::Database(error)) if passes(&error) && count < ATTEMPTS => {
                        tracing::debug!(%error, "the database is asked again");
                    }
                    Err(Failed::Database(error)) => return Err(failed(error)),
                    Err(Failed::Refused(error)) => return Err(error),
                }
                stage.set(Stage::Open);
                sleep(pause).await;
                pause *= 2;
            }
            unreachable!("it counts to the last attempt")
        };
        let answer = {
            let _context = self.runtime().enter();
            wait(timeout_at(Instant::now() + self.deadline, all))
        };
        let unknown = kept.get() || stage.get() == Stage::Keeping;
        match answer {
            Ok(Err(StoreError::Database { trouble: Trouble::Away, source })) if unknown => {
                Err(StoreError::Database { trouble: Trouble::Unsure, source })
            }
            Ok(answer) => answer,
            Err(_) if unknown => Err(unsure("it has not answered in time")),
            Err(_) => Err(away("it has not answered in time")),
        }
    }
}

/// Locks the row that most changes change, since programs of the first version know no other lock. It tells the time, too.
fn lock() -> String {
    format!("{TIME} FROM totals FOR UPDATE")
}

/// Whatever the database answered, it is known what became of a change.
fn known<T>(stage: &Cell<Stage>, changed: &Result<T, Failed>) {
    if !matches!(changed, Err(Failed::Database(error)) if lost(error)) {
        stage.set(Stage::Open);
    }
}

/// A change was kept, and it is not known whether it is on the disk.
fn not_flushed(error: tokio_postgres::Error) -> Failed {
    if lost(&error) { error.into() } else { unsure(whole(&error)).into() }
}

/// Waits on this thread, whatever it is: a runtime's own wait refuses to where another runtime's work is done.
fn wait<T>(future: impl Future<Output = T>) -> T {
    struct Parked(Thread);
    impl Wake for Parked {
        fn wake(self: Arc<Self>) {
            self.0.unpark();
        }
    }
    let waker = Arc::new(Parked(thread::current())).into();
    let mut context = Context::from_waker(&waker);
    // Whose turn it is in that runtime is not ours to keep to.
    let mut future = pin!(unconstrained(future));
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        thread::park();
    }
}
