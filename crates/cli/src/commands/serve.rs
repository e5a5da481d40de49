//! `densecloud serve`: the server, from its first line in the log to its end.

use std::io::{self, IsTerminal};
use std::path::Path;
use std::sync::Arc;

use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tracing_subscriber::EnvFilter;

use super::serve_args::{Checked, LogFormat, ServeArgs};
use super::signals::Signals;
use super::{CliError, engine_args};
use densecloud_backends::Model;
use densecloud_engine::Engine;
use densecloud_server::{Config, ModelInfo};

/// Threads for parsing and encoding. Few, since the engine's own threads need the processors; enough
/// that one long parse does not hold up the others.
const BLOCKING_THREADS: usize = 16;

/// Makes a folder, where it is missing, that nobody else on the machine can look into.
fn private_folder(folder: &Path) -> io::Result<()> {
    let mut builder = std::fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

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

pub(super) fn run(args: &ServeArgs) -> Result<(), CliError> {
    let Checked { config, model, filter } = args.check()?;
    if let Some(jobs) = &config.jobs {
        private_folder(&jobs.folder).map_err(|error| {
            let folder = jobs.folder.display();
            CliError::Usage(format!("--data-dir {folder}: {error}; give it a folder that can be written to"))
        })?;
    }
    start_log(filter, args.log_format)?;
    raise_descriptors(config.limits.connections);
    if let Some(file) = &args.settings.config {
        tracing::info!(file = %file.display(), "settings read");
    }
    // In the log, too, where a collector finds it.
    start(args, config, model).inspect_err(|error| tracing::error!(why = %error, "failed"))
}

fn start(args: &ServeArgs, mut config: Config, model: Arc<Model>) -> Result<(), CliError> {
    let failed = |why: &dyn std::fmt::Display| CliError::Failed(why.to_string());
    let engine = engine_args::start(model.clone(), args.sizes())?;
    config.model = ModelInfo { name: model.name(), provider: engine.provider().to_owned() };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .max_blocking_threads(BLOCKING_THREADS)
        .build()
        .map_err(|e| failed(&e))?;
    let served = runtime.block_on(serve(args, engine, config));
    stop(runtime);
    served
}

async fn serve(args: &ServeArgs, engine: Engine, config: Config) -> Result<(), CliError> {
    let signals = Signals::catch().map_err(|e| CliError::Failed(format!("cannot wait for signals: {e}")))?;
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
    densecloud_server::run(listener, engine, config, signals.first())
        .await
        .map_err(|e| CliError::Failed(e.to_string()))
}

/// Does not wait for a parse or a warm-up that nobody needs any more.
fn stop(runtime: Runtime) {
    runtime.shutdown_background();
}

fn start_log(filter: EnvFilter, format: LogFormat) -> Result<(), CliError> {
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .with_ansi(io::stderr().is_terminal())
        .with_target(false);
    let started = match format {
        LogFormat::Text => log.try_init(),
        LogFormat::Json => log.json().try_init(),
    };
    started.map_err(|e| CliError::Failed(format!("cannot start the log: {e}")))?;
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
