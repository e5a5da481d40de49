//! Pictures of clouds: software splatting, so that a machine without a display or a graphics card
//! can show a result.
//!
//! Each point becomes a small disc across its estimated normal, drawn with a depth buffer; where
//! discs overlap they blend, so that a dense cloud looks like the surface it samples and a sparse
//! one like the points it has. Light, ambient occlusion and dark edges are added to the image
//! ([`shade`]), and everything is drawn at twice the size and averaged down.

mod camera;
mod shade;
mod splat;

use std::io::Write;

use densecloud_cloud::{Cloud, Frame, Point, Position, Role, Values, column_of, full_colour};
use densecloud_geometry::{KdTree, estimate_normals};

use camera::Camera;
use shade::Rgb;
use splat::{Canvas, Splat};

/// Points that a normal and a density are estimated from.
const NEIGHBOURS: usize = 16;
/// Image pixels drawn for each pixel out, on each axis.
const SUPERSAMPLING: u32 = 2;
/// The radius of a disc, over the usual distance to the sixth neighbour: just closes a surface.
const CLOSING: f64 = 0.8;
/// The least radius of an automatic disc in pixels out.
const LEAST_RADIUS: f64 = 1.1;
/// The largest radius of an automatic disc, over the picture's height: sparse clouds look sparse.
const MOST_RADIUS: f64 = 0.016;
/// Discs turned this far sideways or farther have no clear near side.
const SIDEWAYS: f64 = 0.25;
/// Largest width and height.
const MAX_SIDE: u32 = 8192;

/// How to draw.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings {
    /// Width of one cloud's picture in pixels.
    pub(crate) width: u32,
    /// Height in pixels.
    pub(crate) height: u32,
    /// What colours mean.
    pub(crate) shade: Shade,
    /// Where one looks from.
    pub(crate) view: View,
    /// Diameter of a disc in pixels, at the centre of the view; `None` chooses one from the
    /// spacing of the densest cloud.
    pub(crate) point_size: Option<f64>,
}

/// What colours mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shade {
    /// One material, lit: shows shape.
    Normals,
    /// Colour by distance from the viewer.
    Depth,
    /// Colour by the distance to the sixteenth neighbour, over the median of the same cloud: from
    /// crowded (a quarter) to sparse (four times). Shows how even a cloud is.
    Density,
    /// The cloud's own colours; grey where it has none.
    Colour,
}

/// Where one looks from; the camera always looks at the middle of what is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct View {
    /// Degrees around the vertical axis, to the right of the front.
    pub(crate) azimuth: f64,
    /// Degrees above the horizon.
    pub(crate) elevation: f64,
    /// Which coordinate axis points up.
    pub(crate) up: Axis,
}

/// A coordinate axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Axis {
    /// The first coordinate.
    X,
    /// The second coordinate.
    Y,
    /// The third coordinate.
    Z,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            width: 1000,
            height: 800,
            shade: Shade::Normals,
            view: View { azimuth: 30.0, elevation: 20.0, up: Axis::Z },
            point_size: None,
        }
    }
}

/// An image, 8 bits a channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Image {
    /// Pixels a row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    /// sRGB values, three a pixel, rows from the top.
    pub(crate) rgb: Vec<u8>,
}

/// Why there is no picture.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum PictureError {
    /// No cloud has two different finite points.
    #[error("there is nothing to draw: {0}")]
    Nothing(#[from] densecloud_cloud::FrameError),
    /// The size is zero or too large.
    #[error("a picture of {width} x {height} pixels cannot be drawn; each side must be 16 to {MAX_SIDE}")]
    Size {
        /// Width asked for.
        width: u32,
        /// Height asked for.
        height: u32,
    },
    /// A setting is NaN, infinite or negative.
    #[error("the view and the point size must be finite numbers, and the point size above zero")]
    NotFinite,
}

