//! Connections to the database.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use deadpool_postgres::{Client, Hook, HookError, Manager, ManagerConfig, Pool, PoolError, RecyclingMethod};
use tokio::runtime::{Builder, Handle, Runtime};
use tokio_postgres::NoTls;

use super::address::{Address, Host};
use super::clock::DatabaseClock;
use super::connector::Connector;
use super::password::Password;
use super::tls;
use super::trouble::{Failed, away, failed};

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

/// A database, as long as this is there.
pub(super) struct Database {
    // None only while it is dropped.
    runtime: Option<Runtime>,
    pool: Pool,
    connector: Connector,
    pub(super) clock: Arc<DatabaseClock>,
    pub(super) deadline: Duration,
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

    /// One of them, until it is given back.
    pub(super) async fn client(&self) -> Result<Lent, Failed> {
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

impl Drop for Database {
    fn drop(&mut self) {
        // Whoever drops it may be where nothing may wait.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// A connection of the pool. It is closed, not given back, where its caller does not wait for its answer any more.
pub(super) struct Lent {
    client: Option<Client>,
}

impl Lent {
    pub(super) fn get(&mut self) -> &mut Client {
        self.client.as_mut().expect("there until it is dropped")
    }

    /// Gives it back if it works.
    pub(super) fn give_back<T>(mut self, answer: Result<T, Failed>) -> Result<T, Failed> {
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
