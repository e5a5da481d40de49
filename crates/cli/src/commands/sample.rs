//! `densecloud sample`: point clouds from a mesh.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::CliError;
use super::files;
use densecloud_cloud::{Origin, Position};
use densecloud_formats::{Format, read_mesh_file};
use densecloud_geometry::{Mesh, Rng, SHAPES, poisson_disk, shape, uniform};

/// Sample points on a mesh, evenly spread or at random
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud sample bunny.ply bunny.xyz --points 5000
  densecloud sample shape:knot 'knot_{points}.ply' --points 625 --points 10000 --noise 0.0025")]
pub(super) struct SampleArgs {
    /// A PLY or OFF mesh, or a built-in shape: shape:knot, shape:gear, shape:stairs
    mesh: String,

    /// A .ply or .xyz file, or `-` for standard output (as XYZ). With several --points, the name
    /// must contain {points}
    out: PathBuf,

    /// How many points; may be given several times to write one file each
    #[arg(short = 'n', long, required = true, value_name = "N")]
    points: Vec<usize>,

    /// How to spread them
    #[arg(long, value_enum, default_value_t = Method::Poisson)]
    method: Method,

    /// Same seed, same points. Samples of different sizes are independent
    #[arg(long, default_value_t = 0)]
    seed: u64,

    /// Deviation of Gaussian noise added to each coordinate, as a fraction of half the diagonal of
    /// the mesh's bounding box (0.0025 is the paper's 0.25 %)
    #[arg(long, default_value_t = 0.0, value_name = "FRACTION")]
    noise: f64,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Method {
    /// Poisson-disk: no two points near each other
    Poisson,
    /// Independent and uniform by area
    Uniform,
}

pub(super) fn run(args: &SampleArgs) -> Result<(), CliError> {
    if !(args.noise >= 0.0 && args.noise.is_finite()) {
        return Err(CliError::Usage("--noise must be a number that is not negative".into()));
    }
    let outputs = outputs(&args.out, &args.points)?;
    let mesh = load(&args.mesh)?;
    for (&points, (path, format)) in args.points.iter().zip(outputs) {
        let sampled = match args.method {
            Method::Poisson => poisson_disk(&mesh, points, args.seed),
            Method::Uniform => uniform(&mesh, points, args.seed),
        };
        let mut sampled = sampled.map_err(|why| CliError::file(&args.mesh, why))?;
        add_noise(&mut sampled, &mesh, args);
        files::write_cloud(&path, format, &sampled, &[], &Origin::default())?;
    }
    Ok(())
}

/// One file and its format for each count.
fn outputs(out: &Path, points: &[usize]) -> Result<Vec<(PathBuf, Format)>, CliError> {
    let text = out.to_string_lossy();
    if points.len() > 1 && !text.contains("{points}") {
        return Err(CliError::Usage(format!(
            "{text}: with several --points the output name must contain {{points}}, for example cloud_{{points}}.ply"
        )));
    }
    let format = match files::wanted(out)? {
        Some(format) => format,
        None if files::is_stream(out) => Format::TEXT,
        None => {
            return Err(CliError::Usage(format!(
                "{text}: the name must end in .ply or .xyz, which tells the format"
            )));
        }
    };
    let name = |n: &usize| PathBuf::from(text.replace("{points}", &n.to_string()));
    Ok(points.iter().map(|n| (name(n), format)).collect())
}

fn load(name: &str) -> Result<Mesh, CliError> {
    match name.strip_prefix("shape:") {
        Some(wanted) => shape(wanted).ok_or_else(|| {
            CliError::Usage(format!("there is no shape {wanted:?}; there are: {}", SHAPES.join(", ")))
        }),
        None => read_mesh_file(Path::new(name)).map_err(|why| CliError::file(name, why)),
    }
}

fn add_noise(points: &mut [Position], mesh: &Mesh, args: &SampleArgs) {
    let Some((lo, hi)) = mesh.bounds().filter(|_| args.noise > 0.0) else { return };
    let diagonal = (0..3).map(|a| (hi[a] - lo[a]).powi(2)).sum::<f64>().sqrt();
    let deviation = args.noise * diagonal / 2.0;
    // Its own stream: the points under the noise are those of the same seed without noise.
    let mut rng = Rng::stream(args.seed, !(points.len() as u64));
    for c in points.as_flattened_mut() {
        *c += deviation * rng.normal();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(mesh: &str, out: &Path, points: &[usize]) -> SampleArgs {
        SampleArgs {
            mesh: mesh.into(),
            out: out.into(),
            points: points.into(),
            method: Method::Poisson,
            seed: 4,
            noise: 0.0,
        }
    }

    #[test]
    fn several_counts_give_several_files() {
        let dir = tempfile::tempdir().expect("a folder");
        run(&args("shape:gear", &dir.path().join("g_{points}.xyz"), &[20, 30])).expect("two files");
        for n in [20, 30] {
            let text = std::fs::read_to_string(dir.path().join(format!("g_{n}.xyz"))).expect("a file");
            assert_eq!(text.lines().count(), n);
        }
    }

    #[test]
    fn noise_moves_points_by_its_deviation() {
        let mesh = shape("stairs").expect("stairs");
        let clean = poisson_disk(&mesh, 2000, 4).expect("points");
        let mut noisy = clean.clone();
        let args = SampleArgs { noise: 0.01, ..args("shape:stairs", Path::new("-"), &[2000]) };
        add_noise(&mut noisy, &mesh, &args);
        let moved: f64 =
            clean.as_flattened().iter().zip(noisy.as_flattened()).map(|(a, b)| (a - b).powi(2)).sum();
        let half_diagonal = (1.6_f64.powi(2) + 1.0 + 1.2_f64.powi(2)).sqrt() / 2.0;
        let deviation = (moved / 6000.0).sqrt() / half_diagonal;
        assert!((deviation - 0.01).abs() < 0.0005, "{deviation}");
    }

    #[test]
    fn impossible_requests_are_usage_errors() {
        let usage = |a: SampleArgs| matches!(run(&a), Err(CliError::Usage(_)));
        assert!(usage(args("shape:gear", Path::new("out.xyz"), &[1, 2])));
        assert!(usage(args("shape:gear", Path::new("out.jpg"), &[1])));
        assert!(usage(args("shape:teapot", Path::new("out.xyz"), &[1])));
        assert!(usage(SampleArgs { noise: f64::NAN, ..args("shape:gear", Path::new("out.xyz"), &[1]) }));
        assert!(matches!(run(&args("/no/such.ply", Path::new("out.xyz"), &[1])), Err(CliError::File { .. })));
    }
}
