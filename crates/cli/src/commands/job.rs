//! `densecloud job`: jobs of a server elsewhere.

use std::io::{self, BufRead, BufReader, IsTerminal};
use std::path::PathBuf;
use std::time::Duration;

use clap::{ArgGroup, Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;
use ureq::Body;
use ureq::http::Response;

use super::options::{GOALS, OptionArgs};
use super::remote::{Expected, Server, Show, media_type};
use super::{CliError, files};
use densecloud_formats::Format;

/// Jobs of a server: leave a cloud there, come back for the dense one.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  id=$(densecloud job submit scan.ply --ratio 4)
  densecloud job watch $id
  densecloud job get $id dense.ply")]
pub(super) struct JobArgs {
    /// Where the server is; it must have been started with --data-dir or --database
    #[arg(
        long,
        global = true,
        env = "DENSECLOUD_SERVER",
        value_name = "URL",
        default_value = "http://127.0.0.1:8080"
    )]
    server: String,

    /// The key that opens the server, where it asks for one
    #[arg(long, global = true, env = "DENSECLOUD_KEY", hide_env_values = true, value_name = "KEY")]
    key: Option<String>,

    #[command(subcommand)]
    command: JobCommand,
}

#[derive(Debug, Subcommand)]
enum JobCommand {
    /// Leave a cloud; prints the job's id
    Submit(SubmitArgs),
    /// The newest jobs
    #[command(after_help = "\
Examples:
  densecloud job list --limit 5")]
    List {
        /// How many
        #[arg(long, default_value_t = 20)]
        limit: u32,
    },
    /// Wait for a job's end, with a progress bar; exit code 0 if it is done
    #[command(after_help = "\
Examples:
  densecloud job watch $id && densecloud job get $id dense.ply")]
    Watch {
        /// The job
        id: String,
    },
    /// Fetch a result
    #[command(after_help = "\
Examples:
  densecloud job get $id dense.ply")]
    Get {
        /// The job
        id: String,
        /// Where to write it; `-` for standard output
        output: PathBuf,
        /// Say nothing but errors
        #[arg(short, long)]
        quiet: bool,
    },
    /// Stop a job, or forget one that is over, with its result
    #[command(after_help = "\
Examples:
  densecloud job cancel $id")]
    Cancel {
        /// The job
        id: String,
    },
}

/// As `densecloud upsample`.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new(GOALS), after_help = "\
Examples:
  densecloud job submit scan.ply --ratio 4
  densecloud job submit scan.laz --server https://clouds.example.org --accept application/vnd.laszip")]
struct SubmitArgs {
    /// The sparse cloud, in any format that is read; `-` for standard input
    input: PathBuf,

    #[command(flatten)]
    options: OptionArgs,

    /// Media type of the result, such as application/vnd.laszip [default: the input's]
    #[arg(long, value_name = "TYPE")]
    accept: Option<String>,

    /// Name of this request: submitted again under the same one, it is the same job
    #[arg(long, value_name = "NAME")]
    idempotency_key: Option<String>,

