//! What is done to a cloud before it is made dense: points that are no surface leave it, noise is smoothed, and what is denser
//! than anybody needs is thinned.

use std::collections::HashSet;

use densecloud_cloud::{Cloud, Frame, FrameError, Point, Position};
use densecloud_geometry::{
    Smoothing, TooManyPoints, check_count, far, farthest_point_sampling, lone, one_a_voxel, small_groups,
    smooth, spaced, sparse,
};

/// What is done, in this order. The default leaves duplicates and points that stand alone out.
#[derive(Debug, Clone, PartialEq)]
pub struct Cleaning {
    /// Whether a point at the very place of an earlier one is left out.
    pub duplicates: bool,
    /// Points with fewer than so many others within a radius, in the cloud's units, are left out.
    pub radius: Option<(f64, usize)>,
    /// Points so many times further from others than these from each other, or beside a surface by half as much, are left out:
    /// see [`lone`].
    pub outliers: Option<f64>,
    /// Points whose mean distance to 8 others is more than so many standard deviations above that of all are left out: see
    /// [`far`].
    pub statistical: Option<f64>,
    /// Groups of fewer points are left out: see [`small_groups`].
    pub groups: Option<usize>,
    /// Points are moved where they are noisier than so many local spacings: see [`smooth`].
    pub smooth: Option<(Smoothing, f64)>,
    /// Fewer points are kept.
    pub thin: Option<Thinning>,
}

/// How a cloud is thinned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Thinning {
    /// One point for each cube of this side, in the cloud's units: see [`one_a_voxel`].
    Voxel(f64),
    /// No point nearer to another than this, in the cloud's units: see [`spaced`].
    Spacing(f64),
    /// So many points, as far from each other as can be.
    Points(usize),
}

impl Default for Cleaning {
    fn default() -> Self {
        let (radius, statistical, groups, smooth, thin) = (None, None, None, None, None);
        Self { duplicates: true, radius, outliers: Some(Self::OUTLIERS), statistical, groups, smooth, thin }
    }
}

impl Cleaning {
    /// The usual factor of [`Self::outliers`].
    pub const OUTLIERS: f64 = 3.0;
    /// The usual noise, in local spacings, above which points are moved.
    pub const GATE: f64 = 0.45;
}

/// Others whose mean distance is compared with that of all.
const STATISTICAL: usize = 8;

/// How many points were left out, by each step, and how many moved.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cleaned {
    /// Points before.
    pub points_in: usize,
    /// Points after.
    pub points_out: usize,
    /// With a coordinate that is NaN or infinite.
    pub non_finite: usize,
    /// At the place of an earlier one.
    pub duplicates: usize,
    /// With few others in the radius.
    pub sparse: usize,
    /// Alone, or beside a surface.
    pub outliers: usize,
    /// Further from others than most.
    pub statistical: usize,
    /// In small groups.
    pub groups: usize,
    /// By thinning.
    pub thinned: usize,
    /// Moved, of those that are kept until then.
    pub moved: usize,
    /// Left where they were since the surface about them is smooth enough.
    pub smooth: usize,
    /// Left where they were since there is no surface about them.
    pub no_surface: usize,
    /// The median of the noise before, in local spacings; 0 where it was not asked for.
    pub noise: f64,
}

/// Why a cloud cannot be cleaned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CleanError {
    /// There is no finite point, or all are the same.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The cloud has more points than indices can tell apart.
    #[error(transparent)]
    TooManyPoints(#[from] TooManyPoints),
    /// Nothing is left.
    #[error("no point is left after {after}; {points} there were before it")]
    NothingLeft {
        /// The step that left nothing.
        after: &'static str,
        /// The points before it.
        points: usize,
    },
}