/// A cloud to be drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Subject<'a> {
    /// Where its points are.
    pub(crate) positions: &'a [Position],
    /// Red, green and blue of each point, in sRGB, if it has them: see [`Subject::of`] for their range.
    pub(crate) colours: Option<[&'a Values; 3]>,
    /// Where this is not 0, a point has no colour.
    pub(crate) invalid: Option<&'a Values>,
}

impl<'a> Subject<'a> {
    /// A cloud with its colours, whatever their names are (`red`, `R`, `diffuse_red`): integers of 8 bits from 0 to 255;
    /// others, and floats, from 0 to the first of 1, 255 and 65,535 that none of them exceeds. Points whose colour is
    /// absent are grey: where a part is no number, or a flag calls it invalid.
    #[must_use]
    pub(crate) fn of(cloud: &'a Cloud) -> Self {
        let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
        let find = |role| column_of(&names, role).map(|i| &cloud.attributes[i].values);
        let colours = find(Role::Red).zip(find(Role::Green)).zip(find(Role::Blue));
        let colours = colours.map(|((r, g), b)| [r, g, b]);
        Self { positions: &cloud.positions, colours, invalid: find(Role::ColourInvalid) }
    }

    /// The linear colour of each point.
    fn tints(&self) -> Vec<Rgb> {
        let Some(colours) = self.colours else { return vec![GREY; self.positions.len()] };
        let full = full_colour(colours);
        let absent = |i: usize| {
            self.invalid.is_some_and(|flag| flag.get(i) != 0.0) || colours.iter().any(|c| c.get(i).is_nan())
        };
        let tint = |i| if absent(i) { GREY } else { colours.map(|c| shade::decode(c.get(i) / full)) };
        (0..self.positions.len()).map(tint).collect()
    }
}

impl<'a> From<&'a [Position]> for Subject<'a> {
    fn from(positions: &'a [Position]) -> Self {
        Self { positions, colours: None, invalid: None }
    }
}

/// Of points without a colour.
const GREY: Rgb = [0.5; 3];

