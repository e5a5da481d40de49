//! `densecloud upsample` of one file or many, which one after the other go through [`upsample::run`].

mod inputs;
mod outputs;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};

use super::engine_args::Machine;
use super::events::{Event, Events};
use super::upsample::{self, UpsampleArgs};
use super::{CliError, dry_run, files, places};

/// Make clouds denser.
#[derive(Debug, Args)]
#[command(
    override_usage = "\
densecloud upsample [OPTIONS] <INPUT> <OUTPUT>
       densecloud upsample [OPTIONS] <INPUT>... --output <PATTERN>",
    after_help = "\
Examples:
  densecloud upsample scan.ply dense.ply --ratio 4
  densecloud upsample scan.xyz dense.ply --points 1000000
  densecloud upsample scan.laz dense.ply --spacing 0.05 --keep-input
  densecloud upsample *.laz -o 'dense/{stem}_4x.{ext}'
  densecloud upsample a.ply b.las -o dense/ --existing skip --json > log.jsonl
  densecloud upsample scan.laz dense.laz --dry-run
  densecloud upsample scan.ply dense.ply --ratio 8 --server http://big-machine:8080
  cat scan.ply | densecloud upsample - - --ratio 2.5 > dense.ply"
)]
pub(super) struct BatchArgs {
    /// The sparse cloud and the dense one; with --output, sparse clouds alone, patterns such as '*.ply' among them. Read are PLY,
    /// LAS, LAZ, COPC, E57, PCD, NumPy, OFF, OBJ and text, recognised by their content; written are .ply, .las, .laz, .copc.laz,
    /// .e57, .pcd, .npy and text such as .xyz (without an extension, and of text with its own one: as the input). `-` is
    /// standard input or output, s3://bucket/name an object
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,

    /// Where the results go: a folder, or a name with {stem}, {ext} or {name} of each input in it. Folders are made
    #[arg(short, long, value_name = "PATTERN")]
    output: Option<PathBuf>,

    /// What to do where a result of --output is there already
    #[arg(long, requires = "output", value_name = "WHAT", default_value = "refuse")]
    existing: Existing,

    /// Tell what happens as JSON on standard output, an object a line
    #[arg(long)]
    json: bool,

    /// Read the inputs, tell what the work would come to in points, time and memory, with its warnings, and write nothing
    #[arg(long, conflicts_with_all = ["server", "resume"])]
    dry_run: bool,

    #[command(flatten)]
    upsample: UpsampleArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Existing {
    /// Begin nothing
    Refuse,
    /// Leave it, and go on with the others
    Skip,
    /// Write it anew
    Overwrite,
}

/// How the works went.
#[derive(Default)]
struct Tally {
    done: usize,
    skipped: usize,
    /// Each with its reason.
    failed: Vec<CliError>,
}

pub(super) fn run(args: &BatchArgs) -> Result<(), CliError> {
    let works = works(args)?;
    let machine = Machine::new(&args.upsample.engine);
    if let ([work], false) = (&works[..], args.output.is_some()) {
        return args.work(work, &machine);
    }
    let mut tally = Tally::default();
    for work in &works {
        args.work_of_many(work, &machine, &mut tally)?;
    }
    args.finish(tally)
}

/// All works, found to be possible as far as their names tell.
fn works(args: &BatchArgs) -> Result<Vec<UpsampleArgs>, CliError> {
    let names: Vec<&Path> = args.files.iter().chain(&args.output).map(PathBuf::as_path).collect();
    places::check(&names)?;
    let (inputs, outputs) = match (&args.output, &args.files[..]) {
        (Some(pattern), names) => {
            let inputs = inputs::expand(names)?;
            let outputs = outputs::outputs(&inputs, pattern)?;
            (inputs, outputs)
        }
        (None, [input, output]) => (inputs::expand(std::slice::from_ref(input))?, vec![output.clone()]),
        (None, _) => return Err(usage("give an input and an output, or inputs and --output")),
    };
    if inputs.len() != outputs.len() {
        return Err(usage("several inputs need --output"));
    }
    let works: Vec<_> =
        inputs.into_iter().zip(outputs).map(|(input, output)| args.of(input, output)).collect();
    args.check(&works)?;
    Ok(works)
}

fn usage(why: &str) -> CliError {
    CliError::Usage(format!(
        "{why}\n\nUsage: densecloud upsample [OPTIONS] <INPUT> <OUTPUT>\n       \
         densecloud upsample [OPTIONS] <INPUT>... --output <PATTERN>"
    ))
}

impl BatchArgs {
    /// The work on one input.
    fn of(&self, input: PathBuf, output: PathBuf) -> UpsampleArgs {
        UpsampleArgs { input, output, events: Events(self.json), ..self.upsample.clone() }
    }

