//! What `densecloud serve` can be told, and what is wrong with it before anything is begun.

mod access;
mod jobs;
mod seconds;
#[cfg(test)]
mod tests;

use std::net::ToSocketAddrs;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::{Args, ValueEnum};
use tracing_subscriber::EnvFilter;

use super::CliError;
use super::engine_args::EngineArgs;
use super::memory::{self, Memory};
use super::settings::SettingsArgs;
use access::AccessArgs;
use densecloud_backends::Model;
use densecloud_engine::EngineConfig;
use densecloud_jobs::Settings;
use densecloud_server::{BasePath, Config, CorsOrigin, Limits, LinesLost, ModelInfo, Role, Timeouts};
use jobs::JobsArgs;
pub(super) use seconds::seconds;

/// Points out that a service takes at a time.
const QUEUE_POINTS: u64 = 50_000_000;

/// Serve over HTTP: POST a cloud to /upsample, get a denser one back.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud serve --port 8080
  curl --data-binary @scan.ply 'http://localhost:8080/upsample?ratio=4' -o dense.ply

SIGTERM and SIGINT let requests in flight finish (--drain-lead, --drain-timeout); a second one ends
at once. SIGHUP has the file of --keys read again, and ends nothing.")]
pub(super) struct ServeArgs {
    #[command(flatten)]
    pub(super) settings: SettingsArgs,

    /// Port to listen on; 0 lets the system choose one, which the log then names
    #[arg(short, long, env = "DENSECLOUD_PORT", default_value_t = 8080)]
    pub(super) port: u16,

    /// Address to listen on; 0.0.0.0 for all. Give it --keys then, or put a proxy before it
    #[arg(long, env = "DENSECLOUD_HOST", default_value = "127.0.0.1")]
    pub(super) host: String,

    #[command(flatten)]
    pub(super) engine: EngineArgs,

    /// Points in the results of all requests that are queued or worked on
    #[arg(long, env = "DENSECLOUD_QUEUE_POINTS", value_name = "N",
        default_value_t = QUEUE_POINTS)]
    queue_points: u64,

    /// The same of one client's requests; 0 is a quarter of --queue-points
    #[arg(long, env = "DENSECLOUD_CLIENT_POINTS", value_name = "N", default_value_t = 0)]
    client_points: u64,

    /// Seconds of work that waits above which no more is taken, of small and of large requests each; of one
    /// client's the same part as --client-points is of --queue-points
    #[arg(long, env = "DENSECLOUD_QUEUE_TIME", value_name = "SECONDS", value_parser = seconds,
        default_value = "15")]
    queue_time: Duration,

    /// Bytes of memory that all work at hand may take, as estimated; auto is by the machine's memory
    #[arg(long, env = "DENSECLOUD_MAX_MEMORY", value_name = "N", value_parser = memory::parse,
        default_value = "auto")]
    max_memory: Memory,

    #[command(flatten)]
    access: AccessArgs,

    /// Bytes in one request's body
    #[arg(long, env = "DENSECLOUD_MAX_BODY_BYTES", value_name = "N",
        default_value_t = Limits::default().body_bytes)]
    max_body_bytes: u64,

    /// Points in one input cloud
    #[arg(long, env = "DENSECLOUD_MAX_POINTS_IN", value_name = "N",
        default_value_t = Limits::default().points_in)]
    max_points_in: u64,

    /// Points in one result; of one that is worked on as a whole each takes about half a kilobyte of memory
    #[arg(long, env = "DENSECLOUD_MAX_POINTS_OUT", value_name = "N",
        default_value_t = Limits::default().points_out)]
    max_points_out: u64,

    /// Bytes of memory of all uploads not yet parsed and all results not yet sent
    #[arg(long, env = "DENSECLOUD_MAX_HELD_BYTES", value_name = "N",
        default_value_t = Limits::default().held_bytes)]
    max_held_bytes: u64,

    /// Where long uploads and the tiles of large clouds lie while they are worked on [default: the system's folder for
    /// temporary files]
    #[arg(long, env = "DENSECLOUD_TEMP_DIR", value_name = "DIR")]
    temp_dir: Option<PathBuf>,

    /// Bytes of the disk that these may take
    #[arg(long, env = "DENSECLOUD_MAX_TEMP_BYTES", value_name = "N",
        default_value_t = Limits::default().temp_bytes)]
    max_temp_bytes: u64,

    /// Connections open at a time; more wait in the system's backlog
    #[arg(long, env = "DENSECLOUD_MAX_CONNECTIONS", value_name = "N",
        default_value_t = Limits::default().connections)]
    max_connections: usize,

    /// The same of one address; more are closed at once. 0 is a quarter of --max-connections but 32 at
    /// least, and with --trust-forwarded no limit
    #[arg(long, env = "DENSECLOUD_CLIENT_CONNECTIONS", value_name = "N",
        default_value_t = Limits::default().client_connections)]
    client_connections: usize,

    /// How long a connection may take to send a head, from its first byte, or its own beginning
    #[arg(long, env = "DENSECLOUD_HEAD_TIMEOUT", value_name = "SECONDS", value_parser = seconds,
        default_value = "30")]
    head_timeout: Duration,

    /// How long a connection may stay open between a response and its next request
    #[arg(long, env = "DENSECLOUD_KEEP_ALIVE_TIMEOUT", value_name = "SECONDS", value_parser = seconds,
        default_value = "75")]
    keep_alive_timeout: Duration,

    /// How long an upload may stand still, or a client not read its result
    #[arg(long, env = "DENSECLOUD_STALL_TIMEOUT", value_name = "SECONDS", value_parser = seconds,
        default_value = "30")]
    stall_timeout: Duration,

    /// How long a request may take until its result is complete, upload and queueing included
    #[arg(long, env = "DENSECLOUD_REQUEST_TIMEOUT", value_name = "SECONDS", value_parser = seconds,
        default_value = "600")]
    request_timeout: Duration,

    /// How long new requests are still served after the first signal, while /readyz already says 503:
    /// as long as a load balancer takes to notice
    #[arg(long, env = "DENSECLOUD_DRAIN_LEAD", value_name = "SECONDS", value_parser = seconds,
        default_value = "0")]
    drain_lead: Duration,

    /// How long requests in flight may take once the server was told to stop
    #[arg(long, env = "DENSECLOUD_DRAIN_TIMEOUT", value_name = "SECONDS", value_parser = seconds,
        default_value = "30")]
    drain_timeout: Duration,

    #[command(flatten)]
    jobs: JobsArgs,

    /// Site whose pages may use the server from a browser, such as https://example.org, or * for all;
    /// several with commas. Without it, none
    #[arg(long, env = "DENSECLOUD_CORS_ORIGIN", value_name = "ORIGIN", value_delimiter = ',')]
    cors_origin: Vec<CorsOrigin>,

    /// Path under which a proxy offers the server, such as /clouds: links begin with it, and requests may
    #[arg(long, env = "DENSECLOUD_BASE_PATH", value_name = "PATH")]
    base_path: Option<BasePath>,

    /// What is logged to standard error: error, warn, info, debug, or a filter like `info,hyper=debug`
    #[arg(long, env = "DENSECLOUD_LOG", value_name = "FILTER", default_value = "info")]
    log: String,

    /// How it is logged
    #[arg(long, env = "DENSECLOUD_LOG_FORMAT", value_name = "FORMAT", default_value = "text")]
    pub(super) log_format: LogFormat,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum LogFormat {
    /// A line an event, for people
    Text,
    /// A JSON object an event, for collectors
    Json,
}