/// Cleans a cloud. Points that are kept keep their order and attributes; those that are not moved keep their coordinates to the
/// last bit. The same cloud gives the same on any number of threads.
///
/// Tables that are about points by their numbers (a mesh's faces) are dropped where any point is, and a note says so.
///
/// # Errors
/// [`CleanError`]; the cloud is then as it was, or less.
///
/// # Panics
/// When a length, a number of neighbours or of points in `cleaning` is not positive.
pub fn clean(cloud: &mut Cloud, cleaning: &Cleaning) -> Result<Cleaned, CleanError> {
    check_count(cloud.positions.len())?;
    let mut told = Cleaned { points_in: cloud.positions.len(), ..Cleaned::default() };
    let finite = marks(&cloud.positions, |p| !p.iter().all(|c| c.is_finite()));
    let mut kept = Kept::all(&cloud.positions);
    told.non_finite = kept.leave_out("points that are not finite", &finite)?;
    if cleaning.duplicates {
        let mut seen = HashSet::with_capacity(kept.positions.len());
        // Zero has two signs.
        let again = marks(&kept.positions, |p| !seen.insert(p.map(|c| (c + 0.0).to_bits())));
        told.duplicates = kept.leave_out("duplicates", &again)?;
    }
    if let Some((radius, neighbours)) = cleaning.radius {
        let (frame, points) = kept.local()?;
        let sparse = sparse(&points, (radius / frame.scale()) as f32, neighbours);
        told.sparse = kept.leave_out("points with few others in the radius", &sparse)?;
    }
    if let Some(factor) = cleaning.outliers {
        let alone = lone(&kept.local()?.1, factor as f32);
        told.outliers = kept.leave_out("outliers", &alone)?;
    }
    if let Some(deviations) = cleaning.statistical {
        let far = far(&kept.local()?.1, STATISTICAL, deviations);
        told.statistical = kept.leave_out("points further from others than most", &far)?;
    }
    if let Some(least) = cleaning.groups {
        let small = small_groups(&kept.local()?.1, least);
        told.groups = kept.leave_out("small groups", &small)?;
    }
    if let Some((method, gate)) = cleaning.smooth {
        kept.smooth(method, gate, &mut told)?;
    }
    if let Some(thinning) = cleaning.thin {
        let before = kept.indices.len();
        kept.thin(thinning)?;
        told.thinned = before - kept.indices.len();
    }
    told.points_out = kept.indices.len();
    kept.put_into(cloud);
    Ok(told)
}

fn marks(positions: &[Position], is_out: impl FnMut(&Position) -> bool) -> Vec<bool> {
    positions.iter().map(is_out).collect()
}

/// The points that are kept so far.
struct Kept {
    /// Their numbers in the cloud.
    indices: Vec<u32>,
    positions: Vec<Position>,
}

impl Kept {
    fn all(positions: &[Position]) -> Self {
        Self {
            indices: densecloud_geometry::indices(positions.len()).collect(),
            positions: positions.to_vec(),
        }
    }

    fn local(&self) -> Result<(Frame, Vec<Point>), FrameError> {
        let frame = Frame::fit(&self.positions)?;
        let points = self.positions.iter().map(|p| frame.to_local(*p)).collect();
        Ok((frame, points))
    }

    /// Leaves out those that are marked, and says how many.
    fn leave_out(&mut self, what: &'static str, marked: &[bool]) -> Result<usize, CleanError> {
        let before = self.indices.len();
        let mut marks = marked.iter();
        self.indices.retain(|_| marks.next() == Some(&false));
        let mut marks = marked.iter();
        self.positions.retain(|_| marks.next() == Some(&false));
        if self.indices.is_empty() {
            return Err(CleanError::NothingLeft { after: what, points: before });
        }
        Ok(before - self.indices.len())
    }

