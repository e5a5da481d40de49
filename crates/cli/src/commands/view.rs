//! `densecloud view`: the server's page on a port of this machine, with files opened in it.

use std::fs::File;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use tokio::net::TcpListener;
use tracing_subscriber::EnvFilter;

use super::engine_args::{self, EngineArgs};
use super::log::Log;
use super::memory::{self, Memory};
use super::serve::start_log;
use super::serve_args::LogFormat;
use super::signals::Signals;
use super::{CliError, files};
use densecloud_engine::EngineConfig;
use densecloud_jobs::Settings;
use densecloud_server::{Access, Config, Keys, Limits, ModelInfo, Timeouts};

/// Open clouds in a browser: look at them, make them denser, compare, measure, save
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud view scan.las
  densecloud view --no-open --port 9000 before.ply after.ply

Nobody but this machine reaches it, and nobody without the key in the address that is printed. Ctrl-C ends it, and with it
the results that were not saved.")]
pub(super) struct ViewArgs {
    /// Clouds to be shown, the first one at once; without any, the page waits for a file
    #[arg(value_name = "FILE")]
    files: Vec<PathBuf>,

    /// Port of this machine; 0 lets the system choose one
    #[arg(short, long, default_value_t = 0)]
    port: u16,

    /// Print the address, and open no browser
    #[arg(long)]
    no_open: bool,

    #[command(flatten)]
    engine: EngineArgs,
}

/// Points of a cloud, of a result: here whoever waits decides what is too much.
const POINTS: u64 = 4_000_000_000;
/// Bytes of a file, and of the results until the end.
const BYTES: u64 = 1 << 42;
/// Of one upload.
const DAY: Duration = Duration::from_secs(24 * 60 * 60);

/// Serves the page until it is told to end.
pub(super) fn run(args: &ViewArgs) -> Result<(), CliError> {
    let files = args.files.iter().map(|path| readable(path)).collect::<Result<_, _>>()?;
    let failed = |error: &dyn std::fmt::Display| CliError::Failed(error.to_string());
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(|e| failed(&e))?;
    let signals = runtime.block_on(async { Signals::catch() }).map_err(|e| failed(&e))?;
    let log = Log::start().map_err(|e| failed(&e))?;
    start_log(EnvFilter::new("warn"), LogFormat::Text, &log)?;
    let model = args.engine.model()?;
    let folder = tempfile::tempdir().map_err(|e| failed(&e))?;
    let key = key()?;
    let mut config = config(files, folder.path(), &key)?;
    let sizes = EngineConfig {
        threads: args.engine.threads,
        memory: Memory::Auto.bytes(config.limits.held_bytes),
        ..EngineConfig::default()
    };
    let engine = engine_args::start(Arc::clone(&model), || sizes)?;
    config.model = ModelInfo { name: model.name(), provider: engine.provider().to_owned() };
    let served = runtime.block_on(async {
        let listener = listen(args.port).await?;
        let address = listener.local_addr().map_err(|e| failed(&e))?;
        announce(&page_at(address, &key), args.no_open)?;
        let ended = signals.first(log.clone());
        densecloud_server::run(listener, engine, config, ended).await.map_err(|e| failed(&e))
    });
    runtime.shutdown_background();
    served
}

/// A file that can be opened, wherever the program is by then.
fn readable(path: &Path) -> Result<PathBuf, CliError> {
    let whole =
        File::open(path).and_then(|_| path.canonicalize()).map_err(|why| CliError::file(path, why))?;
    if whole.is_dir() {
        return Err(CliError::Usage(format!("{} is a folder; name the files in it", path.display())));
    }
    Ok(whole)
}

/// A key that nobody guesses, for this one run.
fn key() -> Result<String, CliError> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| CliError::Failed(format!("no random numbers: {error}")))?;
    Ok(hex::encode(bytes))
}

fn config(files: Vec<PathBuf>, folder: &Path, key: &str) -> Result<Config, CliError> {
    let keys = Keys::of_one("you", key).map_err(|error| CliError::Failed(error.to_string()))?;
    let limits = Limits::default();
    // What is shown is packed in memory first.
    let held_bytes = memory::available().map_or(0, |bytes| bytes / 4).max(limits.held_bytes);
    let jobs = Settings { disk: BYTES, ..Settings::new(folder.join("jobs")) };
    Ok(Config {
        limits: Limits {
            body_bytes: BYTES,
            points_in: POINTS,
            points_out: POINTS,
            held_bytes,
            temp_bytes: BYTES,
            ..limits
        },
        // Who ends it does not wait for what is at work.
        timeouts: Timeouts { request: DAY, drain: Duration::ZERO, ..Timeouts::default() },
        access: Access { keys: Some(Arc::new(keys)), ..Access::default() },
        temp: Some(folder.join("temp")),
        jobs: Some(jobs),
        files,
        ..Config::default()
    })
}

async fn listen(port: u16) -> Result<TcpListener, CliError> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).await;
    listener.map_err(|error| {
        CliError::Failed(format!(
            "cannot listen on port {port}: {error}; without --port the system chooses one"
        ))
    })
}

/// The address of the page. What stands behind `#` no browser sends.
fn page_at(address: SocketAddr, key: &str) -> String {
    format!("http://{address}/#key={key}")
}

/// Prints the address, and opens it where somebody could see that.
fn announce(page: &str, no_open: bool) -> Result<(), CliError> {
    files::print(&format!("{page}\n"))?;
    if let Some(mut opener) = opener(page).filter(|_| !no_open) {
        // Whoever has no browser has the address.
        let _ = opener.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    }
    Ok(())
}

/// What opens an address in a browser; nothing where there is no screen.
fn opener(page: &str) -> Option<Command> {
    let has_screen = || ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
    let (program, arguments): (_, &[&str]) = match std::env::consts::OS {
        "windows" => ("rundll32", &["url.dll,FileProtocolHandler"]),
        "macos" => ("open", &[]),
        _ if has_screen() => ("xdg-open", &[]),
        _ => return None,
    };
    let mut command = Command::new(program);
    command.args(arguments).arg(page);
    Some(command)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_settings_of_a_view_are_valid_and_let_nobody_in_without_the_key() {
        let key = key().expect("a key");
        let config = config(Vec::new(), Path::new("x"), &key).expect("settings");
        assert_eq!(config.validate(), Ok(()));
        assert!(config.access.keys.is_some());
        assert_ne!(key, super::key().expect("a key"));
        let page = page_at(SocketAddr::from(([127, 0, 0, 1], 5)), &key);
        assert_eq!(page, format!("http://127.0.0.1:5/#key={key}"));
    }

    #[test]
    fn what_cannot_be_opened_is_told_before_anything_is_begun() {
        assert!(readable(Path::new("/nowhere/cloud.ply")).is_err());
        let folder = tempfile::tempdir().expect("a folder");
        assert!(matches!(readable(folder.path()), Err(CliError::Usage(_))));
    }
}