/// What the settings come to, all of it found to work as far as can be told without a port.
pub(super) struct Checked {
    pub(super) config: Config,
    pub(super) model: Arc<Model>,
    pub(super) filter: EnvFilter,
}

impl ServeArgs {
    /// Whether the settings are to be printed instead of used.
    pub(super) fn prints_settings(&self) -> bool {
        self.settings.print_config
    }

    /// Looks for everything that is wrong with the settings. Opens no port and writes nothing.
    ///
    /// # Errors
    /// [`CliError::Usage`] with the setting and what to do, for all that the settings are to blame for.
    pub(super) fn check(&self, role: Role) -> Result<Checked, CliError> {
        self.access.check()?;
        let model = self.engine.model().map_err(|error| match &self.engine.model {
            Some(_) => CliError::Usage(format!("{error}; --model is a folder as in models/default")),
            None => error,
        })?;
        let mut config = self.config(role);
        config.jobs = self.jobs.settings(&model)?;
        if role == Role::Worker && config.jobs.as_ref().is_none_or(|jobs| jobs.folder().is_some()) {
            return Err(CliError::Usage(
                "a worker needs --database and --store, which it shares with the servers whose jobs it works on".into(),
            ));
        }
        config.access.keys = self.access.keys()?;
        config.validate().map_err(|e| CliError::Usage(e.to_string()))?;
        self.check_host()?;
        let filter = EnvFilter::try_new(&self.log)
            .map_err(|e| CliError::Usage(format!("--log {:?}: {e}; try info or debug", self.log)))?;
        let folder = config.jobs.as_ref().and_then(Settings::folder);
        if let Some(folder) = folder.filter(|folder| folder.exists() && !folder.is_dir()) {
            let folder = folder.display();
            return Err(CliError::Usage(format!("--data-dir {folder} is a file; give it a folder")));
        }
        Ok(Checked { config, model, filter })
    }

    /// How much the engine takes at a time.
    pub(super) fn sizes(&self) -> EngineConfig {
        EngineConfig {
            threads: self.engine.threads,
            queue_points: self.queue_points,
            client_points: self.client_points,
            queue_time: Some(self.queue_time),
            memory: self.max_memory.bytes(self.max_held_bytes),
            ..Default::default()
        }
    }

    /// Whether the address can be one at all; whether it can be listened on shows when it is.
    fn check_host(&self) -> Result<(), CliError> {
        match (self.host.as_str(), self.port).to_socket_addrs() {
            // The name may be right, and its server back soon; there is no code for that, only words (glibc's, musl's).
            Err(why) if ["Temporary failure", "Try again"].iter().any(|w| why.to_string().contains(w)) => {
                Ok(())
            }
            Err(why) => Err(CliError::Usage(format!(
                "--host {:?}: {why}; give an address of this machine, such as 127.0.0.1, or 0.0.0.0 for all of them",
                self.host
            ))),
            Ok(_) => Ok(()),
        }
    }

    fn config(&self, role: Role) -> Config {
        Config {
            limits: Limits {
                body_bytes: self.max_body_bytes,
                points_in: self.max_points_in,
                points_out: self.max_points_out,
                held_bytes: self.max_held_bytes,
                temp_bytes: self.max_temp_bytes,
                connections: self.max_connections,
                client_connections: self.client_connections,
            },
            timeouts: Timeouts {
                head: self.head_timeout,
                keep_alive: self.keep_alive_timeout,
                stall: self.stall_timeout,
                request: self.request_timeout,
                lead: self.drain_lead,
                drain: self.drain_timeout,
            },
            access: self.access.access(),
            temp: self.temp_dir.clone(),
            jobs: None,
            role,
            cors: self.cors_origin.clone(),
            base_path: self.base_path.clone().unwrap_or_default(),
            files: Vec::new(),
            model: ModelInfo::default(),
            lines_lost: LinesLost::default(),
        }
    }
}