/// Draws the clouds side by side, all from the same place with the same disc size, so that they
/// can be compared.
///
/// Non-finite points are left out, and so are points far outside of where most are: a few strays
/// must not shrink the rest to a dot. The work is proportional to points and pixels: a million
/// points take seconds.
///
/// # Errors
/// See [`PictureError`].
pub(crate) fn render(clouds: &[Subject<'_>], settings: &Settings) -> Result<Image, PictureError> {
    let Settings { width, height, view, .. } = *settings;
    if !(16..=MAX_SIDE).contains(&width) || !(16..=MAX_SIDE).contains(&height) {
        return Err(PictureError::Size { width, height });
    }
    let size = settings.point_size.unwrap_or(1.0);
    if ![view.azimuth, view.elevation, size].iter().all(|v| v.is_finite()) || size <= 0.0 {
        return Err(PictureError::NotFinite);
    }
    let (clouds, tints): (Vec<Vec<Point>>, Vec<Vec<Rgb>>) = local(clouds)?.into_iter().unzip();
    let camera = Camera::fit(&clouds, view, width * SUPERSAMPLING, height * SUPERSAMPLING);
    let measured: Vec<Vec<Spacing>> = clouds.iter().map(|points| spacings(points)).collect();
    let pixel = camera.pixel() * f64::from(SUPERSAMPLING);
    let radius = match settings.point_size {
        Some(diameter) => pixel * diameter / 2.0,
        None => {
            let most = pixel * (MOST_RADIUS * f64::from(height)).max(LEAST_RADIUS);
            (CLOSING * closest(&measured)).clamp(pixel * LEAST_RADIUS, most)
        }
    };
    let panels: Vec<Image> = clouds
        .iter()
        .zip(&tints)
        .zip(&measured)
        .map(|((points, tints), measured)| panel(points, tints, measured, &camera, radius, settings.shade))
        .collect();
    Ok(beside(&panels))
}

/// What a point's neighbours say of it.
#[derive(Debug, Clone, Copy, Default)]
struct Spacing {
    /// Distances to the sixth and to the last neighbour: how dense the cloud is.
    sixth: f32,
    last: f32,
    /// From the middle of the neighbours to the point: outwards, where the surface is convex.
    out: [f32; 3],
}

/// Points and their colours.
type Local = (Vec<Point>, Vec<Rgb>);

/// All clouds in one local frame, with their colours, without strays.
fn local(clouds: &[Subject<'_>]) -> Result<Vec<Local>, PictureError> {
    let finite = |p: &&Position| p.iter().all(|c| c.is_finite());
    let all: Vec<Position> = clouds.iter().flat_map(|c| c.positions.iter().filter(finite).copied()).collect();
    let ranges: [(f64, f64); 3] =
        std::array::from_fn(|a| camera::robust_range(all.iter().map(|p| p[a]).collect()));
    let near = |p: &Position| (0..3).all(|a| (ranges[a].0..=ranges[a].1).contains(&p[a]));
    let kept: Vec<Position> = all.into_iter().filter(near).collect();
    let frame = Frame::fit(&kept)?;
    let local = |c: &Subject<'_>| {
        let points = c.positions.iter().zip(c.tints()).filter(|(p, _)| near(p));
        points.map(|(p, tint)| (frame.to_local(*p), tint)).unzip()
    };
    Ok(clouds.iter().map(local).collect())
}

fn spacings(points: &[Point]) -> Vec<Spacing> {
    let tree = KdTree::new(points);
    let mut spacings = vec![Spacing::default(); points.len()];
    let mut found = Vec::new();
    for &i in tree.order() {
        // The point itself is the first.
        tree.nearest(points[i as usize], NEIGHBOURS + 1, &mut found);
        let at = |n: usize| found.get(n).or(found.last()).map_or(0.0, |n| n.distance_squared.sqrt());
        let mut out = points[i as usize];
        for n in &found {
            (0..3).for_each(|a| out[a] -= points[n.index as usize][a] / found.len() as f32);
        }
        spacings[i as usize] = Spacing { sixth: at(6), last: at(NEIGHBOURS), out };
    }
    spacings
}

/// The usual distance to the sixth neighbour in the densest cloud.
fn closest(measured: &[Vec<Spacing>]) -> f64 {
    let median = |m: &Vec<Spacing>| median(m.iter().map(|s| s.sixth).collect());
    measured.iter().filter(|m| !m.is_empty()).map(median).fold(f64::INFINITY, f64::min)
}

fn median(mut values: Vec<f32>) -> f64 {
    values.sort_unstable_by(f32::total_cmp);
    values.get(values.len() / 2).copied().map_or(0.0, f64::from)
}

fn panel(
    points: &[Point],
    tints: &[Rgb],
    measured: &[Spacing],
    camera: &Camera,
    radius: f64,
    shade: Shade,
) -> Image {
    let normals = estimate_normals(points, NEIGHBOURS);
    let usual = median(measured.iter().map(|s| s.last).collect()).max(f64::MIN_POSITIVE);
    let mut canvas = Canvas::new(camera.width, camera.height);
    let splats: Vec<Splat> = points
        .iter()
        .zip(&normals)
        .zip(tints)
        .zip(measured)
        .map(|(((&p, &n), &own), m)| {
            // Four times sparser and four times denser than usual are the ends of the scale.
            let density = 0.5 - (f64::from(m.last) / usual).log2() / 4.0;
            let tint = if shade == Shade::Density { shade::scale_colour(density as f32) } else { own };
            camera.splat(p, camera.towards(p, n, m.out), radius, tint)
        })
        .collect();
    canvas.draw(&splats, camera.focal as f32);
    shade::image(&canvas, camera, shade, SUPERSAMPLING)
}

/// Joins images of one height.
fn beside(panels: &[Image]) -> Image {
    let height = panels.first().map_or(0, |p| p.height);
    let width = panels.iter().map(|p| p.width).sum();
    let mut rgb = Vec::with_capacity(width as usize * height as usize * 3);
    for row in 0..height as usize {
        for panel in panels {
            let stride = panel.width as usize * 3;
            rgb.extend_from_slice(&panel.rgb[row * stride..(row + 1) * stride]);
        }
    }
    Image { width, height, rgb }
}

impl Image {
    /// Writes the image as PNG.
    ///
    /// # Errors
    /// The sink fails.
    pub(crate) fn write_png(&self, sink: impl Write) -> std::io::Result<()> {
        let mut encoder = png::Encoder::new(sink, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        Ok(writer.finish()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::{Attribute, Kind};
    use densecloud_geometry::{poisson_disk, shape};

    fn small() -> Settings {
        Settings { width: 80, height: 64, ..Settings::default() }
    }

    fn knot(points: usize) -> Vec<Position> {
        poisson_disk(&shape("knot").expect("the knot"), points, 1).expect("points")
    }

    /// Share of pixels that differ from the background of their row.
    fn covered(image: &Image) -> f64 {
        let row = image.width as usize * 3;
        let differs = |(i, p): (usize, &[u8])| p != &image.rgb[i * 3 / row * row..][..3];
        let count = image.rgb.chunks_exact(3).enumerate().filter(|&x| differs(x)).count();
        count as f64 / f64::from(image.width * image.height)
    }

    #[test]
    fn a_dense_cloud_covers_more_than_a_sparse_one_and_strays_change_nothing() {
        let (sparse, dense) = (knot(150), knot(3000));
        let image = render(&[Subject::from(sparse.as_slice()), Subject::from(dense.as_slice())], &small())
            .expect("an image");
        assert_eq!((image.width, image.height, image.rgb.len()), (160, 64, 160 * 64 * 3));
        let alone = render(&[Subject::from(dense.as_slice())], &small()).expect("an image");
        assert!((0.2..0.8).contains(&covered(&alone)), "{}", covered(&alone));
        let mut stray = dense.clone();
        stray.extend([[1e9, 0.0, 0.0], [f64::NAN, 0.0, 0.0]]);
        assert_eq!(render(&[Subject::from(stray.as_slice())], &small()).expect("an image"), alone);
        let few = Settings { point_size: Some(2.0), ..small() };
        let (few, many) = (
            render(&[Subject::from(sparse.as_slice())], &few),
            render(&[Subject::from(dense.as_slice())], &few),
        );
        assert!(covered(&few.expect("an image")) < 0.6 * covered(&many.expect("an image")));
    }

    #[test]
    fn every_shade_differs_and_is_the_same_twice_on_any_threads() {
        let cloud = knot(1000);
        let image = |shade| {
            render(&[Subject::from(cloud.as_slice())], &Settings { shade, ..small() }).expect("an image")
        };
        let shades = [Shade::Normals, Shade::Depth, Shade::Density].map(image);
        assert!(shades[0] != shades[1] && shades[1] != shades[2] && shades[0] != shades[2]);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        assert_eq!(one.install(|| image(Shade::Normals)), shades[0]);
    }

    #[test]
    fn colours_are_the_clouds_own() {
        let positions = knot(1000);
        let red = |full: f64, kind| Values::from_f64(kind, positions.iter().map(|_| full));
        let none = |kind| Values::from_f64(kind, positions.iter().map(|_| 0.0));
        let mut pictures = Vec::new();
        for (full, kind) in [(255.0, Kind::U8), (255.0, Kind::U16), (65_535.0, Kind::U16), (1.0, Kind::F32)] {
            let named = |name: &str, values| Attribute { name: name.into(), values };
            let attributes =
                vec![named("red", red(full, kind)), named("green", none(kind)), named("blue", none(kind))];
            let cloud = Cloud { positions: positions.clone(), attributes, ..Cloud::default() };
            let settings = Settings { shade: Shade::Colour, ..small() };
            pictures.push(render(&[Subject::of(&cloud)], &settings).expect("an image"));
        }
        let own = |names: [&str; 3], flags: Option<u8>| {
            let values = [red(255.0, Kind::U8), none(Kind::U8), none(Kind::U8)];
            let columns =
                names.into_iter().zip(values).map(|(name, values)| Attribute { name: name.into(), values });
            let mut attributes: Vec<Attribute> = columns.collect();
            attributes.extend(flags.map(|flag| Attribute {
                name: "color_invalid".into(),
                values: Values::U8(vec![flag; positions.len()]),
            }));
            let cloud = Cloud { positions: positions.clone(), attributes, ..Cloud::default() };
            let settings = Settings { shade: Shade::Colour, ..small() };
            render(&[Subject::of(&cloud)], &settings).expect("an image")
        };
        pictures.push(own(["R", "G", "B"], None));
        pictures.push(own(["diffuse_red", "Diffuse Green", "RGB:2"], Some(0)));
        assert!(pictures.iter().all(|p| *p == pictures[0]));
        let is_grey = |image: Image| image.rgb.chunks_exact(3).all(|p| p[0].abs_diff(p[1]) < 30);
        assert!(is_grey(own(["red", "green", "blue"], Some(1))) && is_grey(own(["R", "G", "none"], None)));
        let reddish = pictures[0].rgb.chunks_exact(3).filter(|p| p[0] > 150 && p[1] < 60).count();
        assert!(reddish > 80 * 64 / 10, "{reddish}");
    }

    #[test]
    fn the_view_turns_the_right_way() {
        // One cluster in front, to the left, and high; seen from the front it is at the upper left.
        let cloud: Vec<Position> =
            [[-1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, 0.99], [1.0, 1.0, -0.99]].to_vec();
        let at = |azimuth: f64, up: Axis| {
            let view = View { azimuth, elevation: 0.0, up };
            let image = render(
                &[Subject::from(cloud.as_slice())],
                &Settings { view, point_size: Some(8.0), ..small() },
            )
            .expect("an image");
            let row = image.width as usize * 3;
            let background =
                |x: usize, y: usize| image.rgb[y * row + x * 3..][..3] == image.rgb[y * row..][..3];
            let seen = |xs: std::ops::Range<usize>, ys: std::ops::Range<usize>| {
                xs.clone().any(|x| ys.clone().any(|y| !background(x, y)))
            };
            [seen(1..40, 0..32), seen(40..80, 0..32), seen(1..40, 32..64), seen(40..80, 32..64)]
        };
        assert_eq!(at(0.0, Axis::Z), [true, false, false, true]);
        assert_eq!(at(180.0, Axis::Z), [false, true, true, false]);
        // With y up and z to the viewer, the first cluster is at the lower left.
        assert_eq!(at(0.0, Axis::Y), [false, true, true, false]);
    }

    #[test]
    fn impossible_pictures_are_errors() {
        let cloud = knot(20);
        let size = Settings { width: 0, ..small() };
        assert_eq!(
            render(&[Subject::from(cloud.as_slice())], &size),
            Err(PictureError::Size { width: 0, height: 64 })
        );
        let bad = Settings { point_size: Some(-1.0), ..small() };
        assert_eq!(render(&[Subject::from(cloud.as_slice())], &bad), Err(PictureError::NotFinite));
        assert!(matches!(
            render(&[Subject::from([[1.0; 3], [1.0; 3]].as_slice())], &small()),
            Err(PictureError::Nothing(_))
        ));
        assert!(matches!(render(&[], &small()), Err(PictureError::Nothing(_))));
    }

    #[test]
    fn png_starts_with_its_signature_and_holds_the_size() {
        let image = Image { width: 2, height: 1, rgb: vec![255, 0, 0, 0, 0, 255] };
        let mut bytes = Vec::new();
        image.write_png(&mut bytes).expect("a vector takes everything");
        assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().expect("a PNG");
        let mut back = vec![0; 6];
        reader.next_frame(&mut back).expect("a frame");
        assert_eq!(back, image.rgb);
    }
}
