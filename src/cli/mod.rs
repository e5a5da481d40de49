//! The command line: one file a command.
//!
//! Exit codes: 0 done, 1 the work failed, 64 the command was wrong (`EX_USAGE`).

mod engine_args;
mod error;
mod evaluate;
mod files;
mod inspect;
mod job;
mod memory;
mod render;
mod sample;
mod serve;
mod upsample;

pub use error::CliError;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Turns a sparse, noisy 3D point cloud into a dense one.
#[derive(Debug, Parser)]
#[command(name = "densecloud", version, about, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Upsample(upsample::UpsampleArgs),
    Inspect(inspect::InspectArgs),
    Serve(serve::ServeArgs),
    Job(job::JobArgs),
    Evaluate(evaluate::EvaluateArgs),
    Sample(sample::SampleArgs),
    Render(render::RenderArgs),
}

/// Parses the arguments, runs the command, and says how it went.
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version go to stdout and are no failure; a closed pipe is nobody's concern.
            let _ = error.print();
            return if error.use_stderr() { ExitCode::from(CliError::USAGE) } else { ExitCode::SUCCESS };
        }
    };
    match run(arguments.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("densecloud: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

fn run(command: Command) -> Result<(), CliError> {
    match command {
        Command::Inspect(args) => inspect::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Upsample(args) => upsample::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::Job(args) => job::run(&args),
    }
}
