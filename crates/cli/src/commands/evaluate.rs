//! `densecloud evaluate`: scores of dense clouds, beside those of controls.

use std::path::{Path, PathBuf};

use clap::Args;

use super::CliError;
use super::engine_args::EngineArgs;
use super::files;
use super::options::{CascadeArgs, ReadingArgs};
use crate::evaluate::{
    CascadeSettings, DEFAULT_TOLERANCE, FileKind, FileSet, Method, Report, Row, SetError, Settings, controls,
    score,
};
use densecloud::Request;
use densecloud::attributes::Finish;
use densecloud_cascade::Target;
use densecloud_cloud::Position;
use densecloud_engine::{Engine, Pending};
use densecloud_formats::read_mesh_file;
use densecloud_geometry::SurfaceDistance;

/// Score dense clouds against references, or run the cascade and score what it gives.
#[derive(Debug, Args)]
#[command(after_help = "\
Files of one shape have the same name, extension aside, in every folder.

Examples:
  densecloud evaluate --pred out/ --reference dense/ --mesh meshes/
  densecloud evaluate --input sparse/ --reference dense/ --mesh meshes/ --ratio 4 --controls
  densecloud evaluate --pred a.ply --reference b.ply --json -")]
pub(super) struct EvaluateArgs {
    /// Folder of dense clouds to score, or one; without it, the cascade makes them from --input
    #[arg(long, value_name = "PATH", required_unless_present = "input")]
    pred: Option<PathBuf>,

    /// Folder of reference clouds, or one: dense samples of the true surface
    #[arg(long, value_name = "PATH")]
    reference: PathBuf,

    /// Folder of meshes (.ply, .off), or one: the true surface
    #[arg(long, value_name = "PATH")]
    mesh: Option<PathBuf>,

    /// Folder of sparse clouds, or one
    #[arg(long, value_name = "PATH")]
    input: Option<PathBuf>,

    /// Points out for each point in, when the cascade is run [default: 4]
    #[arg(short, long, value_name = "R", conflicts_with = "pred")]
    ratio: Option<f64>,

    /// Score only these shapes
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    shapes: Vec<String>,

    /// Also score the controls: a second sample of the mesh (floor), the repeated input, and midpoints of
    /// neighbours
    #[arg(long, requires = "mesh", requires = "input")]
    controls: bool,

    /// Tolerance of the F-score, in radii of the reference
    #[arg(long, value_name = "X", default_value_t = DEFAULT_TOLERANCE)]
    tolerance: f64,

    /// Seed of the cascade and of the floor
    #[arg(long, default_value_t = 0)]
    seed: u64,

    #[command(flatten)]
    cascade: CascadeArgs,

    #[command(flatten)]
    reading: ReadingArgs,

    /// Write everything as JSON to a file; `-` for standard output, in place of the tables
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,

    /// Say nothing but the tables and errors
    #[arg(short, long)]
    quiet: bool,

    #[command(flatten)]
    engine: EngineArgs,
}

/// The files of one shape.
struct Shape<'a> {
    name: &'a str,
    pred: Option<&'a Path>,
    reference: &'a Path,
    mesh: Option<&'a Path>,
    input: Option<&'a Path>,
}

/// How the cascade makes predictions.
struct Cascade {
    engine: Engine,
    target: Target,
    settings: densecloud_cascade::CascadeOptions,
}

