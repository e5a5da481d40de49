//! Connections to the database, and calls that wait for it, each to a deadline.

use std::cell::Cell;
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll, Wake};
use std::thread::{self, Thread};
use std::time::Duration;

use deadpool_postgres::{
    Client, GenericClient, Hook, HookError, Manager, ManagerConfig, Pool, PoolError, RecyclingMethod,
    Transaction,
};
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::task::unconstrained;
use tokio::time::{Instant, sleep, timeout_at};
use tokio_postgres::{IsolationLevel, NoTls};

use super::address::{Address, Host};
use super::clock::{DatabaseClock, TIME};
use super::connector::Connector;
use super::password::Password;
use super::tls;
use super::trouble::{Failed, failed, lost, passes};
use crate::error::{StoreError, Trouble};

/// How the database is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Connections that are open at most, beside one that listens.
    pub connections: usize,
    /// How long a call takes at most: what the database has not answered by then is an error.
    pub deadline: Duration,
}

impl Default for Limits {
    /// Eight connections, five seconds.
    fn default() -> Self {
        Self { connections: 8, deadline: Duration::from_secs(5) }
    }
}

/// Attempts at a call whose connection is lost.
const ATTEMPTS: u32 = 4;
/// Before the second attempt; twice as long before each later one.
const PAUSE: Duration = Duration::from_millis(20);

/// A database, as long as this is there.
pub(super) struct Database {
    // None only while it is dropped.
    runtime: Option<Runtime>,
    pool: Pool,
    connector: Connector,
    pub(super) clock: Arc<DatabaseClock>,
    deadline: Duration,
}

/// How far a call is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Nothing of it will stay where it ends now.
    Open,
    /// The database has been told to keep it, and has not said that it did.
    Keeping,
}

impl Database {
    /// Connects to nothing so far.
    ///
    /// # Errors
    /// The system gives no threads, or the certificates cannot be read.
    pub(super) fn new(address: &Address, password: Option<&Password>, limits: Limits) -> io::Result<Self> {
        let mut config = address.config();
        // A server that is gone without a word is missed, by whoever listens, too.
        config.connect_timeout(limits.deadline).tcp_user_timeout(2 * limits.deadline);
        config
            .keepalives_idle(2 * limits.deadline)
            .keepalives_interval(limits.deadline)
            .keepalives_retries(2);
        password.map(|password| config.password(password.reveal()));
        let tls = match &address.host {
            Host::Network { tls: Some(roots), .. } => Some(tls::connector(roots)?),
            _ => None,
        };
        let recycling = ManagerConfig { recycling_method: RecyclingMethod::Fast };
        let manager = match tls.clone() {
            Some(tls) => Manager::from_config(config.clone(), tls, recycling),
            None => Manager::from_config(config.clone(), NoTls, recycling),
        };
        let begin = begin(&address.schema, limits.deadline);
        let pool = Pool::builder(manager).max_size(limits.connections).post_create(Hook::async_fn(
            move |client, _| {
                let begin = begin.clone();
                Box::pin(async move { client.batch_execute(&begin).await.map_err(HookError::Backend) })
            },
        ));
        let mut runtime = Builder::new_multi_thread();
        runtime.worker_threads(1).thread_name("densecloud-database").enable_all();
        Ok(Self {
            runtime: Some(runtime.build()?),
            pool: pool.build().map_err(io::Error::other)?,
            connector: Connector { config, tls, schema: address.schema.clone(), deadline: limits.deadline },
            clock: Arc::default(),
            deadline: limits.deadline,
        })
    }

    pub(super) fn runtime(&self) -> &Handle {
        self.runtime.as_ref().expect("there until it is dropped").handle()
    }

    pub(super) fn connector(&self) -> Connector {
        self.connector.clone()
    }

    /// A question, asked again where the connection is lost meanwhile.
    pub(super) fn read<T>(
        &self,
        question: impl AsyncFn(&Client) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        let stage = Cell::new(Stage::Open);
        self.within(&stage, async |_| {
            let client = self.client().await?;
            let answer = question(&client).await;
            client.give_back(answer)
        })
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

    /// As [`Database::write`], but for what cannot tell whether it has happened, and locks the totals itself.
    pub(super) fn write_once<T>(
        &self,
        change: impl AsyncFn(&Transaction<'_>) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        let stage = Cell::new(Stage::Open);
        self.within(&stage, async |again| {
            if again {
                return Err(Failed::Refused(unsure("it was cut off")));
            }
            self.change(&stage, async |transaction| change(transaction).await).await
        })
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
        if !matches!(&changed, Err(Failed::Database(error)) if lost(error)) {
            stage.set(Stage::Open);
        }
        client.give_back(changed)
    }

    /// Whoever changes anything has this row: so changes come one after another, and no two wait for each other. It
    /// tells the time, too.
    async fn lock(&self, transaction: &Transaction<'_>) -> Result<(), Failed> {
        let lock = transaction.prepare_cached(&format!("{TIME} FROM totals FOR UPDATE")).await?;
        let asked = std::time::Instant::now();
        self.clock.set(transaction.query_one(&lock, &[]).await?.try_get(0)?, asked);
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

    async fn client(&self) -> Result<Lent, Failed> {
        match self.pool.get().await {
            Ok(client) => Ok(Lent { client: Some(client) }),
            Err(PoolError::Backend(error) | PoolError::PostCreateHook(HookError::Backend(error))) => {
                // Whoever cannot be reached now is not asked again at once.
                Err(Failed::Refused(failed(error)))
            }
            Err(error) => Err(Failed::Refused(away(error))),
        }
    }
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

impl Drop for Database {
    fn drop(&mut self) {
        // Whoever drops it may be where nothing may wait.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// A connection of the pool. It is closed, not given back, where its caller does not wait for its answer any more.
struct Lent {
    client: Option<Client>,
}

impl Lent {
    fn get(&mut self) -> &mut Client {
        self.client.as_mut().expect("there until it is dropped")
    }

    /// Gives it back if it works.
    fn give_back<T>(mut self, answer: Result<T, Failed>) -> Result<T, Failed> {
        if !matches!(answer, Err(Failed::Database(_))) {
            drop(self.client.take());
        }
        answer
    }
}

impl std::ops::Deref for Lent {
    type Target = Client;

    fn deref(&self) -> &Client {
        self.client.as_ref().expect("there until it is dropped")
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        self.client.take().map(Client::take);
    }
}

/// What each connection begins with. What is said to be kept is on the disk, whatever the server's settings say.
fn begin(schema: &str, deadline: Duration) -> String {
    // A little less, so that a wait for others is told as one.
    let milliseconds = (deadline * 3 / 4).as_millis();
    format!(
        "SET search_path = {schema}; SET statement_timeout = {milliseconds}; \
         SET idle_in_transaction_session_timeout = {milliseconds}; \
         SET default_transaction_isolation = 'read committed'; \
         SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'"
    )
}

fn away(why: impl ToString) -> StoreError {
    StoreError::Database { trouble: Trouble::Away, source: why.to_string().into() }
}

fn unsure(why: impl ToString) -> StoreError {
    StoreError::Database { trouble: Trouble::Unsure, source: why.to_string().into() }
}
