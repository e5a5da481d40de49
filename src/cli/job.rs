//! `densecloud job`: jobs of a server elsewhere.

use std::fs::File;
use std::io::{self, BufRead, BufReader, IsTerminal, Read};
use std::path::PathBuf;
use std::time::Duration;

use clap::{ArgGroup, Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;
use ureq::http::{HeaderValue, Request, Response, header};
use ureq::middleware::MiddlewareNext;
use ureq::{Agent, Body, SendBody};

use super::{CliError, files};

/// Jobs of a server: leave a cloud there, come back for the dense one.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  id=$(densecloud job submit scan.ply --ratio 4)
  densecloud job watch $id
  densecloud job get $id dense.ply")]
pub(super) struct JobArgs {
    /// Where the server is; it must have been started with --data-dir
    #[arg(
        long,
        global = true,
        env = "DENSECLOUD_SERVER",
        value_name = "URL",
        default_value = "http://127.0.0.1:8080"
    )]
    server: String,

    /// Key to show, where the server has --keys
    #[arg(long, global = true, env = "DENSECLOUD_API_KEY", value_name = "KEY", hide_env_values = true)]
    api_key: Option<String>,

    #[command(subcommand)]
    command: JobCommand,
}

#[derive(Debug, Subcommand)]
enum JobCommand {
    /// Leave a cloud; prints the job's id
    Submit(SubmitArgs),
    /// The newest jobs
    List {
        /// How many
        #[arg(long, default_value_t = 20)]
        limit: u32,
    },
    /// Wait for a job's end, with a progress bar; exit code 0 if it is done
    Watch {
        /// The job
        id: String,
    },
    /// Fetch a result
    Get {
        /// The job
        id: String,
        /// Where to write it; `-` for standard output
        output: PathBuf,
    },
    /// Stop a job, or forget one that is over, with its result
    Cancel {
        /// The job
        id: String,
    },
}

/// As `densecloud upsample`.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("target").required(true))]
struct SubmitArgs {
    /// The sparse cloud, in any format that is read; `-` for standard input
    input: PathBuf,

    /// Points out for each point in, any number from 1 to 64
    #[arg(short, long, value_name = "R", group = "target")]
    ratio: Option<f64>,

    /// Points out, exactly
    #[arg(short = 'n', long, value_name = "N", group = "target")]
    points: Option<u64>,

    /// Mean distance from a point to its nearest neighbour, in the cloud's units
    #[arg(long, value_name = "D", group = "target")]
    spacing: Option<f64>,

    /// Points a square unit of surface
    #[arg(long, value_name = "N", group = "target")]
    density: Option<f64>,

    /// Chooses among equally good results; the same seed gives the same bytes
    #[arg(long)]
    seed: Option<u64>,

    /// How new points come by their attributes
    #[arg(long, value_name = "NAME:RULE,...")]
    attributes: Option<String>,

    /// Keep the input's points exactly, before the new ones
    #[arg(long)]
    keep_input: bool,

    /// Add `source_index` and `is_generated` to each point
    #[arg(long)]
    source_fields: bool,

    /// `estimate`: normals from the dense cloud itself
    #[arg(long, value_name = "HOW")]
    normals: Option<String>,

    /// Where the sensor stood, for the side of estimated normals
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "normals")]
    sensor: Option<String>,

    /// Media type of the result, such as application/vnd.laszip [default: the input's]
    #[arg(long, value_name = "TYPE")]
    accept: Option<String>,

    /// Name of this request: submitted again under the same one, it is the same job
    #[arg(long, value_name = "NAME")]
    key: Option<String>,
}

impl SubmitArgs {
    fn query(&self) -> Vec<(&'static str, String)> {
        let text = |value: &dyn ToString| value.to_string();
        [
            ("ratio", self.ratio.map(|v| text(&v))),
            ("points", self.points.map(|v| text(&v))),
            ("spacing", self.spacing.map(|v| text(&v))),
            ("density", self.density.map(|v| text(&v))),
            ("seed", self.seed.map(|v| text(&v))),
            ("attributes", self.attributes.clone()),
            ("keep_input", self.keep_input.then(|| "true".to_owned())),
            ("source_fields", self.source_fields.then(|| "true".to_owned())),
            ("normals", self.normals.clone()),
            ("sensor", self.sensor.clone()),
        ]
        .into_iter()
        .filter_map(|(name, value)| Some((name, value?)))
        .collect()
    }
}

pub(super) fn run(args: &JobArgs) -> Result<(), CliError> {
    let server = Server {
        base: args.server.trim_end_matches('/').to_owned(),
        // A refusal has a body that says why.
        agent: agent(args.api_key.clone())?,
    };
    match &args.command {
        JobCommand::Submit(args) => submit(&server, args),
        JobCommand::List { limit } => list(&server, *limit),
        JobCommand::Watch { id } => watch(&server, id),
        JobCommand::Get { id, output } => get(&server, id, output),
        JobCommand::Cancel { id } => {
            server.answer(server.agent.delete(server.url(&format!("/jobs/{id}"))).call()).map(|_| ())
        }
    }
}

