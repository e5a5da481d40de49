//! `densecloud serve`: the server, from its first line in the log to its end.

use std::io::{self, IsTerminal};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::task::spawn_blocking;
use tracing_subscriber::EnvFilter;

use super::log::{Log, failed_in_json};
use super::serve_args::{Checked, LogFormat, ServeArgs};
use super::signals::{Hangups, Signals};
use super::tile_args::temp_files_in;
use super::{CliError, data_folder, engine_args, memory};
use densecloud_backends::Model;
use densecloud_engine::Engine;
use densecloud_jobs::Settings;
use densecloud_server::{Config, Keys, ModelInfo, Role};

/// Threads for parsing and encoding. Few, since the engine's own threads need the processors; enough
/// that one long parse does not hold up the others.
const BLOCKING_THREADS: usize = 16;

/// How long the end waits for a reader of the log.
const LAST_LINES: Duration = Duration::from_secs(2);

/// Files and sockets that are open beside connections: the database, results of jobs that are being read.
const OTHER_DESCRIPTORS: u64 = 128;

/// Takes as many file descriptors as the system lets this process have: with too few, connections would take those
/// that work needs.
fn raise_descriptors(connections: usize) {
    let needed = (connections as u64).saturating_add(OTHER_DESCRIPTORS);
    match rlimit::increase_nofile_limit(u64::MAX) {
        Ok(limit) if limit < needed => tracing::warn!(
            limit,
            needed,
            "too few files may be open for --max-connections; raise `ulimit -n` or lower it"
        ),
        Ok(_) => {}
        Err(error) => tracing::warn!(%error, "the limit of open files cannot be raised"),
    }
}

/// Serves until it is told to end; says why, where it does not or ends by itself.
pub(super) fn run(args: &ServeArgs, role: Role) -> u8 {
    let log = match Log::start() {
        Ok(log) => log,
        Err(error) => return super::failed(&CliError::Failed(format!("cannot start the log: {error}"))),
    };
    let code = match begin(args, role, &log) {
        Ok(()) => super::DONE,
        Err(error) => {
            tell(&error, args.log_format, &log);
            error.exit_code()
        }
    };
    OVER.store(true, Ordering::Relaxed);
    log.flush(LAST_LINES);
    code
}

/// Says why it ends. A collector that reads JSON reads nothing else.
fn tell(error: &CliError, format: LogFormat, log: &Log) {
    match format {
        LogFormat::Json => failed_in_json(&error.to_string(), log.clone()),
        LogFormat::Text => {
            // In the log, too, if it has begun, where a collector finds it.
            tracing::error!(why = %error, "failed");
            log.line(format!("densecloud: {error}\n").into());
        }
    }
}

fn begin(args: &ServeArgs, role: Role, log: &Log) -> Result<(), CliError> {
    let process = Process::begin()?;
    let Checked { mut config, model, filter } = args.check(role)?;
    config.lines_lost = log.lost().clone();
    if let Some(folder) = config.jobs.as_ref().and_then(Settings::folder) {
        data_folder::prepare(folder)?;
    }
    if let Some(temp) = &config.temp {
        temp_files_in(temp)?;
    }
    start_log(filter, args.log_format, log)?;
    raise_descriptors(config.limits.connections);
    check_held(config.limits.held_bytes);
    if let Some(file) = &args.settings.config {
        tracing::info!(file = %file.display(), "settings read");
    }
    start(args, process, config, model, log)
}

/// What runs everything, and the signals, all of them caught.
struct Process {
    runtime: Runtime,
    hangups: Hangups,
    signals: Signals,
}

impl Process {
    /// To be called at once: until then a hangup ends the program, and as a container's first process it never hears that
    /// it is to end. Loading the model takes a while.
    fn begin() -> Result<Self, CliError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .enable_all()
            .max_blocking_threads(BLOCKING_THREADS)
            .build()
            .map_err(|error| CliError::Failed(error.to_string()))?;
        let caught = runtime.block_on(async { Ok((Hangups::catch()?, Signals::catch()?)) });
        let uncaught = |error: io::Error| CliError::Failed(format!("cannot wait for signals: {error}"));
        let (hangups, signals) = caught.map_err(uncaught)?;
        Ok(Self { runtime, hangups, signals })
    }
}

