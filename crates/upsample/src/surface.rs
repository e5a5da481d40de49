//! A cloud's surface as a mesh: normals, the side they point to, the surface, its colours.

use densecloud_cloud::{Cloud, Frame, FrameError, Point, Position, Role, Values, column_of, full_colour};
use densecloud_geometry::{
    KdTree, Mesh, Neighbour, PoissonError, PoissonSettings, Surface, estimate_normals, propagated,
    reconstruct, towards,
};

/// Neighbours that a normal is estimated from.
const NEIGHBOURS: usize = 12;
/// Points whose colours are mixed for a corner.
const MIXED: usize = 4;
/// How far from a number of triangles that was asked for the result may be, and what is tried for.
const NEAR_ENOUGH: f64 = 0.1;
const ON_THE_MARK: f64 = 0.02;
const TRIES: usize = 6;
/// How much smaller cells may be than the points' spacing: smaller ones tell nothing, and cost the more.
const FINEST: f64 = 0.25;
/// How near to a line all points may be, against its length.
const THINNEST: f64 = 1e-6;

/// How a mesh is made of a cloud. Lengths are in the cloud's units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Meshing {
    /// How fine it is.
    pub size: TriangleSize,
    /// How far from the nearest point, in spacings there, surface is kept.
    pub trim: f64,
    /// Where the sensor stood, in place of what the file says.
    pub sensor: Option<Position>,
}

/// How fine a mesh is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TriangleSize {
    /// Sides about as long as the points' median spacing.
    Spacing,
    /// The side of a cell, which a triangle's sides are about as long as.
    Cell(f64),
    /// About so many triangles.
    Count(usize),
}

impl Default for Meshing {
    fn default() -> Self {
        Self { size: TriangleSize::Spacing, trim: 3.0, sensor: None }
    }
}

/// A mesh made of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Meshed {
    /// The triangles, counterclockwise as seen from outside.
    pub mesh: Mesh,
    /// Red, green and blue of each vertex, where the cloud has colours.
    pub colours: Option<Vec<[u8; 3]>>,
    /// The side of the cells that it was made in.
    pub cell: f64,
    /// Sides of triangles at open borders: 0 for a closed surface.
    pub open_sides: usize,
    /// What a person should know, a sentence each.
    pub warnings: Vec<String>,
}

/// Why no mesh can be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshingError {
    /// The coordinates are none that can be worked with.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// All points are on one line.
    #[error("all points lie on one line, which has no surface")]
    Line,
    /// The surface cannot be made.
    #[error(transparent)]
    Poisson(#[from] PoissonError),
    /// A number of triangles that cannot be had.
    #[error("{asked} triangles cannot be had of this cloud: the nearest is {nearest}; {advice}")]
    Count {
        /// How many were asked for.
        asked: usize,
        /// The nearest number that was found.
        nearest: usize,
        /// What to do.
        advice: &'static str,
    },
}

/// The surface through a cloud's points: from its normals if it has any, else from estimated ones, turned to the sensor where
/// that is known, else each as its neighbours' are. O(n log n); see [`reconstruct`] for memory.
///
/// # Errors
/// See [`MeshingError`].
pub fn mesh(cloud: &Cloud, how: &Meshing) -> Result<Meshed, MeshingError> {
    let given = given_normals(cloud);
    let usable = |i: &usize| {
        cloud.positions[*i].iter().all(|c| c.is_finite()) && given.as_ref().is_none_or(|n| n[*i].is_some())
    };
    let kept: Vec<usize> = (0..cloud.positions.len()).filter(usable).collect();
    let positions: Vec<Position> = kept.iter().map(|i| cloud.positions[*i]).collect();
    let frame = Frame::fit(&positions)?;
    let points: Vec<Point> = positions.iter().map(|p| frame.to_local(*p)).collect();
    if lie_on_a_line(&points) {
        return Err(MeshingError::Line);
    }
    let (normals, guessed) = normals(cloud, how, &kept, (&points, &frame), given);
    let surface = sized(&points, &normals, how, frame.scale())?;
    let mut warnings = Vec::new();
    if kept.len() < cloud.positions.len() {
        let gone = cloud.positions.len() - kept.len();
        warnings.push(format!("{gone} points without finite coordinates or a normal are left out"));
    }
    if guessed && surface.open_sides > 0 {
        warnings.push(
            "the surface is open and neither normals nor a sensor are known, so which side of it faces out is a guess: tell \
             where the sensor stood (--sensor X,Y,Z)"
                .to_owned(),
        );
    }
    let colours = colours(cloud, &kept, &points, &surface);
    let world = |v: &[f64; 3]| frame.to_world(v.map(|c| c as f32));
    let mesh = Mesh { vertices: surface.vertices.iter().map(world).collect(), triangles: surface.triangles };
    Ok(Meshed { mesh, colours, cell: surface.cell * frame.scale(), open_sides: surface.open_sides, warnings })
}

/// The unit normals that a cloud has; none for a point where they are no direction.
fn given_normals(cloud: &Cloud) -> Option<Vec<Option<[f32; 3]>>> {
    let parts = columns(cloud, [Role::NormalX, Role::NormalY, Role::NormalZ])?;
    let normal = |i: usize| {
        let n = parts.map(|part| part.get(i));
        let length = n.iter().map(|c| c * c).sum::<f64>().sqrt();
        (length.is_normal() && length.is_finite()).then(|| n.map(|c| (c / length) as f32))
    };
    let all: Vec<Option<[f32; 3]>> = (0..cloud.positions.len()).map(normal).collect();
    all.iter().any(Option::is_some).then_some(all)
}

