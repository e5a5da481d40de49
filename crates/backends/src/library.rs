//! Finding ONNX Runtime's shared library, once a process.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::PathBuf;
use std::sync::OnceLock;

use ort::environment::Environment;

use super::BackendError;

/// The process's one environment: ONNX Runtime allows no second.
static ENVIRONMENT: OnceLock<Result<Environment, BackendError>> = OnceLock::new();

/// Loads the library at the first call; later calls give the same answer.
///
/// Looks at `ORT_DYLIB_PATH`, then next to the program, then where the system's loader looks.
pub(super) fn environment() -> Result<Environment, BackendError> {
    ENVIRONMENT.get_or_init(load).clone()
}

fn load() -> Result<Environment, BackendError> {
    let path = find();
    let fail = |why: String| BackendError::Library { why: format!("{}: {why}", path.display()) };
    ort::init_from(&path)
        .map_err(|e| fail(e.to_string()))?
        .with_name("densecloud")
        .with_telemetry(false)
        .build()
        .map_err(|e| fail(e.to_string()))
}

fn find() -> PathBuf {
    // Set and wrong is an error to report, not a reason to take another library.
    if let Some(path) = std::env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty()) {
        return path.into();
    }
    let name = format!("{DLL_PREFIX}onnxruntime{DLL_SUFFIX}");
    let beside_program = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.join(&name)));
    beside_program.filter(|path| path.exists()).unwrap_or_else(|| name.into())
}
