//! Finding ONNX Runtime's shared library, once a process.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use ort::environment::Environment;
use ort::logging::LogLevel;

use super::BackendError;

/// The process's one environment: ONNX Runtime allows no second.
static ENVIRONMENT: OnceLock<Result<Environment, BackendError>> = OnceLock::new();

/// Who is told what the runtime has to say.
static LOG: OnceLock<fn(&str)> = OnceLock::new();

/// Gives the errors that ONNX Runtime tells in its own words, on whichever thread they come, to `log` instead of standard
/// error, where a reader who stands still would hold up that thread. To be called once, before the first
/// [`OnnxBackend`](crate::OnnxBackend); later calls change nothing. `log` must not panic.
pub fn log_errors_to(log: fn(&str)) {
    // The first stays.
    let _ = LOG.set(log);
}

/// What a host that has the library in a place of its own says.
static PLACE: OnceLock<Result<PathBuf, String>> = OnceLock::new();

/// Says where the library lies, where `ORT_DYLIB_PATH` does not: its path, or why there is none and what to do about it, which is the
/// error then. To be called once, before the first [`OnnxBackend`](crate::OnnxBackend); later calls change nothing.
pub fn library_lies_at(place: Result<PathBuf, String>) {
    // The first stays.
    let _ = PLACE.set(place);
}

/// Loads the library at the first call; later calls give the same answer.
///
/// Looks at `ORT_DYLIB_PATH`, then where the host says, then next to the program, then where the system's loader looks.
pub(super) fn environment() -> Result<Environment, BackendError> {
    ENVIRONMENT.get_or_init(load).clone()
}

fn load() -> Result<Environment, BackendError> {
    let path = find().map_err(|why| BackendError::Library { why })?;
    let fail = |why: String| BackendError::Library { why: format!("{}: {why}", path.display()) };
    let mut builder =
        ort::init_from(&path).map_err(|e| fail(e.to_string()))?.with_name("densecloud").with_telemetry(false);
    let log = LOG.get();
    if let Some(&log) = log {
        let told = move |level: LogLevel, _: &str, _: &str, _: &str, words: &str| {
            if level >= LogLevel::Error {
                log(words);
            }
        };
        builder = builder.with_logger(Arc::new(told));
    }
    let environment = builder.build().map_err(|e| fail(e.to_string()))?;
    if log.is_some() {
        // With a logger, everything is told; without, errors alone.
        environment.set_log_level(LogLevel::Error);
    }
    Ok(environment)
}

fn find() -> Result<PathBuf, String> {
    // Set and wrong is an error to report, not a reason to take another library.
    if let Some(path) = std::env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty()) {
        return Ok(path.into());
    }
    if let Some(place) = PLACE.get() {
        return place.clone();
    }
    let name = format!("{DLL_PREFIX}onnxruntime{DLL_SUFFIX}");
    let beside_program = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.join(&name)));
    Ok(beside_program.filter(|path| path.exists()).unwrap_or_else(|| name.into()))
}
