//! What `densecloud serve` can be told, and what is wrong with it before anything is begun.

use std::net::ToSocketAddrs;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use clap::{Args, ValueEnum};
use tracing_subscriber::EnvFilter;

use super::CliError;
use super::engine_args::EngineArgs;
use super::memory::{self, Memory};
use super::settings::SettingsArgs;
use densecloud_backends::Model;
use densecloud_engine::EngineConfig;
use densecloud_jobs::{Keeping, Password, Settings};
use densecloud_server::{
    Access, BasePath, Config, CorsOrigin, Keys, Limits, LinesLost, ModelInfo, Role, Timeouts,
};

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

/// Jobs: work that outlives requests, and the server.
#[derive(Debug, Args)]
struct JobsArgs {
    /// Folder in which jobs are kept; without it there are none
    #[arg(long, env = "DENSECLOUD_DATA_DIR", value_name = "DIR")]
    data_dir: Option<PathBuf>,

    /// Database that servers and workers share instead of a folder, such as postgres://user@host/name
    #[arg(long, env = "DENSECLOUD_DATABASE", value_name = "ADDRESS")]
    database: Option<String>,

    /// File whose first line is its password, and that not everybody can read; without it the password is in PGPASSWORD or
    /// PGPASSFILE
    #[arg(long, env = "DENSECLOUD_DATABASE_PASSWORD_FILE", value_name = "FILE")]
    database_password_file: Option<PathBuf>,

    /// Store that they share for clouds and results, such as s3://bucket/prefix, or a folder that all of them see; what it
    /// takes to reach it is in AWS_ACCESS_KEY_ID and the like
    #[arg(long, env = "DENSECLOUD_STORE", value_name = "ADDRESS")]
    store: Option<String>,

    /// How long a worker may be silent before its step of a job is given to another; with --database
    #[arg(long, env = "DENSECLOUD_JOB_LEASE", value_name = "SECONDS", value_parser = seconds,
        default_value = "30")]
    job_lease: Duration,

    /// Steps of jobs that run here at a time; 0 where others work on them
    #[arg(long, env = "DENSECLOUD_JOBS_RUNNING", value_name = "N", default_value_t = 1)]
    jobs_running: usize,

    /// How long a job is kept when it has come to its end, with its result
    #[arg(long, env = "DENSECLOUD_JOB_EXPIRY", value_name = "SECONDS", value_parser = seconds,
        default_value = "86400")]
    job_expiry: Duration,

    /// Bytes of the disk that all jobs may take: clouds until they are done, results after
    #[arg(long, env = "DENSECLOUD_JOB_DISK", value_name = "N", default_value_t = 10 << 30)]
    job_disk: u64,

    /// Jobs that may be queued or running
    #[arg(long, env = "DENSECLOUD_MAX_JOBS", value_name = "N", default_value_t = 1000)]
    max_jobs: u64,

    /// The same of one client
    #[arg(long, env = "DENSECLOUD_CLIENT_JOBS", value_name = "N", default_value_t = 100)]
    client_jobs: u64,

    /// How often a job is started, when the server ends under it, before it counts as failed
    #[arg(long, env = "DENSECLOUD_JOB_ATTEMPTS", value_name = "N", default_value_t = 3)]
    job_attempts: u32,
}

impl JobsArgs {
    /// What this process shares with others.
    fn shared(&self, database: &str, store: &str, model: &Model) -> Result<Keeping, CliError> {
        let host = gethostname::gethostname();
        // A container's first process always has the same number.
        let started = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let name = model.name();
        Ok(Keeping::Shared {
            database: database.to_owned(),
            password: self.password()?,
            store: store.to_owned(),
            process: format!("{}, process {}, {:x}", host.display(), std::process::id(), started.as_millis()),
            kind: format!("{}, {} {}, {}", env!("CARGO_PKG_VERSION"), name.name, name.sha256, processor()),
        })
    }

    /// The database's password, where a file has it.
    fn password(&self) -> Result<Option<Password>, CliError> {
        let Some(path) = &self.database_password_file else { return Ok(None) };
        let wrong = |error| CliError::Usage(format!("--database-password-file {}: {error}", path.display()));
        Password::from_file(path).map(Some).map_err(wrong)
    }