    fn smooth(&mut self, method: Smoothing, gate: f64, told: &mut Cleaned) -> Result<(), CleanError> {
        let (frame, points) = self.local()?;
        let smoothed = smooth(&points, method, gate as f32);
        let pairs = points.iter().zip(&smoothed.points);
        for ((position, (from, to)), noise) in self.positions.iter_mut().zip(pairs).zip(&smoothed.noise) {
            match from != to {
                true => told.moved += 1,
                false if noise.is_infinite() => told.no_surface += 1,
                false => told.smooth += 1,
            }
            // Added where coordinates have all their digits.
            (0..3).for_each(|a| position[a] += f64::from(to[a] - from[a]) * frame.scale());
        }
        let mut noise = smoothed.noise;
        noise.sort_unstable_by(f32::total_cmp);
        told.noise = f64::from(noise[noise.len() / 2]);
        Ok(())
    }

    fn thin(&mut self, thinning: Thinning) -> Result<(), CleanError> {
        let chosen = match thinning {
            Thinning::Voxel(size) => one_a_voxel(&self.positions, size),
            Thinning::Spacing(spacing) => spaced(&self.positions, spacing, 0),
            Thinning::Points(count) if count >= self.indices.len() => return Ok(()),
            Thinning::Points(count) => {
                let mut chosen = farthest_point_sampling(&self.local()?.1, count, 0);
                chosen.sort_unstable();
                chosen
            }
        };
        let at = |i: &u32| *i as usize;
        self.indices = chosen.iter().map(|i| self.indices[at(i)]).collect();
        self.positions = chosen.iter().map(|i| self.positions[at(i)]).collect();
        Ok(())
    }

