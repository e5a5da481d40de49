//! The `densecloud` program: the library's commands, and the allocator.

use std::process::ExitCode;

/// Gives back what large requests took; the system's allocator keeps it, in pieces too small for the next one. It serves
/// ONNX Runtime and SQLite, too: the crate's `unprefixed_malloc_on_supported_platforms` makes it the process's `malloc`.
/// With Microsoft's compiler it cannot be built; the system's allocator serves there.
#[cfg(not(target_env = "msvc"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> ExitCode {
    ExitCode::from(densecloud_cli::run(std::env::args_os()))
}