fn columns(cloud: &Cloud, roles: [Role; 3]) -> Option<[&Values; 3]> {
    let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    let [a, b, c] = roles.map(|role| column_of(&names, role));
    Some([a?, b?, c?].map(|i| &cloud.attributes[i].values))
}

/// The normals of the points that are kept, and whether their side is a guess.
fn normals(
    cloud: &Cloud,
    how: &Meshing,
    kept: &[usize],
    (points, frame): (&[Point], &Frame),
    given: Option<Vec<Option<[f32; 3]>>>,
) -> (Vec<[f32; 3]>, bool) {
    let told = |i: usize| how.sensor.or_else(|| sensor(cloud, kept[i])).map(|at| frame.to_local(at));
    if let Some(given) = given {
        let given: Vec<[f32; 3]> = kept.iter().filter_map(|i| given[*i]).collect();
        let turned = towards(points, &given, |_| how.sensor.map(|at| frame.to_local(at)));
        return (turned, false);
    }
    let estimated = estimate_normals(points, NEIGHBOURS);
    if (0..points.len()).all(|i| told(i).is_some()) {
        return (towards(points, &estimated, told), false);
    }
    (propagated(points, &estimated), true)
}

/// Where the sensor of a point stood, as the file says.
fn sensor(cloud: &Cloud, point: usize) -> Option<Position> {
    let Some(sensors) = &cloud.origin.sensors else { return cloud.origin.sensor };
    let scan = cloud.attributes.iter().find(|a| a.name == sensors.attribute)?;
    sensors.of(scan.values.get(point))
}

fn lie_on_a_line(points: &[Point]) -> bool {
    let first = points[0].map(f64::from);
    let from_first = |p: &Point| -> [f64; 3] { std::array::from_fn(|a| f64::from(p[a]) - first[a]) };
    let square = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>();
    let along =
        points.iter().map(from_first).fold([0.0; 3], |a, b| if square(b) > square(a) { b } else { a });
    let length = square(along);
    points.iter().map(from_first).all(|v| {
        let share = (0..3).map(|a| v[a] * along[a]).sum::<f64>() / length;
        square(std::array::from_fn(|a| v[a] - share * along[a])) <= THINNEST * THINNEST * length
    })
}

/// The surface with triangles of the size that was asked for.
fn sized(points: &[Point], normals: &[[f32; 3]], how: &Meshing, scale: f64) -> Result<Surface, MeshingError> {
    let with = |cell| reconstruct(points, normals, PoissonSettings { cell, trim: how.trim });
    match how.size {
        TriangleSize::Spacing => Ok(with(None)?),
        TriangleSize::Cell(cell) => Ok(with(Some(cell / scale))?),
        TriangleSize::Count(asked) => counted(asked, with),
    }
}

/// The number of triangles goes by the square of the cells; a few tries find the size.
fn counted(
    asked: usize,
    with: impl Fn(Option<f64>) -> Result<Surface, PoissonError>,
) -> Result<Surface, MeshingError> {
    let off = |surface: &Surface| (surface.triangles.len() as f64 / asked as f64 - 1.0).abs();
    let mut now = with(None)?;
    let finest = FINEST * now.cell;
    let mut best = now.clone();
    for _ in 0..TRIES {
        if off(&best) <= ON_THE_MARK {
            break;
        }
        let cell = now.cell * (now.triangles.len() as f64 / asked as f64).sqrt();
        if cell < finest {
            let advice = "the points tell no more: upsample the cloud first";
            return Err(MeshingError::Count { asked, nearest: best.triangles.len(), advice });
        }
        // Cells as large as the cloud find nothing.
        let Ok(next) = with(Some(cell)) else { break };
        now = next;
        if off(&now) < off(&best) {
            best = now.clone();
        }
    }
    let advice = "ask for that, or set the size of triangles";
    let refused = MeshingError::Count { asked, nearest: best.triangles.len(), advice };
    if off(&best) <= NEAR_ENOUGH { Ok(best) } else { Err(refused) }
}

/// A colour for each corner: of the points nearest to it, the nearer the more.
fn colours(cloud: &Cloud, kept: &[usize], points: &[Point], surface: &Surface) -> Option<Vec<[u8; 3]>> {
    let parts = columns(cloud, [Role::Red, Role::Green, Role::Blue])?;
    let full = full_colour(parts);
    let of = |i: u32| parts.map(|part| part.get(kept[i as usize]) / full);
    let tree = KdTree::new(points);
    let mut near: Vec<Neighbour> = Vec::new();
    let mix = |v: &[f64; 3]| {
        tree.nearest(v.map(|c| c as f32), MIXED, &mut near);
        let mut sum = [0.0; 4];
        for n in near.iter().filter(|n| of(n.index).iter().all(|c| c.is_finite())) {
            let weight = 1.0 / (f64::from(n.distance_squared) + 1e-12);
            let colour = of(n.index);
            (0..3).for_each(|a| sum[a] += weight * colour[a]);
            sum[3] += weight;
        }
        // Grey, where no point near has a colour.
        let share = |a: usize| if sum[3] > 0.0 { sum[a] / sum[3] } else { 0.5 };
        [0, 1, 2].map(|a| (255.0 * share(a)).round().clamp(0.0, 255.0) as u8)
    };
    Some(surface.vertices.iter().map(mix).collect())
}
