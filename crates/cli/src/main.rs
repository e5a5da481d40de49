//! The `densecloud` program: [`commands`] has one file a command.

mod commands;
mod evaluate;

/// Gives back what large requests took; the system's allocator keeps it, in pieces too small for the next one. It serves
/// ONNX Runtime and SQLite, too: the crate's `unprefixed_malloc_on_supported_platforms` makes it the process's `malloc`.
/// With Microsoft's compiler it cannot be built; the system's allocator serves there.
#[cfg(not(target_env = "msvc"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> std::process::ExitCode {
    commands::main()
}
