//! What the server may be asked to bear, checked before a port is bound.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::admission::client::Access;
use crate::connection::content::IN_MEMORY;
use crate::connection::cors::CorsOrigin;
use crate::connection::prefix::BasePath;
use crate::http::download::result_bytes;
use densecloud_backends::ModelName;
use densecloud_cascade::MAX_RATIO;
use densecloud_formats::Format;
use densecloud_jobs::Settings;
use densecloud_tiles::TILE_POINTS;

/// Connections of one address where nothing is said of them: browsers open several, each for many requests.
const LEAST_CONNECTIONS: usize = 32;

/// All settings of a server. [`Config::default`] suits one machine behind a reverse proxy.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Config {
    /// How much.
    pub limits: Limits,
    /// How long.
    pub timeouts: Timeouts,
    /// Who may ask.
    pub access: Access,
    /// Where long uploads and the tiles of large clouds lie while they are worked on (`--temp-dir`); the system's folder for
    /// temporary files where nobody says.
    pub temp: Option<PathBuf>,
    /// Whether and how jobs are kept; none without a folder (`--data-dir`), or a database and a store that several programs
    /// share.
    pub jobs: Option<Settings>,
    /// What it is there for.
    pub role: Role,
    /// The sites whose pages may use the server from a browser (`--cors-origin`); none by default.
    pub cors: Vec<CorsOrigin>,
    /// The path under which a proxy offers the server (`--base-path`); none by default.
    pub base_path: BasePath,
    /// Files that whoever may use the server may read (`densecloud view`), by their numbers; none by default.
    pub files: Vec<PathBuf>,
    /// Which model answers, for `/metrics`.
    pub model: ModelInfo,
    /// Lines that the log has lost, for `/metrics`: whoever writes the log counts them.
    pub lines_lost: LinesLost,
}

/// What a program is there for, of those that share jobs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Role {
    /// It takes requests, and works on jobs, too, where it keeps any.
    #[default]
    Server,
    /// It works on jobs; over HTTP it tells of its health and its figures alone.
    Worker,
}

/// A count of lines that could not be written; clones count together.
#[derive(Debug, Clone, Default)]
pub struct LinesLost(Arc<AtomicU64>);

/// Whether nobody would work on jobs without threads for them: none else shares them, or this is a worker.
fn needs_workers(config: &Config, jobs: &Settings) -> bool {
    jobs.folder().is_some() || config.role == Role::Worker
}

impl LinesLost {
    /// One more.
    pub fn add(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// How many so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl PartialEq for LinesLost {
    fn eq(&self, other: &Self) -> bool {
        self.count() == other.count()
    }
}

/// How much a request, and all requests together, may take.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Limits {
    /// Bytes in one request's body (`--max-body-bytes`).
    pub body_bytes: u64,
    /// Points in one input cloud (`--max-points-in`).
    pub points_in: u64,
    /// Points in one result (`--max-points-out`).
    pub points_out: u64,
    /// Bytes of memory of all uploads not yet parsed and all results not yet sent (`--max-held-bytes`).
    pub held_bytes: u64,
    /// Bytes of the disk that long uploads and the tiles of large clouds may take (`--max-temp-bytes`).
    pub temp_bytes: u64,
    /// Connections open at a time (`--max-connections`); more wait in the system's backlog.
    pub connections: usize,
    /// Those of one address (`--client-connections`); more are closed. 0 is a quarter of all, and 32 at least.
    pub client_connections: usize,
}

/// How long the server waits for whom.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Timeouts {
    /// For the head of a request, from its first byte, or the connection's beginning (`--head-timeout`).
    pub head: Duration,
    /// Between a response and the next request of a connection (`--keep-alive-timeout`).
    pub keep_alive: Duration,
    /// For the next piece of an upload, and for a reader to take the next piece of a result
    /// (`--stall-timeout`).
    pub stall: Duration,
    /// From a request's head to its complete result, upload and queueing included
    /// (`--request-timeout`).
    pub request: Duration,
    /// Between the first signal, from which on `/readyz` says 503, and the moment when new work is
    /// refused (`--drain-lead`).
    pub lead: Duration,
    /// For requests in flight when the server is told to stop (`--drain-timeout`).
    pub drain: Duration,
}

/// The model as `/metrics` names it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ModelInfo {
    /// Its name and its weights.
    pub name: ModelName,
    /// Where it runs: `cpu`, for example.
    pub provider: String,
}

/// A setting, or two together, that cannot work.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// Nothing would ever be answered.
    #[error("{setting} is 0, so every request would be refused; give it a positive value")]
    Zero {
        /// The setting as typed at the command line.
        setting: &'static str,
    },
    /// One of two makes the other pointless.
    #[error("--cors-origin * lets every site in, so the others say nothing; drop the * or the others")]
    EveryOriginAndMore,
    /// One request within its own limit could never be admitted.
    #[error(
        "{setting} lets one request hold {bytes} bytes, but --max-held-bytes is {held}; raise \
         --max-held-bytes or lower {setting}"
    )]
    HeldTooSmall {
        /// The setting that asks for more.
        setting: &'static str,
        /// How much it lets one request hold.
        bytes: u64,
        /// What all requests together may hold.
        held: u64,
    },
}

