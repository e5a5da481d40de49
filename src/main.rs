//! The `densecloud` program: see [`densecloud::cli`].

fn main() -> std::process::ExitCode {
    densecloud::cli::main()
}