pub(super) fn run(args: &EvaluateArgs) -> Result<(), CliError> {
    if args.tolerance.is_nan() || args.tolerance <= 0.0 {
        return Err(CliError::Usage(format!("--tolerance {} is not above zero", args.tolerance)));
    }
    let ratio = args.ratio.unwrap_or(4.0);
    let target = Target::Ratio(ratio);
    target.points_out(1).map_err(|e| CliError::Usage(e.to_string()))?;

    let open = |path: &Option<PathBuf>, kind| path.as_deref().map(|p| FileSet::open(p, kind)).transpose();
    let pred = open(&args.pred, FileKind::Cloud).map_err(failed)?;
    let reference = FileSet::open(&args.reference, FileKind::Cloud).map_err(failed)?;
    let mesh = open(&args.mesh, FileKind::Mesh).map_err(failed)?;
    let input = open(&args.input, FileKind::Cloud).map_err(failed)?;

    let leading = pred.as_ref().or(input.as_ref()).unwrap_or(&reference);
    let names = if args.shapes.is_empty() { leading.names() } else { args.shapes.clone() };
    // All files are found before the first is scored: a missing one should not cost an hour.
    let matching = |set: &Option<FileSet>| -> Result<Vec<Option<PathBuf>>, SetError> {
        let Some(set) = set else { return Ok(vec![None; names.len()]) };
        Ok(set.matching(&names)?.into_iter().map(|p| Some(p.to_owned())).collect())
    };
    let preds = matching(&pred).map_err(failed)?;
    let references = reference.matching(&names).map_err(failed)?;
    let meshes = matching(&mesh).map_err(failed)?;
    let inputs = matching(&input).map_err(failed)?;

    let settings = args.cascade.settings(args.seed)?;
    let cascade = match args.pred {
        None => Some(Cascade { engine: args.engine.engine(args.engine.model()?)?, target, settings }),
        Some(_) => None,
    };
    let cascade_settings = match args.pred {
        None => {
            let model = args.engine.model()?;
            let (model, model_sha256) = (model.card.name.clone(), model.sha256.clone());
            Some(CascadeSettings {
                model,
                model_sha256,
                ratio,
                overlap: settings.overlap,
                inner: settings.inner,
                max_displacement: settings.max_displacement,
                max_distance: settings.max_distance,
                polish: settings.polish,
                spread: settings.spread.to_string(),
                quality: settings.quality.to_string(),
            })
        }
        Some(_) => None,
    };
    let mut rows = Vec::new();
    for (i, name) in names.iter().enumerate() {
        let shape = Shape {
            name,
            pred: preds[i].as_deref(),
            reference: references[i],
            mesh: meshes[i].as_deref(),
            input: inputs[i].as_deref(),
        };
        shape.score(args, cascade.as_ref(), &mut rows)?;
        if !args.quiet {
            super::note(&format!("{name} ({} of {})", i + 1, names.len()));
        }
    }
    let shown = |path: &Path| path.display().to_string();
    let report = Report::new(
        Settings {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            predictions: args.pred.as_deref().map(shown),
            inputs: args.input.as_deref().map(shown),
            references: shown(&args.reference),
            meshes: args.mesh.as_deref().map(shown),
            cascade: cascade_settings,
            seed: args.seed,
            tolerance: args.tolerance,
        },
        rows,
    );
    print(&report, args.json.as_deref())
}

impl Shape<'_> {
    /// Appends the shape's rows.
    fn score(
        &self,
        args: &EvaluateArgs,
        cascade: Option<&Cascade>,
        rows: &mut Vec<Row>,
    ) -> Result<(), CliError> {
        let reading = args.reading.reading()?;
        let read_positions = |path: &Path| Ok::<_, CliError>(files::read_cloud(path, &reading)?.0.positions);
        let reference = read_positions(self.reference)?;
        let input = self.input.map(read_positions).transpose()?;
        let read_mesh = |path| read_mesh_file(path).map_err(|e| CliError::file(path, e));
        let mesh = self.mesh.map(read_mesh).transpose()?;
        let surface = mesh.as_ref().map(SurfaceDistance::new);

        let prediction = match (self.pred, cascade, &input) {
            (Some(path), ..) => read_positions(path)?,
            (None, Some(cascade), Some(input)) => cascade.run(self.name, input.clone())?,
            _ => return Err(CliError::Usage("name --pred or --input".into())),
        };
        let count = prediction.len();
        let mut clouds = vec![(Method::Prediction, prediction)];
        if args.controls
            && let (Some(mesh), Some(input)) = (&mesh, &input)
        {
            clouds
                .push((Method::Floor, controls::floor(mesh, count, args.seed).map_err(|e| self.failed(e))?));
            clouds.push((Method::Repeat, controls::repeat(input, count)));
            clouds.push((Method::Midpoints, controls::midpoints(input, count).map_err(|e| self.failed(e))?));
        }
        for (method, cloud) in clouds {
            let scores = score(&cloud, &reference, surface.as_ref(), args.tolerance)
                .map_err(|e| self.failed(format!("{}: {e}", method.name())))?;
            rows.push(Row {
                shape: self.name.to_owned(),
                method,
                points_in: input.as_ref().map(Vec::len),
                points: cloud.len(),
                reference_points: reference.len(),
                scores,
            });
        }
        Ok(())
    }

    fn failed(&self, why: impl std::fmt::Display) -> CliError {
        CliError::Failed(format!("shape `{}`: {why}", self.name))
    }
}

impl Cascade {
    fn run(&self, name: &str, positions: Vec<Position>) -> Result<Vec<Position>, CliError> {
        let request = Request::new(positions.into(), self.target, self.settings, Finish::default());
        let outcome = self.engine.submit(request).and_then(Pending::wait);
        outcome.map(|o| o.made.positions).map_err(|e| CliError::Failed(format!("shape `{name}`: {e}")))
    }
}

fn print(report: &Report, json: Option<&Path>) -> Result<(), CliError> {
    if let Some(path) = json {
        let text = serde_json::to_string_pretty(report).map_err(failed)? + "\n";
        files::write(path, |sink| Ok(sink.write_all(text.as_bytes())?))?;
        if files::is_stream(path) {
            return Ok(());
        }
    }
    files::print(&report.to_string())
}

fn failed(error: impl std::fmt::Display) -> CliError {
    CliError::Failed(error.to_string())
}