/// Uploads and results are bounded by a setting, not by what there is.
fn check_held(held: u64) {
    if let Some(available) = memory::available().filter(|&available| available < held) {
        tracing::warn!(
            available,
            held,
            "there is less memory than uploads and results may take; lower --max-held-bytes"
        );
    }
}

fn start(
    args: &ServeArgs,
    process: Process,
    mut config: Config,
    model: Arc<Model>,
    log: &Log,
) -> Result<(), CliError> {
    let Process { runtime, hangups, signals } = process;
    let engine = engine_args::start(model.clone(), || args.sizes())?;
    config.model = ModelInfo { name: model.name(), provider: engine.provider().to_owned() };
    runtime.spawn(read_again(hangups, config.access.keys.clone()));
    let ended = signals.first(log.clone());
    let served = runtime.block_on(serve(args, engine, config, ended));
    stop(runtime);
    served
}

/// Reads the keys again at each hangup.
async fn read_again(mut hangups: Hangups, keys: Option<Arc<Keys>>) {
    loop {
        hangups.next().await;
        let Some(keys) = keys.clone() else {
            tracing::info!("hangup: there is nothing to read again without --keys");
            continue;
        };
        match spawn_blocking(move || keys.reload()).await {
            Ok(Ok(keys)) => tracing::info!(keys, "keys read again"),
            Ok(Err(error)) => tracing::error!(why = %error, "keys not read again; those before stay"),
            // A panic is in the log.
            Err(_) => {}
        }
    }
}

async fn serve(
    args: &ServeArgs,
    engine: Engine,
    config: Config,
    ended: impl Future<Output = ()>,
) -> Result<(), CliError> {
    let (host, port) = (args.host.as_str(), args.port);
    let unbound = |e: io::Error| {
        CliError::Failed(format!(
            "cannot listen on {host}:{port}: {e}; choose another with --host and --port"
        ))
    };
    let listener = TcpListener::bind((host, port)).await.map_err(unbound)?;
    let address = listener.local_addr().map_err(unbound)?;
    let model = &config.model;
    tracing::info!(
        %address, model = model.name.name, provider = model.provider, threads = engine.threads(),
        max_memory = engine.max_memory(), keys = config.access.keys.is_some(), "listening"
    );
    densecloud_server::run(listener, engine, config, ended).await.map_err(|e| CliError::Failed(e.to_string()))
}

/// Does not wait for a parse or a warm-up that nobody needs any more.
fn stop(runtime: Runtime) {
    runtime.shutdown_background();
}

/// Whether the log has had its last line: what ends with the process may speak when nothing can be logged any more.
static OVER: AtomicBool = AtomicBool::new(false);

fn runtime_failed(words: &str) {
    if !OVER.load(Ordering::Relaxed) {
        tracing::error!(why = words, "ONNX Runtime");
    }
}

pub(super) fn start_log(filter: EnvFilter, format: LogFormat, log: &Log) -> Result<(), CliError> {
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(log.clone())
        .with_ansi(io::stderr().is_terminal())
        .with_target(false)
        // They would go to standard error, which may be what fails.
        .log_internal_errors(false);
    let started = match format {
        LogFormat::Text => lines.try_init(),
        LogFormat::Json => lines.json().try_init(),
    };
    started.map_err(|e| CliError::Failed(format!("cannot start the log: {e}")))?;
    densecloud_backends::log_errors_to(runtime_failed);
    // A collector that reads JSON could not make sense of a panic's own lines.
    std::panic::set_hook(Box::new(|panic| {
        tracing::error!(
            why = panic.payload_as_str(),
            at = panic.location().map(ToString::to_string),
            "panic"
        );
    }));
    Ok(())
}
