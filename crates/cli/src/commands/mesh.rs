//! `densecloud mesh`: a cloud's surface as triangles.

use std::path::{Path, PathBuf};

use clap::Args;
use densecloud::position;
use densecloud::surface::{Meshed, Meshing, TriangleSize, mesh};
use densecloud_cloud::{Cloud, Origin, Position};
use densecloud_formats::{MeshFormat, write_mesh};

use super::options::ReadingArgs;
use super::{CliError, files};

/// Spacings from the nearest point up to which surface is kept, at most and by default.
const TRIM: f64 = 3.0;

/// Make a mesh of a cloud: its surface as triangles
///
/// By screened Poisson reconstruction near the points: where there are none, the mesh stays open. Colours are carried over.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud mesh dense.ply surface.ply
  densecloud mesh scan.e57 surface.glb --triangles 200000
  densecloud mesh hall.xyz hall.obj --sensor 2,3,1.7 --size 0.05")]
pub(super) struct MeshArgs {
    /// The cloud, in any format that is read; `-` for standard input
    cloud: PathBuf,

    /// The mesh: .ply, .obj, .glb or .stl
    out: PathBuf,

    /// About how many triangles (within a tenth, or it is refused)
    #[arg(long, value_name = "N", conflicts_with = "size")]
    triangles: Option<usize>,

    /// About how long the triangles' sides are, in the cloud's units [default: the median spacing of its points]
    #[arg(long, value_name = "LENGTH")]
    size: Option<f64>,

    /// How far from the nearest point surface is kept, in spacings of the points there: smaller leaves more open, 3 is the most
    #[arg(long, value_name = "SPACINGS", default_value_t = TRIM)]
    trim: f64,

    /// Where the sensor stood, in the cloud's coordinates: triangles face it. In place of what the file says
    #[arg(long, value_name = "X,Y,Z", value_parser = position, allow_hyphen_values = true)]
    sensor: Option<Position>,

    /// Say nothing but errors
    #[arg(short, long)]
    quiet: bool,

    #[command(flatten)]
    reading: ReadingArgs,
}

impl MeshArgs {
    fn how(&self) -> Result<Meshing, CliError> {
        let size = match (self.triangles, self.size) {
            (Some(0), _) => return Err(CliError::Usage("--triangles must be at least 1".into())),
            (Some(count), _) => TriangleSize::Count(count),
            (_, Some(size)) if !(size.is_normal() && size > 0.0) => {
                return Err(CliError::Usage("--size must be a length above 0".into()));
            }
            (_, Some(size)) => TriangleSize::Cell(size),
            _ => TriangleSize::Spacing,
        };
        if !(self.trim > 0.0 && self.trim <= TRIM) {
            return Err(CliError::Usage("--trim must be above 0 and at most 3".into()));
        }
        Ok(Meshing { size, trim: self.trim, sensor: self.sensor })
    }
}

pub(super) fn run(args: &MeshArgs) -> Result<(), CliError> {
    let (how, format) = (args.how()?, format(&args.out)?);
    let (cloud, _) = files::read_cloud(&args.cloud, &args.reading.reading()?)?;
    super::warn(&cloud.warnings(), args.quiet);
    let made = mesh(&cloud, &how).map_err(|why| CliError::file(&args.cloud, why))?;
    super::warn(&made.warnings, args.quiet);
    write(&args.out, format, &made, &cloud, args.quiet)
}

/// Makes the mesh of a result that was just made, as without options.
pub(super) fn write_of(out: &Path, (cloud, name): (&Cloud, &Path), quiet: bool) -> Result<(), CliError> {
    let how = Meshing { size: TriangleSize::Spacing, trim: TRIM, sensor: None };
    let made = mesh(cloud, &how).map_err(|why| CliError::file(name, why))?;
    super::warn(&made.warnings, quiet);
    write(out, format(out)?, &made, cloud, quiet)
}

/// Refuses a name that no mesh is written under.
pub(super) fn check_name(out: &Path) -> Result<(), CliError> {
    format(out).map(drop)
}

/// The format that a mesh's name asks for.
fn format(out: &Path) -> Result<MeshFormat, CliError> {
    MeshFormat::of(out).ok_or_else(|| {
        let name = out.display();
        CliError::Usage(format!(
            "{name}: a mesh is written as .ply, .obj, .glb or .stl, which its name must end in"
        ))
    })
}

fn write(out: &Path, format: MeshFormat, made: &Meshed, cloud: &Cloud, quiet: bool) -> Result<(), CliError> {
    if format.is_too_coarse(&made.mesh, made.cell) {
        let why = "the coordinates are too large for the 32-bit numbers of STL; write PLY, OBJ or GLB";
        return Err(CliError::file(out, why));
    }
    if made.colours.is_some() && !format.has_colours() {
        super::warn(&["colours are not written: STL has no place for them".to_owned()], quiet);
    }
    let origin = Origin { crs: cloud.origin.crs.clone(), ..Origin::default() };
    files::write(out, |sink| Ok(write_mesh(sink, format, &made.mesh, made.colours.as_deref(), &origin)?))
}