impl Config {
    /// Where temporary files lie.
    pub(crate) fn temp_dir(&self) -> PathBuf {
        self.temp.clone().unwrap_or_else(std::env::temp_dir)
    }

    /// Connections that one address may have open. Behind a proxy all have its address.
    pub(super) fn client_connections(&self) -> usize {
        match self.limits.client_connections {
            0 if self.access.trust_forwarded => self.limits.connections,
            0 => (self.limits.connections / 4).max(LEAST_CONNECTIONS),
            set => set,
        }
    }

    /// Checks that a request within all limits can be answered.
    ///
    /// # Errors
    /// See [`ConfigError`].
    pub fn validate(&self) -> Result<(), ConfigError> {
        let Limits {
            body_bytes,
            points_in,
            points_out,
            held_bytes,
            temp_bytes,
            connections,
            client_connections: _,
        } = self.limits;
        let Timeouts { head, keep_alive, stall, request, lead: _, drain: _ } = self.timeouts;
        for (setting, zero) in [
            ("--max-body-bytes", body_bytes == 0),
            ("--max-points-in", points_in == 0),
            ("--max-points-out", points_out == 0),
            ("--max-temp-bytes", temp_bytes == 0),
            ("--max-connections", connections == 0),
            ("--head-timeout", head.is_zero()),
            ("--keep-alive-timeout", keep_alive.is_zero()),
            ("--stall-timeout", stall.is_zero()),
            ("--request-timeout", request.is_zero()),
            (
                "--jobs-running",
                self.jobs.as_ref().is_some_and(|jobs| jobs.running == 0 && needs_workers(self, jobs)),
            ),
            ("--job-lease", self.jobs.as_ref().is_some_and(|jobs| jobs.lease.is_zero())),
            ("--max-jobs", self.jobs.as_ref().is_some_and(|jobs| jobs.queued == 0)),
            ("--client-jobs", self.jobs.as_ref().is_some_and(|jobs| jobs.client_queued == 0)),
            ("--job-attempts", self.jobs.as_ref().is_some_and(|jobs| jobs.attempts == 0)),
        ] {
            if zero {
                return Err(ConfigError::Zero { setting });
            }
        }
        if self.cors.len() > 1 && self.cors.contains(&CorsOrigin::Any) {
            return Err(ConfigError::EveryOriginAndMore);
        }
        // More of a body lies on the disk, and a larger result is sent tile by tile.
        let (in_memory, whole) = (IN_MEMORY as u64, u64::from(MAX_RATIO) * TILE_POINTS);
        for (setting, bytes) in [
            ("--max-body-bytes", body_bytes.min(in_memory)),
            ("--max-points-out", result_bytes(points_out.min(whole), 0, Format::TEXT)),
        ] {
            if bytes > held_bytes {
                return Err(ConfigError::HeldTooSmall { setting, bytes, held: held_bytes });
            }
        }
        Ok(())
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            body_bytes: 1 << 30,
            points_in: 10_000_000,
            points_out: 40_000_000,
            held_bytes: 2 << 30,
            temp_bytes: 32 << 30,
            connections: 1024,
            client_connections: 0,
        }
    }
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            head: Duration::from_secs(30),
            keep_alive: Duration::from_secs(75),
            stall: Duration::from_secs(30),
            request: Duration::from_secs(600),
            lead: Duration::ZERO,
            drain: Duration::from_secs(30),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(Config::default().validate(), Ok(()));
    }

    #[test]
    fn a_limit_of_nothing_is_refused_by_name() {
        let mut config = Config::default();
        config.limits.points_in = 0;
        let error = config.validate().expect_err("no points");
        assert!(error.to_string().contains("--max-points-in"), "{error}");
        config = Config::default();
        config.timeouts.head = Duration::ZERO;
        assert_eq!(config.validate(), Err(ConfigError::Zero { setting: "--head-timeout" }));
    }

    #[test]
    fn one_request_at_its_limits_must_fit_into_what_all_may_hold() {
        let mut config = Config::default();
        config.limits.held_bytes = IN_MEMORY as u64 - 1;
        let error = config.validate().expect_err("too small");
        assert!(error.to_string().contains("--max-held-bytes"), "{error}");
        config = Config::default();
        config.limits.held_bytes = 64 << 20;
        assert!(matches!(config.validate(), Err(ConfigError::HeldTooSmall { .. })));
        config.limits.points_out = 2_000_000;
        assert_eq!(config.validate(), Ok(()));
        // What is larger is neither held as a whole.
        let limits = &mut config.limits;
        (limits.body_bytes, limits.points_out, limits.held_bytes) = (u64::MAX, u64::MAX, 2 << 30);
        assert_eq!(config.validate(), Ok(()));
    }
}
