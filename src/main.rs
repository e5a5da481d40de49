//! The `densecloud` program: see [`densecloud::cli`].

/// Gives back what large requests took; the system's allocator keeps it, in pieces too small for the next one.
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> std::process::ExitCode {
    densecloud::cli::main()
}