    fn put_into(self, cloud: &mut Cloud) {
        if self.indices.len() < cloud.positions.len() {
            let dropped = cloud.origin.drop_references();
            if !dropped.is_empty() {
                cloud.notes.push(format!(
                    "not carried over: {} (about points by their numbers)",
                    dropped.join(", ")
                ));
            }
            for attribute in &mut cloud.attributes {
                attribute.values = attribute.values.gather(&self.indices);
            }
        }
        cloud.positions = self.positions;
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use densecloud_cloud::{Attribute, Origin, Table, Values};
    use densecloud_geometry::Rng;

    use super::*;

    /// A square of 1,600 random points about a place in UTM coordinates, numbered.
    fn square() -> Cloud {
        let mut random = Rng::new(1);
        let mut at = || random.f64();
        let positions = (0..1600).map(|_| [500_000.0 + at(), 5_000_000.0 + at(), 100.0]).collect::<Vec<_>>();
        numbered(positions)
    }

    fn numbered(positions: Vec<Position>) -> Cloud {
        let values = Values::U32((0..positions.len() as u32).collect());
        let attributes = vec![Attribute { name: "number".into(), values }];
        Cloud { attributes, ..Cloud::from(positions) }
    }

    fn numbers(cloud: &Cloud) -> Vec<u32> {
        let Values::U32(numbers) = &cloud.attributes[0].values else { panic!("the type has changed") };
        numbers.clone()
    }

    const NOTHING: Cleaning = Cleaning {
        duplicates: false,
        radius: None,
        outliers: None,
        statistical: None,
        groups: None,
        smooth: None,
        thin: None,
    };

    #[test]
    fn each_step_leaves_its_own_out_and_attributes_go_with_their_points() {
        let mut cloud = square();
        let first = cloud.positions[0];
        cloud.positions.push(first);
        cloud.positions.push([f64::NAN, 0.0, 0.0]);
        cloud.positions.push([500_000.5, 5_000_000.5, 100.6]);
        let mut cloud = numbered(cloud.positions);
        let told = clean(&mut cloud, &Cleaning::default()).expect("points");
        assert_eq!((told.points_in, told.points_out), (1603, cloud.positions.len()));
        assert_eq!((told.duplicates, told.non_finite), (1, 1));
        let numbers = numbers(&cloud);
        assert!(numbers.is_sorted() && numbers.len() == told.points_out);
        assert!(told.outliers < 6 && numbers.last() == Some(&1599), "{told:?}");
        let mut again = cloud.clone();
        let none = clean(&mut again, &NOTHING).expect("points");
        assert_eq!((none.points_out, &again), (told.points_out, &cloud));
    }

    #[test]
    fn lengths_are_in_the_clouds_units() {
        let by = |cleaning: Cleaning| {
            let mut cloud = square();
            let told = clean(&mut cloud, &cleaning).expect("points");
            assert_eq!(told.points_out, cloud.positions.len());
            told
        };
        let voxels = by(Cleaning { thin: Some(Thinning::Voxel(0.1)), ..NOTHING });
        assert!((90..=121).contains(&voxels.points_out), "{voxels:?}");
        let spaced = by(Cleaning { thin: Some(Thinning::Spacing(0.1)), ..NOTHING });
        assert!((60..=120).contains(&spaced.points_out), "{spaced:?}");
        let counted = by(Cleaning { thin: Some(Thinning::Points(100)), ..NOTHING });
        assert_eq!((counted.points_out, counted.thinned), (100, 1500));
        assert_eq!(by(Cleaning { thin: Some(Thinning::Points(9999)), ..NOTHING }).thinned, 0);
        assert_eq!(by(Cleaning { radius: Some((2.0, 1599)), ..NOTHING }).sparse, 0);
        let far = by(Cleaning { radius: Some((0.02, 1)), ..NOTHING }).sparse;
        // exp(-1600 pi 0.02^2) of random points have no other there.
        assert!((150..=280).contains(&far), "{far}");
    }

    #[test]
    fn smoothing_moves_noisy_points_alone() {
        let mut cloud = square();
        let mut random = Rng::new(7);
        for p in cloud.positions.iter_mut().filter(|p| p[0] > 500_000.5) {
            p[2] += 0.02 * random.normal();
        }
        let before = cloud.clone();
        let smooth = Some((Smoothing::MovingLeastSquares, 0.2));
        let told = clean(&mut cloud, &Cleaning { smooth, ..NOTHING }).expect("points");
        let rough = |cloud: &Cloud| cloud.positions.iter().map(|p| (p[2] - 100.0).abs()).sum::<f64>();
        assert!(rough(&cloud) < 0.6 * rough(&before), "{} of {}: {told:?}", rough(&cloud), rough(&before));
        let pairs = || cloud.positions.iter().zip(&before.positions);
        assert!(pairs().filter(|(_, q)| q[0] < 500_000.4).all(|(p, q)| p == q), "what is clean stays");
        assert_eq!(pairs().filter(|(p, q)| p != q).count(), told.moved);
        assert_eq!(told.moved + told.smooth + told.no_surface, 1600);
    }

    #[test]
    fn faces_go_where_points_go() {
        let face = Table { name: "face".into(), rows: 0, columns: Vec::new() };
        let with = || Cloud {
            origin: Origin { tables: Arc::new(vec![face.clone()]), ..Origin::default() },
            ..square()
        };
        let mut cloud = with();
        clean(&mut cloud, &NOTHING).expect("points");
        assert_eq!((cloud.origin.tables.len(), cloud.notes.len()), (1, 0));
        clean(&mut cloud, &Cleaning { thin: Some(Thinning::Points(50)), ..NOTHING }).expect("points");
        assert_eq!(cloud.origin.tables.len(), 0);
        assert_eq!(cloud.notes, ["not carried over: face (about points by their numbers)"]);
    }

    #[test]
    fn a_step_that_leaves_nothing_is_named() {
        let mut cloud = square();
        let why = clean(&mut cloud, &Cleaning { radius: Some((1e-6, 3)), ..NOTHING }).expect_err("nothing");
        assert_eq!(
            why.to_string(),
            "no point is left after points with few others in the radius; 1600 there were before it"
        );
        assert!(clean(&mut Cloud::default(), &Cleaning::default()).is_err());
    }
}