    fn check(&self, works: &[UpsampleArgs]) -> Result<(), CliError> {
        if self.json && works.iter().any(|work| files::is_stdout(&work.output)) {
            return Err(CliError::Usage("--json and the result cannot both go to standard output".into()));
        }
        if works.len() > 1 {
            self.upsample.refuse_one_for_all()?;
        }
        let reading = self.upsample.options.options()?.reading;
        for work in works {
            files::wanted_from(&work.input, &work.output, &reading)?;
        }
        let there =
            works.iter().find(|work| self.existing == Existing::Refuse && self.is_there(&work.output));
        there.map_or(Ok(()), |work| Err(is_there(&work.output)))
    }

    /// Whether a result of --output is there already.
    fn is_there(&self, output: &Path) -> bool {
        self.output.is_some() && files::is_there(output)
    }

    fn work_of_many(
        &self,
        work: &UpsampleArgs,
        machine: &Machine<'_>,
        tally: &mut Tally,
    ) -> Result<(), CliError> {
        let (input, output) = (&*work.input, &*work.output);
        if self.existing == Existing::Skip && self.is_there(output) {
            tally.skipped += 1;
            return work.events.tell(&Event::Skipped { input, output });
        }
        match self.work(work, machine) {
            Ok(()) => tally.done += 1,
            Err(error) => {
                super::note(&error.to_string());
                tally.failed.push(error);
            }
        }
        Ok(())
    }

    /// Does it, and tells how it went.
    fn work(&self, work: &UpsampleArgs, machine: &Machine<'_>) -> Result<(), CliError> {
        let (input, output, start) = (&*work.input, &*work.output, Instant::now());
        work.events.tell(&Event::Begin { input, output })?;
        let worked = match self.dry_run {
            true => dry_run::run(work, machine),
            false => self.make(work, machine, start),
        };
        worked.inspect_err(|why| {
            let failed = Event::Failed { input, output, why: why.to_string(), exit_code: why.exit_code() };
            // The first error is the one to report.
            let _ = work.events.tell(&failed);
        })
    }

    fn make(&self, work: &UpsampleArgs, machine: &Machine<'_>, start: Instant) -> Result<(), CliError> {
        let (input, output) = (&*work.input, &*work.output);
        if self.output.is_some() {
            files::make_folder_of(output)?;
        }
        let made = upsample::run(work, machine)?;
        work.events.tell(&Event::Done { input, output, seconds: start.elapsed().as_secs_f64(), made: &made })
    }

    fn finish(&self, tally: Tally) -> Result<(), CliError> {
        let Tally { done, skipped, failed } = tally;
        Events(self.json).tell(&Event::End { done, skipped, failed: failed.len() })?;
        let skipped = if skipped > 0 { format!(", {skipped} there already") } else { String::new() };
        let summary = format!("{done} done{skipped}, {} failed", failed.len());
        if failed.is_empty() {
            if !self.upsample.quiet {
                super::note(&summary);
            }
            return Ok(());
        }
        let reasons: String = failed.iter().map(|why| format!("\n  {why}")).collect();
        Err(CliError::Failed(format!("{summary}:{reasons}")))
    }
}

fn is_there(output: &Path) -> CliError {
    CliError::Usage(format!(
        "{} is there already; --existing skip leaves it, --existing overwrite writes it anew",
        output.display()
    ))
}