    /// How jobs are kept, if they are.
    fn settings(&self, model: &Model) -> Result<Option<Settings>, CliError> {
        let keeping = match (&self.data_dir, &self.database, &self.store) {
            (_, None, _) if self.database_password_file.is_some() => {
                return Err(CliError::Usage("--database-password-file also needs --database".into()));
            }
            (None, None, None) => return Ok(None),
            (Some(folder), None, None) => Keeping::Folder(folder.clone()),
            (None, Some(database), Some(store)) => self.shared(database, store, model)?,
            (Some(_), ..) => {
                let why = "--data-dir is for one server alone; --database and --store are instead of it";
                return Err(CliError::Usage(why.into()));
            }
            (None, Some(_), None) => return Err(CliError::Usage("--database also needs --store".into())),
            (None, None, Some(_)) => return Err(CliError::Usage("--store also needs --database".into())),
        };
        let lease = if let Keeping::Shared { .. } = keeping { self.job_lease } else { Settings::LEASE_ALONE };
        Ok(Some(Settings {
            keeping,
            running: self.jobs_running,
            lease,
            expiry: self.job_expiry,
            disk: self.job_disk,
            queued: self.max_jobs,
            client_queued: self.client_jobs,
            attempts: self.job_attempts,
        }))
    }
}

/// The kind of this machine's processor, as far as results depend on it: with AVX2 sums go in another order than without,
/// and with AVX-512 in the same.
fn processor() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        return "x86_64 with AVX2";
    }
    std::env::consts::ARCH
}

/// Who may ask.
#[derive(Debug, Args)]
struct AccessArgs {
    /// File of keys, one of which each request must show; a line is a name, a space and a key, or
    /// sha256: and the key's SHA-256
    #[arg(long, env = "DENSECLOUD_KEYS", value_name = "FILE")]
    keys: Option<PathBuf>,

    /// What needs no key, with commas between
    #[arg(
        long,
        env = "DENSECLOUD_OPEN",
        value_name = "WHAT,...",
        value_delimiter = ',',
        default_value = "health,metrics,docs"
    )]
    open: Vec<Open>,

    /// Take the last hop of X-Forwarded-For as the client's address, and X-Forwarded-Prefix as --base-path: only
    /// behind a proxy that sets them
    #[arg(long, env = "DENSECLOUD_TRUST_FORWARDED")]
    trust_forwarded: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Open {
    /// /healthz, /readyz, and the like of the Open Inference Protocol
    Health,
    /// /metrics
    Metrics,
    /// The page at /, /openapi.json and /docs
    Docs,
    /// Nothing
    None,
}

impl AccessArgs {
    /// But for the keys, which are in a file.
    fn access(&self) -> Access {
        let open = |what| self.open.contains(&what);
        Access {
            keys: None,
            open_health: open(Open::Health),
            open_metrics: open(Open::Metrics),
            open_docs: open(Open::Docs),
            trust_forwarded: self.trust_forwarded,
        }
    }

    fn check(&self) -> Result<(), CliError> {
        if self.open.contains(&Open::None) && self.open.iter().any(|what| *what != Open::None) {
            return Err(CliError::Usage("--open: none goes with nothing else; leave one of them out".into()));
        }
        Ok(())
    }

    fn keys(&self) -> Result<Option<Arc<Keys>>, CliError> {
        let Some(path) = &self.keys else { return Ok(None) };
        let keys =
            Keys::read(path).map_err(|e| CliError::Usage(format!("--keys {}: {e}", path.display())))?;
        Ok(Some(Arc::new(keys)))
    }
}

/// The longest that a duration can be set to, ten years: clocks cannot tell a time that is too far off.
const LONGEST: Duration = Duration::from_secs(10 * 365 * 24 * 60 * 60);

