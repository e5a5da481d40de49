//! What the tests keep jobs in: each test runs over all of them.

use std::ops::Deref;
use std::sync::Arc;
use std::time::Duration;

use tempfile::TempDir;

use super::*;

/// A database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Engine {
    Sqlite,
    Postgres,
}

/// Makes a test of each function for each engine: over a [`Bench`], or what `|bench| …` makes of one. Those over
/// Postgres are run by `make test`, which starts one.
macro_rules! over_each_engine {
    (|$bench:ident| $subject:expr => $($name:ident),* $(,)?) => {
        mod sqlite {
            use super::*;

            $(
                #[test]
                fn $name() {
                    let $bench = Bench::of(crate::tests::engine::Engine::Sqlite);
                    super::$name($subject);
                }
            )*
        }

        mod postgres {
            use super::*;

            $(
                #[test]
                #[ignore = "needs scripts/with-services.sh"]
                fn $name() {
                    let $bench = Bench::of(crate::tests::engine::Engine::Postgres);
                    super::$name($subject);
                }
            )*
        }
    };
    ($($name:ident),* $(,)?) => {
        over_each_engine!(|bench| bench => $($name),*);
    };
}
pub(super) use over_each_engine;

/// A folder, and a database of its own, in it or elsewhere, that goes with it.
pub(super) struct Bench {
    folder: TempDir,
    pub(super) engine: Engine,
}

/// Of the server that `scripts/with-services.sh` starts, and a schema of it.
fn address(schema: &str) -> (String, Password) {
    let set = |name| {
        std::env::var(name).unwrap_or_else(|_| {
            panic!(
                "{name} is not set: run this by `sh scripts/with-services.sh cargo test … -- --include-ignored`"
            )
        })
    };
    (format!("{}&schema={schema}", set("DENSECLOUD_TEST_POSTGRES")), set("PGPASSWORD").into())
}

impl Bench {
    pub(super) fn of(engine: Engine) -> Self {
        Self { folder: tempfile::tempdir().expect("a folder"), engine }
    }

    /// Of small letters, since Postgres knows no others without quotes.
    pub(super) fn schema(&self) -> String {
        format!("test{}", hex::encode(self.path().file_name().expect("a name").as_encoded_bytes()))
    }

    /// Records that are there, or new ones.
    pub(super) fn records(&self, bounds: Bounds) -> Arc<dyn Records> {
        match self.engine {
            Engine::Sqlite => Arc::new(Sqlite::open(self.path(), bounds).expect("a database")),
            Engine::Postgres => Arc::new(self.postgres(self.port(), "kind", bounds)),
        }
    }

    /// Records in Postgres, of programs of a kind that ask for it at this port.
    pub(super) fn postgres(&self, port: u16, kind: &str, bounds: Bounds) -> Postgres {
        let (address, password) = self.address(port);
        let limits = Limits { connections: 4, deadline: Duration::from_secs(3) };
        Postgres::open(&address, Some(&password), limits, kind, bounds).expect("a database")
    }

    pub(super) fn address(&self, port: u16) -> (Address, Password) {
        let (text, password) = address(&self.schema());
        let other = text.replace(&format!(":{}/", self.port()), &format!(":{port}/"));
        (Address::parse(&other).expect("an address"), password)
    }

    /// Of the server.
    pub(super) fn port(&self) -> u16 {
        let (text, _) = address(&self.schema());
        let (_, rest) = text.rsplit_once(':').expect("a port");
        rest.split('/').next().expect("a port").parse().expect("a port")
    }

    /// Has Postgres do statements, in this bench's schema.
    pub(super) fn execute(&self, sql: &str) -> Result<(), StoreError> {
        let (address, password) = self.address(self.port());
        Postgres::execute(&address, &password, sql)
    }

    /// A store by itself, as after a start.
    pub(super) fn store(&self, bounds: Bounds, now: Time) -> Store {
        match self.engine {
            Engine::Sqlite => Store::open(self.path(), bounds, now).expect("a store"),
            Engine::Postgres => {
                let files = Folder::open(self.path().join("files")).expect("a folder");
                Store::alone(self.records(bounds), Arc::new(files), now).expect("a store")
            }
        }
    }

    pub(super) fn jobs(&self, settings: Settings) -> Jobs {
        let store = self.store(settings.bounds(), SystemClock.now());
        Jobs::new(store, settings, Arc::new(SystemClock))
    }
}

impl Deref for Bench {
    type Target = TempDir;

    fn deref(&self) -> &TempDir {
        &self.folder
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        if self.engine == Engine::Postgres {
            let erased = self.execute(&format!("DROP SCHEMA IF EXISTS {} CASCADE", self.schema()));
            assert!(erased.is_ok() || std::thread::panicking(), "{erased:?}");
        }
    }
}
