//! The command line: one file a command.
//!
//! Exit codes: 0 done, 1 the work failed, 64 the command or a setting was wrong (`EX_USAGE`).

mod batch;
mod clean;
mod completions;
mod config;
mod connection;
mod data_folder;
mod dry_run;
mod engine_args;
mod error;
mod evaluate;
mod events;
#[cfg(test)]
mod examples;
mod files;
mod healthcheck;
mod inspect;
mod job;
mod log;
mod man;
mod memory;
mod mesh;
mod options;
mod places;
mod remote;
mod render;
mod report;
mod sample;
mod serve;
mod serve_args;
mod settings;
mod signals;
mod tile_args;
mod tile_progress;
mod tiled;
mod tiles;
mod tiles_away;
mod upsample;
mod upsample_remote;
mod view;
mod worker;

pub(crate) use error::CliError;
pub use files::{beside, write_file};
pub use inspect::Inspection;
pub(crate) use inspect::short;
pub use memory::available as available_memory;
pub use upsample::PROVENANCE;

use std::ffi::OsString;
use std::io::{self, Write};

use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};
use densecloud_server::Role;
use settings::Refused;

/// The program's name, as shells and manuals have it.
const NAME: &str = "densecloud";

/// The exit code of what went well.
const DONE: u8 = 0;

/// Turns a sparse, noisy 3D point cloud into a dense one.
#[derive(Debug, Parser)]
#[command(
    name = NAME,
    version,
    about,
    arg_required_else_help = true,
    after_help = "\
Examples:
  densecloud upsample scan.ply dense.ply --ratio 4
  densecloud inspect scan.laz
  densecloud help upsample

Exit codes: 0 done, 1 the work failed, 64 an argument or a setting is wrong."
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Upsample(Box<batch::BatchArgs>),
    Tiles(tiles::TilesArgs),
    Clean(Box<clean::CleanArgs>),
    Inspect(inspect::InspectArgs),
    Serve(Box<serve_args::ServeArgs>),
    Worker(Box<worker::WorkerArgs>),
    Job(job::JobArgs),
    Healthcheck(healthcheck::HealthcheckArgs),
    Evaluate(evaluate::EvaluateArgs),
    Mesh(mesh::MeshArgs),
    Sample(sample::SampleArgs),
    Render(render::RenderArgs),
    Report(report::ReportArgs),
    View(view::ViewArgs),
    Config(config::ConfigArgs),
    Completions(completions::CompletionsArgs),
    Man(man::ManArgs),
}

/// Parses the arguments, the program's name first, runs the command, says how it went, and gives the exit code.
///
/// Work is done on rayon's global pool, whose threads it sets, and signals are left as they are but by a server: to be called
/// once a process.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let code = code_of(&arguments.into_iter().collect::<Vec<_>>());
    // Nobody else does where a program of another language has called.
    let _ = io::stdout().flush();
    code
}

fn code_of(typed: &[OsString]) -> u8 {
    let (arguments, matches) = match parse(typed) {
        Ok(parsed) => parsed,
        Err(refused) if refused.is_failure() && settings::logs_json(typed) => {
            log::failed_in_json(&refused.to_string(), io::stderr);
            return CliError::USAGE;
        }
        Err(Refused::Arguments(error, file)) => {
            // Help and version go to stdout and are no failure; a closed pipe is nobody's concern.
            let _ = error.print();
            if let Some(file) = file.filter(|_| error.use_stderr()) {
                let _ = writeln!(io::stderr(), "Some of these are in {}.", file.display());
            }
            return if error.use_stderr() { CliError::USAGE } else { DONE };
        }
        Err(Refused::File(error)) => return failed(&error),
    };
    let done = match arguments.command {
        Command::Serve(args) if !args.prints_settings() => return serve::run(&args, Role::Server),
        Command::Worker(worker) if !worker.args.prints_settings() => {
            return serve::run(&worker.args, Role::Worker);
        }
        command => done_by(command, &matches),
    };
    match done {
        Ok(()) => DONE,
        Err(error) => failed(&error),
    }
}

/// The program's description, as all have it who read the arguments or tell of them.
fn program() -> clap::Command {
    settings::with_config(Arguments::command())
}

fn parse(typed: &[OsString]) -> Result<(Arguments, ArgMatches), Refused> {
    let mut command = program();
    let matches = settings::parse(&command, typed)?;
    let arguments = Arguments::from_arg_matches(&matches).map_err(|error| error.format(&mut command))?;
    Ok((arguments, matches))
}

fn failed(error: &CliError) -> u8 {
    note(&error.to_string());
    error.exit_code()
}

/// Says something on standard error. Where nobody can be told, the work goes on.
fn note(text: &str) {
    let _ = writeln!(io::stderr(), "densecloud: {text}");
}

/// Says what a person should know, unless nothing is to be said.
fn warn(warnings: &[String], quiet: bool) {
    for warning in warnings.iter().filter(|_| !quiet) {
        note(&format!("warning: {warning}"));
    }
}

fn done_by(command: Command, matches: &ArgMatches) -> Result<(), CliError> {
    match command {
        Command::Clean(args) => clean::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Report(args) => report::run(&args),
        Command::View(args) => view::run(&args),
        Command::Mesh(args) => mesh::run(&args),
        Command::Sample(args) => sample::run(&args),
        Command::Upsample(args) => batch::run(&args),
        Command::Tiles(args) => tiles::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        // To serve, it never comes back here.
        Command::Serve(args) => {
            args.check(Role::Server)?;
            files::print(&settings::page(&program(), matches))
        }
        Command::Worker(worker) => {
            worker.args.check(Role::Worker)?;
            files::print(&settings::page(&program(), matches))
        }
        Command::Job(args) => job::run(&args),
        Command::Healthcheck(args) => healthcheck::run(&args),
        Command::Config(args) => config::run(&args, program()),
        Command::Completions(args) => completions::run(&args, program()),
        Command::Man(args) => man::run(&args, program()),
    }
}