/// A duration in seconds, decimals allowed.
pub(super) fn seconds(text: &str) -> Result<Duration, String> {
    text.parse()
        .ok()
        .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
        .filter(|duration| *duration <= LONGEST)
        .ok_or_else(|| format!("not a number of seconds from 0 to {} (ten years)", LONGEST.as_secs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        serve: ServeArgs,
    }

    fn parse(arguments: &[&str]) -> Result<ServeArgs, clap::Error> {
        Line::try_parse_from([&["serve"], arguments].concat()).map(|line| line.serve)
    }

    #[test]
    fn without_arguments_the_settings_are_the_servers_defaults() {
        assert_eq!(parse(&[]).expect("arguments").config(Role::Server), Config::default());
    }

    #[test]
    fn a_folder_turns_jobs_on_with_the_defaults_of_the_library() {
        let checked = |arguments: &[&str], role| parse(arguments).expect("arguments").check(role);
        let config = checked(&["--data-dir=x"], Role::Server).expect("settings").config;
        assert_eq!(config.jobs, Some(Settings::new("x".into())));
        let none = checked(&["--data-dir=x", "--jobs-running=0"], Role::Server);
        assert!(none.err().expect("none would run").to_string().contains("--jobs-running"));
    }

    #[test]
    fn a_database_and_a_store_are_shared_and_go_together() {
        let shared = ["--database=postgres://a@b/c", "--store=s3://d"];
        let checked = |arguments: &[&str], role| parse(arguments).expect("arguments").check(role);
        let config =
            checked(&[&shared[..], &["--jobs-running=0"]].concat(), Role::Server).expect("settings").config;
        let jobs = config.jobs.expect("jobs");
        assert_eq!((jobs.folder(), jobs.running, jobs.lease.as_secs()), (None, 0, 30));
        for (arguments, role, word) in [
            (&shared[..1], Role::Server, "--store"),
            (&shared[1..], Role::Server, "--database"),
            (&[shared[0], "--data-dir=x"][..], Role::Server, "--data-dir"),
            (&["--database-password-file=x"][..], Role::Server, "--database"),
            (&["--data-dir=x"][..], Role::Worker, "--database"),
            (&[][..], Role::Worker, "--store"),
            (&[shared[0], shared[1], "--jobs-running=0"][..], Role::Worker, "--jobs-running"),
        ] {
            let refused = checked(arguments, role).err().expect("it cannot work").to_string();
            assert!(refused.contains(word), "{arguments:?}: {refused}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn the_password_of_the_database_is_in_a_file_that_not_everybody_reads() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("password");
        let file = format!("--database-password-file={}", path.display());
        let shared = ["--database=postgres://a@b/c", "--store=s3://d", &file];
        let check = || parse(&shared).expect("arguments").check(Role::Server);
        let refused = || check().err().expect("no password").to_string();
        assert!(refused().starts_with(&file.replace('=', " ")), "{}", refused());
        std::fs::write(&path, "secret\n").expect("a file");
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o604)).expect("a mode");
        assert!(refused().contains("everybody") && !refused().contains("secret"), "{}", refused());
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o400)).expect("a mode");
        let keeping = check().expect("settings").config.jobs.expect("jobs").keeping;
        assert!(!format!("{keeping:?}").contains("secret"), "{keeping:?}");
        let Keeping::Shared { password, .. } = keeping else { panic!("{keeping:?}") };
        assert_eq!(password, Some("secret".to_owned().into()));
    }

    #[test]
    fn each_flag_sets_its_own_limit() {
        let args = parse(&[
            "--max-body-bytes=1",
            "--max-points-in=2",
            "--max-points-out=3",
            "--max-held-bytes=4",
            "--max-temp-bytes=7",
            "--max-connections=5",
            "--client-connections=6",
            "--head-timeout=0.5",
            "--keep-alive-timeout=6.5",
            "--stall-timeout=7",
            "--request-timeout=8",
            "--drain-lead=9",
            "--drain-timeout=0",
        ]);
        let Config { limits, timeouts, .. } = args.expect("arguments").config(Role::Server);
        let expected = Limits {
            body_bytes: 1,
            points_in: 2,
            points_out: 3,
            held_bytes: 4,
            temp_bytes: 7,
            connections: 5,
            client_connections: 6,
        };
        assert_eq!(limits, expected);
        assert_eq!(timeouts.head, Duration::from_millis(500));
        assert_eq!(timeouts.keep_alive, Duration::from_millis(6500));
        assert_eq!(timeouts.stall, Duration::from_secs(7));
        assert_eq!(timeouts.request, Duration::from_secs(8));
        assert_eq!(timeouts.lead, Duration::from_secs(9));
        assert_eq!(timeouts.drain, Duration::ZERO);
    }

    #[test]
    fn every_option_is_a_setting() {
        use clap::CommandFactory;
        for option in Line::command().get_arguments() {
            let name = option.get_long().expect("a name");
            let variable = option.get_env().map(|name| name.to_string_lossy().into_owned());
            let expected = format!("DENSECLOUD_{}", name.replace('-', "_").to_uppercase());
            match name {
                // Not a setting but something to do.
                "print-config" => assert_eq!(variable, None),
                _ => assert_eq!(variable, Some(expected), "--{name} needs an `env`"),
            }
            assert!(option.get_help().is_some(), "--{name} needs help");
        }
    }

    #[test]
    fn what_is_open_and_how_much_memory_there_is_can_be_chosen() {
        let access = |arguments: &[&str]| parse(arguments).expect("arguments").config(Role::Server).access;
        assert!(!access(&["--open=health,docs"]).open_metrics);
        let none = access(&["--open=none", "--trust-forwarded"]);
        assert!(!none.open_health && !none.open_metrics && !none.open_docs && none.trust_forwarded);
        assert!(parse(&["--open=doors"]).is_err());
        for (text, expected) in [("auto", Some(Memory::Auto)), ("5", Some(Memory::Bytes(5))), ("0", None)] {
            let parsed = parse(&[&format!("--max-memory={text}")]).ok().map(|args| args.max_memory);
            assert_eq!(parsed, expected);
        }
    }

    #[test]
    fn a_duration_must_be_one() {
        for bad in ["-1", "x", "", "nan", "inf", "1e30", "1e19", "315360001"] {
            assert!(seconds(bad).is_err(), "{bad}");
        }
        assert_eq!(seconds("315360000"), Ok(LONGEST));
    }
}