/// A client that shows this key with every request.
fn agent(key: Option<String>) -> Result<Agent, CliError> {
    let mut config = Agent::config_builder().http_status_as_error(false);
    if let Some(key) = key {
        let mut value = HeaderValue::from_str(&format!("Bearer {key}"))
            .map_err(|_| CliError::Usage("--api-key: not a key: it has characters that no key has".into()))?;
        value.set_sensitive(true);
        config = config.middleware(move |mut request: Request<SendBody<'_>>, next: MiddlewareNext<'_>| {
            request.headers_mut().insert(header::AUTHORIZATION, value.clone());
            next.handle(request)
        });
    }
    Ok(config.build().new_agent())
}

struct Server {
    base: String,
    agent: Agent,
}

impl Server {
    fn url(&self, path: &str) -> String {
        format!("{}{path}", self.base)
    }

    fn get(&self, path: &str) -> Result<Response<Body>, CliError> {
        self.answer(self.agent.get(self.url(path)).call())
    }

    /// The answer, unless it is a problem.
    fn answer(&self, called: Result<Response<Body>, ureq::Error>) -> Result<Response<Body>, CliError> {
        let mut answer = called.map_err(|error| self.failed(&error))?;
        if answer.status().is_success() {
            return Ok(answer);
        }
        let text = answer.body_mut().read_to_string().unwrap_or_default();
        let detail = serde_json::from_str(&text)
            .ok()
            .and_then(|problem: Value| problem["detail"].as_str().map(str::to_owned));
        Err(self.failed(&detail.unwrap_or_else(|| answer.status().to_string())))
    }

    fn failed(&self, why: &dyn std::fmt::Display) -> CliError {
        CliError::Failed(format!("{}: {why}", self.base))
    }

    fn json(&self, answer: Response<Body>) -> Result<Value, CliError> {
        let mut answer = answer;
        let text = answer.body_mut().read_to_string().map_err(|error| self.failed(&error))?;
        serde_json::from_str(&text).map_err(|error| self.failed(&error))
    }
}

fn submit(server: &Server, args: &SubmitArgs) -> Result<(), CliError> {
    let unread = |error: io::Error| CliError::file(&args.input, error);
    let mut input: Box<dyn Read> = if files::is_stream(&args.input) {
        Box::new(io::stdin().lock())
    } else {
        Box::new(File::open(&args.input).map_err(unread)?)
    };
    let mut request = server.agent.post(server.url("/jobs")).query_pairs(args.query());
    for (header, value) in [("accept", &args.accept), ("idempotency-key", &args.key)] {
        if let Some(value) = value {
            request = request.header(header, value);
        }
    }
    let job = server.json(server.answer(request.send(SendBody::from_reader(&mut input)))?)?;
    println!("{}", text(&job["id"]));
    Ok(())
}

fn list(server: &Server, limit: u32) -> Result<(), CliError> {
    let page = server.json(server.get(&format!("/jobs?limit={limit}"))?)?;
    for job in page["jobs"].as_array().into_iter().flatten() {
        println!(
            "{}  {:9}  {:>3.0} %  {} -> {} points  {}",
            text(&job["id"]),
            text(&job["state"]),
            100.0 * job["progress"]["fraction"].as_f64().unwrap_or(0.0),
            job["points_in"],
            job["points_out"],
            text(&job["created"])
        );
    }
    Ok(())
}

/// How often a server that is gone is asked again, and after how long: it may be starting anew.
const TRIES: usize = 60;
const PAUSE: Duration = Duration::from_secs(1);

fn watch(server: &Server, id: &str) -> Result<(), CliError> {
    // Its first answer tells a wrong id or address at once.
    let mut events = Some(server.get(&format!("/jobs/{id}/events"))?);
    let bar = if io::stderr().is_terminal() { ProgressBar::new(1000) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("{msg:28} [{bar:30}] {percent:>3} %  {eta} left") {
        bar.set_style(style.progress_chars("=> "));
    }
    for _ in 0..TRIES {
        if let Some(last) = events.take().and_then(|events| follow(events, &bar)) {
            bar.finish_and_clear();
            return ended(server, &last);
        }
        std::thread::sleep(PAUSE);
        events = server.get(&format!("/jobs/{id}/events")).ok();
    }
    Err(server.failed(&"no answer any more; the job goes on when the server does"))
}

/// Shows a stream of events; gives the job in its final state, or nothing where the stream broke off.
fn follow(events: Response<Body>, bar: &ProgressBar) -> Option<Value> {
    for line in BufReader::new(events.into_body().into_reader()).lines() {
        let line = line.ok()?;
        let Some(data) = line.strip_prefix("data: ") else { continue };
        let job: Value = serde_json::from_str(data).ok()?;
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
        Some("done") => {
            println!("{}", text(&job["state"]));
            Ok(())
        }
        Some("failed") => Err(server.failed(&format!("the job failed: {}", text(&job["problem"]["detail"])))),
        Some(state) => Err(server.failed(&format!("the job is {state}"))),
        None => Err(server.failed(&"the job was deleted")),
    }
}

fn get(server: &Server, id: &str, output: &std::path::Path) -> Result<(), CliError> {
    let result = server.get(&format!("/jobs/{id}/result"))?;
    let mut body = result.into_body().into_reader();
    files::write(output, |sink| {
        io::copy(&mut body, sink)?;
        Ok(())
    })
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}
