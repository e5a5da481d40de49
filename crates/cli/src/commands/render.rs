//! `densecloud render`: a picture of a cloud, or of several side by side.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::CliError;
use super::files;
use super::options::ReadingArgs;
use crate::evaluate::picture::{self, Axis, PictureError, Shade, Subject, View};
use densecloud_cloud::Cloud;

/// Draw a cloud as a PNG picture
///
/// No display or graphics card is needed.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud render dense.ply dense.png
  densecloud render sparse.ply both.png --beside dense.ply --view 20,10 --up y
  densecloud render dense.ply even.png --shade density --size 1600x1200")]
pub(super) struct RenderArgs {
    /// The cloud, in any format that is read; `-` for standard input
    cloud: PathBuf,

    /// The picture, a PNG file; `-` for standard output
    out: PathBuf,

    /// Another cloud to the right of it, with the same camera and point size; may be repeated
    #[arg(long, value_name = "CLOUD")]
    beside: Vec<PathBuf>,

    /// What colours mean
    #[arg(long, value_enum, default_value_t = ShadeName::Normals)]
    shade: ShadeName,

    /// Pixels of the picture of one cloud
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1000x800", value_parser = size)]
    size: (u32, u32),

    /// Degrees around the vertical axis, and above the horizon
    #[arg(
        long,
        value_name = "AZIMUTH,ELEVATION",
        default_value = "30,20",
        value_parser = view,
        allow_hyphen_values = true
    )]
    view: (f64, f64),

    /// The axis that points up
    #[arg(long, value_enum, default_value_t = AxisName::Z)]
    up: AxisName,

    /// Diameter of a point in pixels [default: just closes the surface of the densest cloud]
    #[arg(long, value_name = "PX")]
    point_size: Option<f64>,

    #[command(flatten)]
    reading: ReadingArgs,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ShadeName {
    /// One material, lit: shows shape
    Normals,
    /// By the distance from the viewer
    Depth,
    /// By how crowded points are, against the cloud's median: shows how even it is
    Density,
    /// The cloud's own red, green and blue
    Colour,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum AxisName {
    X,
    Y,
    Z,
}

impl AxisName {
    pub(super) fn axis(self) -> Axis {
        match self {
            Self::X => Axis::X,
            Self::Y => Axis::Y,
            Self::Z => Axis::Z,
        }
    }
}

pub(super) fn run(args: &RenderArgs) -> Result<(), CliError> {
    check_name(&args.out)?;
    let reading = args.reading.reading()?;
    let read = |path: &PathBuf| Ok(files::read_cloud(path, &reading)?.0);
    let clouds: Vec<Cloud> =
        std::iter::once(&args.cloud).chain(&args.beside).map(read).collect::<Result<_, CliError>>()?;
    let clouds: Vec<Subject<'_>> = clouds.iter().map(Subject::of).collect();
    let image = picture::render(&clouds, &settings(args)).map_err(|why| match why {
        PictureError::Nothing(_) => CliError::file(&args.cloud, why),
        PictureError::Size { .. } | PictureError::NotFinite => CliError::Usage(why.to_string()),
    })?;
    files::write(Path::new(&args.out), |sink| Ok(image.write_png(sink)?))
}

/// Refuses the name of another kind of picture, or of a cloud.
fn check_name(out: &Path) -> Result<(), CliError> {
    match out.extension() {
        Some(extension) if !extension.eq_ignore_ascii_case("png") => {
            Err(CliError::Usage(format!("{}: pictures are PNG files; name it .png", out.display())))
        }
        _ => Ok(()),
    }
}

fn settings(args: &RenderArgs) -> picture::Settings {
    picture::Settings {
        width: args.size.0,
        height: args.size.1,
        shade: match args.shade {
            ShadeName::Normals => Shade::Normals,
            ShadeName::Depth => Shade::Depth,
            ShadeName::Density => Shade::Density,
            ShadeName::Colour => Shade::Colour,
        },
        view: View { azimuth: args.view.0, elevation: args.view.1, up: args.up.axis() },
        point_size: args.point_size,
    }
}

fn size(text: &str) -> Result<(u32, u32), String> {
    pair(text, 'x').ok_or_else(|| "expected two whole numbers as in 1000x800".into())
}

fn view(text: &str) -> Result<(f64, f64), String> {
    pair(text, ',').ok_or_else(|| "expected two angles in degrees as in 30,20".into())
}

fn pair<T: std::str::FromStr>(text: &str, separator: char) -> Option<(T, T)> {
    let (a, b) = text.split_once(separator)?;
    Some((a.trim().parse().ok()?, b.trim().parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_parsed_or_refused() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        assert_eq!(view("-30, 12.5"), Ok((-30.0, 12.5)));
        for bad in ["640", "x", "640x", "-1x5", "axb"] {
            assert!(size(bad).is_err(), "{bad}");
        }
    }
}