    /// Say nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

pub(super) fn run(args: &JobArgs) -> Result<(), CliError> {
    let server = Server::new(&args.server, args.key.as_deref())?;
    match &args.command {
        JobCommand::Submit(args) => submit(&server, args),
        JobCommand::List { limit } => list(&server, *limit),
        JobCommand::Watch { id } => watch(&server, id),
        JobCommand::Get { id, output, quiet } => get(&server, id, output, *quiet),
        JobCommand::Cancel { id } => server.delete(&format!("/jobs/{id}")),
    }
}

fn submit(server: &Server, args: &SubmitArgs) -> Result<(), CliError> {
    let headers = [("accept", &args.accept), ("idempotency-key", &args.idempotency_key)];
    let headers: Vec<_> =
        headers.into_iter().filter_map(|(name, value)| Some((name, value.clone()?))).collect();
    let show = Show { quiet: args.quiet };
    let answer = server.upload(
        "/jobs",
        &args.options.options()?.pairs(),
        &headers,
        &args.input,
        Expected::Json,
        &show,
    )?;
    let job = server.json(answer)?;
    let Some(id) = job["id"].as_str() else { return Err(server.failed(&"answered without a job's id")) };
    // The job is there, whoever is told.
    files::print(&format!("{id}\n")).map_err(|error| CliError::Failed(format!("{error}; the job is {id}")))
}

fn list(server: &Server, limit: u32) -> Result<(), CliError> {
    let page = server.json(server.get(&format!("/jobs?limit={limit}"), Expected::Json)?)?;
    let Some(jobs) = page["jobs"].as_array() else { return Err(server.failed(&"answered without jobs")) };
    let line = |job: &Value| {
        format!(
            "{}  {:9}  {:>3.0} %  {} -> {} points  {}\n",
            text(&job["id"]),
            text(&job["state"]),
            100.0 * job["progress"]["fraction"].as_f64().unwrap_or(0.0),
            job["points_in"],
            job["points_out"],
            text(&job["created"])
        )
    };
    files::print(&jobs.iter().map(line).collect::<String>())
}

/// How often a server that is gone is asked again in a row, and after how long: it may be starting anew.
const TRIES: usize = 60;
const PAUSE: Duration = Duration::from_secs(1);

fn watch(server: &Server, id: &str) -> Result<(), CliError> {
    // Its first answer tells a wrong id or address at once.
    let path = format!("/jobs/{id}/events");
    let mut events = Some(server.get(&path, Expected::Events)?);
    let bar = if io::stderr().is_terminal() { ProgressBar::new(1000) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("{msg:28} [{bar:30}] {percent:>3} %  {eta} left") {
        bar.set_style(style.progress_chars("=> "));
    }
    let mut tries = 0;
    while tries < TRIES {
        if let Some(last) = events.take().and_then(|events| follow(events, &bar, || tries = 0)) {
            bar.finish_and_clear();
            return ended(server, &last);
        }
        tries += 1;
        std::thread::sleep(PAUSE);
        events = server.get_if_there(&path, Expected::Events)?;
    }
    Err(server.failed(&"no answer any more; the job goes on when the server does"))
}

/// Shows a stream of events, `seen` at each; gives the job in its final state, or nothing where the stream broke off.
fn follow(events: Response<Body>, bar: &ProgressBar, mut seen: impl FnMut()) -> Option<Value> {
    for line in BufReader::new(events.into_body().into_reader()).lines() {
        let line = line.ok()?;
        let Some(data) = line.strip_prefix("data: ") else { continue };
        let job: Value = serde_json::from_str(data).ok()?;
        seen();
        match job["state"].as_str() {
            Some("queued") => bar.set_message(format!("{} before it", job["position"])),
            Some("running") => {
                let progress = &job["progress"];
                bar.set_position((1000.0 * progress["fraction"].as_f64().unwrap_or(0.0)) as u64);
                if let Some(stage) = progress["stage"].as_str() {
                    let (level, levels) = (&progress["level"], &progress["levels"]);
                    bar.set_message(format!("level {level} of {levels}: {stage}"));
                }
            }
            // Over, or deleted, which has no state.
            _ => return Some(job),
        }
    }
    None
}

fn ended(server: &Server, job: &Value) -> Result<(), CliError> {
    match job["state"].as_str() {
        Some("done") => files::print("done\n"),
        Some("failed") => Err(server.failed(&format!("the job failed: {}", text(&job["problem"]["detail"])))),
        Some(state) => Err(server.failed(&format!("the job is {state}"))),
        None => Err(server.failed(&"the job was deleted")),
    }
}

fn get(server: &Server, id: &str, output: &std::path::Path, quiet: bool) -> Result<(), CliError> {
    let wanted = files::wanted(output)?;
    let result = server.get(&format!("/jobs/{id}/result"), Expected::Cloud)?;
    let told = Format::from_media_type(media_type(&result));
    match (wanted, told) {
        (Some(wanted), Some(told)) if !told.is_named_like(wanted) => Err(CliError::Usage(format!(
            "{}: the job's result is {told}, and would be so under this name; a job's format is that of `submit --accept`",
            output.display()
        ))),
        _ => server.save(result, output, &Show { quiet }),
    }
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}
