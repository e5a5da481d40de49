use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::{Backend, Batch, Fake, Output, Session};
use densecloud_cloud::Point;
use densecloud_geometry::Rng;

fn runner() -> impl LevelRunner {
    Patchwise::new(Arc::new(Fake::new()))
}

/// On a pool of so many threads.
fn on<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

fn sphere(n: u64, seed: u64) -> Vec<Position> {
    let mut random = Rng::new(seed);
    (0..n)
        .map(|_| {
            let p: Position = std::array::from_fn(|_| random.normal());
            let length = p.iter().map(|c| c * c).sum::<f64>().sqrt();
            p.map(|c| c / length)
        })
        .collect()
}

fn run(positions: &[Position], ratio: f64, threads: usize) -> Result<Upsampled, CascadeError> {
    on(threads, || upsample(positions, Target::Ratio(ratio), &CascadeOptions::default(), &runner(), &Silent))
}

#[test]
fn every_ratio_is_exact() {
    let cloud = sphere(200, 1);
    for (ratio, points) in [(1.0, 200), (1.7, 340), (2.0, 400), (5.3, 1060), (16.0, 3200), (64.0, 12800)] {
        assert_eq!(run(&cloud, ratio, 2).unwrap().positions.len(), points, "ratio {ratio}");
    }
    let by_count =
        upsample(&cloud, Target::Points(777), &CascadeOptions::default(), &runner(), &Silent).unwrap();
    assert_eq!(by_count.positions.len(), 777);
}

/// Random points of squares, each with its corner on the diagonal, its side and its number of points.
fn squares(of: &[(f64, f64, usize)], seed: u64) -> Vec<Position> {
    let mut random = densecloud_geometry::Rng::new(seed);
    let mut points = Vec::new();
    for &(corner, side, n) in of {
        points.extend((0..n).map(|_| [corner + side * random.f64(), corner + side * random.f64(), 0.0]));
    }
    points
}

#[test]
fn every_neighbourhood_gets_its_share() {
    // Two surfaces of a hundred to one in area, with as many points each; and a dense spot within a thin surface.
    let two = squares(&[(0.0, 1.0, 800), (3.0, 10.0, 800)], 1);
    let spot = squares(&[(0.0, 10.0, 3000), (4.0, 0.5, 400)], 2);
    let inside = |positions: &[Position], corner: f64, side: f64| {
        let within = |c: &f64| (corner - 0.02 * side..corner + 1.02 * side).contains(c);
        positions.iter().filter(|p| p[..2].iter().all(within)).count() as f64
    };
    for (cloud, corner, side) in [(two, 0.0, 1.0), (spot, 4.0, 0.5)] {
        let given = |spread| {
            let options = CascadeOptions { spread, ..CascadeOptions::default() };
            upsample(&cloud, Target::Ratio(4.0), &options, &runner(), &Silent).unwrap().positions
        };
        let before = inside(&cloud, corner, side);
        let (each, even) = (given(Spread::Neighbourhood), given(Spread::Area));
        let times = inside(&each, corner, side) / before;
        assert!((3.2..5.0).contains(&times), "{times} times the points");
        // By area, the dense part has less than it had.
        assert!(inside(&even, corner, side) < before, "{} of {before}", inside(&even, corner, side));
        // Any prefix has its share of both, too.
        let share = inside(&each[..each.len() / 4], corner, side) / (each.len() / 4) as f64;
        let whole = inside(&each, corner, side) / each.len() as f64;
        assert!((share / whole - 1.0).abs() < 0.15, "{share} of a prefix, {whole} of the whole");
    }
}

/// A backend that lifts every second of its points, but for those of a level's first patch.
#[derive(Clone)]
struct Lifting(Fake, Point);

impl Backend for Lifting {
    fn shape(&self) -> UnitShape {
        self.0.shape
    }

    fn units(&self) -> usize {
        self.0.units()
    }

    fn provider(&self) -> &str {
        self.0.provider()
    }

    fn open(&self) -> Result<Box<dyn Session>, BackendError> {
        Ok(Box::new(self.clone()))
    }
}

impl Session for Lifting {
    fn run(&mut self, unit: usize, batch: &Batch<'_>, output: &mut Output) -> Result<(), BackendError> {
        self.0.run(unit, batch, output)?;
        // A patch's own points come first, then the new ones.
        for new in output.dense.chunks_exact_mut(3).skip(batch.patch_points).step_by(2) {
            new.iter_mut().zip(self.1).for_each(|(c, by)| *c += by);
        }
        Ok(())
    }
}

#[test]
fn a_plane_stays_a_plane() {
    // Random points to the border of a floor, tilted so that no coordinate is constant.
    let height = |x: f64, y: f64| 0.25 * x - 0.5 * y + 7.0;
    let floor = squares(&[(0.0, 40.0, 1600)], 3).into_iter().map(|[x, y, _]| [x, y, height(x, y)]);
    let floor: Vec<Position> = floor.collect();
    // A fifth of the spacing, along the normal.
    let runner = Patchwise::new(Arc::new(Lifting(Fake::new(), [-0.013, 0.027, 0.053])));
    let options = CascadeOptions::default();
    let off =
        |points: &[Position]| points.iter().map(|p| (p[2] - height(p[0], p[1])).abs()).fold(0.0, f64::max);
    let rough = CascadeOptions { polish: false, ..options };
    let lifted = upsample(&floor, Target::Ratio(4.0), &rough, &runner, &Silent).unwrap().positions;
    assert!(off(&lifted) > 0.1, "the units lift: {}", off(&lifted));
    let dense = upsample(&floor, Target::Ratio(4.0), &options, &runner, &Silent).unwrap().positions;
    assert!(off(&dense) < 1e-4, "{}", off(&dense));
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let cloud = sphere(700, 2);
    let one = run(&cloud, 8.0, 1).unwrap();
    for threads in [2, 8] {
        assert_eq!(run(&cloud, 8.0, threads).unwrap(), one, "{threads} threads");
    }
}

#[test]
fn the_seed_changes_the_result_and_repeats_it() {
    let cloud = sphere(300, 3);
    let with = |seed| {
        let settings = CascadeOptions { seed, ..CascadeOptions::default() };
        upsample(&cloud, Target::Ratio(2.0), &settings, &runner(), &Silent).unwrap()
    };
    assert_eq!(with(7), with(7));
    assert_ne!(with(7), with(8));
}

#[test]
fn features_follow_their_points_across_levels() {
    // A session that checks what it is given: the fake's features are the first coordinate in the
    // patch's frame, so rows of one point must all carry the same value.
    struct Checked(Fake);
    impl Backend for Checked {
        fn shape(&self) -> crate::UnitShape {
            self.0.shape()
        }
        fn units(&self) -> usize {
            2
        }
        fn provider(&self) -> &str {
            "checked"
        }
        fn open(&self) -> Result<Box<dyn crate::Session>, BackendError> {
            Ok(Box::new(Inspect(self.0.clone())))
        }
    }
    struct Inspect(Fake);
    impl crate::Session for Inspect {
        fn run(
            &mut self,
            unit: usize,
            batch: &crate::Batch<'_>,
            output: &mut crate::Output,
        ) -> Result<(), BackendError> {
            assert_eq!(batch.skip.is_some(), unit > 0);
            if let Some(skip) = &batch.skip {
                let rows = skip.features.len() / 4;
                assert!(rows > 0);
                for (indices, distances) in skip.indices.chunks(5).zip(skip.distances.chunks(5)) {
                    assert!(indices.iter().all(|&i| (i as usize) < rows));
                    assert!(distances.is_sorted(), "nearest first");
                    for &i in indices {
                        let row = &skip.features[i as usize * 4..][..4];
                        assert!(
                            row.iter().all(|f| *f == row[0] && f.to_f32() != 0.0),
                            "an unwritten row: {row:?}"
                        );
                    }
                }
            }
            self.0.run(unit, batch, output)
        }
    }
    let runner = Patchwise::new(Arc::new(Checked(Fake::new())));
    let cloud = sphere(500, 4);
    on(2, || upsample(&cloud, Target::Ratio(8.0), &CascadeOptions::default(), &runner, &Silent)).unwrap();
}

#[test]
fn any_scale_and_offset_gives_the_same_shape() {
    // On a grid fine enough to be a shape and coarse enough to stay exact in f64 when moved, so that
    // both clouds are the same to the last bit of their local coordinates.
    let grid = f64::from(1 << 20);
    let cloud: Vec<Position> = sphere(300, 5).iter().map(|p| p.map(|c| (c * grid).round() / grid)).collect();
    let plain = run(&cloud, 4.0, 2).unwrap();
    // UTM coordinates of a shape two units wide.
    let moved: Vec<Position> =
        cloud.iter().map(|p| [p[0] + 524_288.0, p[1] + 4_194_304.0, p[2] - 128.0]).collect();
    let dense = run(&moved, 4.0, 2).unwrap();
    let mut worst = 0.0_f64;
    for (a, b) in plain.positions.iter().zip(&dense.positions) {
        for (k, offset) in [524_288.0, 4_194_304.0, -128.0].into_iter().enumerate() {
            worst = worst.max((a[k] + offset - b[k]).abs());
        }
    }
    assert!(worst < 1e-6, "off by {worst}");

    for scale in [1e-12, 1e12] {
        let scaled: Vec<Position> = cloud.iter().map(|p| p.map(|c| c * scale)).collect();
        let dense = run(&scaled, 4.0, 2).unwrap();
        assert!(dense.positions.iter().flatten().all(|c| c.abs() < 1.5 * scale));
    }
}

#[test]
fn non_finite_points_are_left_out_and_counted() {
    let mut cloud = sphere(100, 6);
    let clean = run(&cloud, 2.0, 1).unwrap();
    cloud.insert(10, [f64::NAN, 0.0, 0.0]);
    cloud.insert(50, [0.0, f64::INFINITY, 0.0]);
    let dense = run(&cloud, 2.0, 1).unwrap();
    assert_eq!(dense.dropped_non_finite, 2);
    assert_eq!(dense.positions, clean.positions);
}

#[test]
fn duplicates_count_towards_the_size_alone() {
    let mut cloud = sphere(100, 7);
    cloud.extend_from_within(..50);
    cloud.push(cloud[3].map(|c| -(-c)));
    let dense = run(&cloud, 2.0, 1).unwrap();
    assert_eq!((dense.positions.len(), dense.duplicates), (302, 51));
    let mut unique: Vec<_> = dense.positions.iter().map(|p| p.map(f64::to_bits)).collect();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), 302, "the result has duplicates");
}

#[test]
fn a_few_duplicates_cost_no_level() {
    let runs = |cloud: &[Position]| {
        let fake = Fake::new();
        let runner = Patchwise::new(Arc::new(fake.clone()));
        let dense =
            upsample(cloud, Target::Ratio(4.0), &CascadeOptions::default(), &runner, &Silent).unwrap();
        assert_eq!(dense.positions.len(), 4 * cloud.len());
        fake.batches()
    };
    let mut cloud = sphere(500, 7);
    let without = runs(&cloud);
    cloud.push(cloud[3]);
    assert_eq!(runs(&cloud), without);
}

#[test]
fn impossible_clouds_say_why() {
    let message = |cloud: &[Position]| run(cloud, 2.0, 1).unwrap_err().to_string();
    assert_eq!(message(&[]), "the cloud has no finite points");
    assert_eq!(message(&[[f64::NAN; 3]; 50]), "the cloud has no finite points");
    assert_eq!(message(&[[2.5; 3]; 50]), "all points are the same");
    assert!(message(&sphere(8, 1)).contains("8 distinct finite points; the model needs at least 9"));
    assert!(message(&[[-1e308; 3], [1e308; 3]]).contains("rescale"));
    assert!(matches!(run(&sphere(50, 1), 65.0, 1), Err(CascadeError::Ratio(_))));
    let settings = CascadeOptions { overlap: 0.5, ..CascadeOptions::default() };
    let low = upsample(&sphere(50, 1), Target::Ratio(2.0), &settings, &runner(), &Silent);
    assert!(matches!(low, Err(CascadeError::Overlap(_))));
    for inner in [-0.1, 1.1, f64::NAN] {
        let settings = CascadeOptions { inner, ..CascadeOptions::default() };
        let refused = upsample(&sphere(50, 1), Target::Ratio(2.0), &settings, &runner(), &Silent);
        assert!(matches!(refused, Err(CascadeError::Inner(_))), "{inner}");
    }
    for max_displacement in [0.0, -1.0, f64::NAN] {
        let settings = CascadeOptions { max_displacement, ..CascadeOptions::default() };
        let refused = upsample(&sphere(50, 1), Target::Ratio(2.0), &settings, &runner(), &Silent);
        assert!(matches!(refused, Err(CascadeError::MaxDisplacement(_))), "{max_displacement}");
    }
    for max_distance in [0.0, -1.0, f64::NAN] {
        let settings = CascadeOptions { max_distance, ..CascadeOptions::default() };
        let refused = upsample(&sphere(50, 1), Target::Ratio(2.0), &settings, &runner(), &Silent);
        assert!(matches!(refused, Err(CascadeError::MaxDistance(_))), "{max_distance}");
    }
}

#[test]
fn the_smallest_cloud_works() {
    assert_eq!(run(&sphere(9, 1), 16.0, 2).unwrap().positions.len(), 144);
}

#[test]
fn an_observer_sees_the_stages_and_can_stop_them() {
    struct Stopper {
        after: usize,
        seen: AtomicUsize,
    }
    impl Observer for Stopper {
        fn advance(&self, done: usize, total: usize) {
            assert!(done <= total);
            self.seen.fetch_add(1, Ordering::Relaxed);
        }
        fn cancelled(&self) -> bool {
            self.seen.load(Ordering::Relaxed) >= self.after
        }
    }
    let fake = Fake::new();
    let runner = Patchwise::new(Arc::new(fake.clone()));
    let stopper = Stopper { after: 5, seen: AtomicUsize::new(0) };
    let stopped = on(1, || {
        upsample(&sphere(500, 1), Target::Ratio(4.0), &CascadeOptions::default(), &runner, &stopper)
    });
    assert!(matches!(stopped, Err(CascadeError::Cancelled)));
    assert_eq!(fake.batches(), 5, "work went on after the stop");
}

#[test]
fn a_failing_backend_is_an_error() {
    let fake = Fake::failing_at(3);
    let runner = Patchwise::new(Arc::new(fake));
    let failed = upsample(&sphere(500, 1), Target::Ratio(2.0), &CascadeOptions::default(), &runner, &Silent);
    assert!(matches!(failed, Err(CascadeError::Backend(BackendError::Run { unit: 1, .. }))));
}

#[test]
fn memory_that_is_not_there_is_an_error_and_no_end_of_the_program() {
    let error = filled(0_u64, usize::MAX / 16).unwrap_err();
    assert!(matches!(error, CascadeError::OutOfMemory(_)), "{error}");
    assert_eq!(filled(7_u8, 3).unwrap(), [7; 3]);
}

#[test]
fn outliers_come_out_as_they_went_in_and_nothing_is_made_of_them() {
    let mut cloud = sphere(1000, 5);
    let mut random = Rng::new(9);
    let lone: Vec<Position> = (0..10).map(|_| std::array::from_fn(|_| 3.0 + 12.0 * random.f64())).collect();
    cloud.extend(&lone);
    for (ratio, polish) in [(1.0, true), (2.0, true), (4.0, true), (4.0, false), (16.0, true)] {
        let settings = CascadeOptions { polish, ..CascadeOptions::default() };
        let dense = upsample(&cloud, Target::Ratio(ratio), &settings, &runner(), &Silent).unwrap();
        assert_eq!(dense.positions.len(), (1010.0 * ratio) as usize);
        assert_eq!(dense.apart, 10);
        let far: Vec<_> = dense.positions.iter().filter(|p| p[0] > 2.0).collect();
        assert_eq!(far.len(), 10, "{ratio}: {far:?}");
        for q in &lone {
            let near = far.iter().any(|p| (0..3).all(|a| (p[a] - q[a]).abs() < 1e-4));
            assert!(near, "{q:?} is not among {far:?}");
        }
    }
}

/// A runner without sessions, as on a device: it makes a whole level at once, and its features stay in a table of its own.
struct Device;

struct Resident {
    /// The unit that filled the table.
    unit: usize,
    /// For each row, the first coordinate of its point.
    rows: Vec<f32>,
}

impl LevelRunner for Device {
    fn shape(&self) -> UnitShape {
        UnitShape { patch_size: 32, neighbours: 8, channels: 1 }
    }

    fn units(&self) -> usize {
        3
    }

    fn provider(&self) -> &str {
        "device"
    }

    fn run_level(
        &self,
        level: &LevelInput<'_>,
        previous: Option<&FeatureTable>,
        _: &dyn Observer,
    ) -> Result<LevelOutput, CascadeError> {
        assert_eq!(previous.is_some(), level.unit > 0);
        assert_eq!(level.skip.is_some(), level.unit > 0);
        if let (Some(table), Some(skip)) = (previous, level.skip) {
            let table = table.get::<Resident>().expect("its own table");
            assert_eq!(table.unit + 1, level.unit);
            for (i, p) in level.points.iter().enumerate() {
                let nearest = (table.rows[skip.rows(i)[0] as usize] - p[0]).powi(2);
                assert!(nearest <= skip.distances(i)[0] + 1e-6, "the row of another point");
            }
        }
        let mut rows = vec![f32::NAN; level.points.len()];
        let mut made = Vec::new();
        for (i, &p) in level.points.iter().enumerate() {
            rows[level.patches.row(i)] = p[0];
            made.extend([level.made(p, i), level.made(p.map(|c| 1.01 * c), i)]);
        }
        let features = level.want_features.then(|| FeatureTable::new(Resident { unit: level.unit, rows }));
        Ok(LevelOutput { made, features })
    }
}

#[test]
fn a_runner_takes_whole_levels_and_keeps_its_own_table() {
    let dense =
        upsample(&sphere(300, 8), Target::Ratio(8.0), &CascadeOptions::default(), &Device, &Silent).unwrap();
    assert_eq!(dense.positions.len(), 2400);
}

#[test]
fn a_table_of_another_runner_is_refused() {
    let points: Vec<_> = sphere(40, 1).iter().map(|p| p.map(|c| c as f32)).collect();
    let options = CascadeOptions::default();
    let sites = Arc::new(sites::Sites::new(points.clone()));
    let patches = Patches::cover(&sites, None, 32, &options, &mut Rng::new(1), 0, &Silent).unwrap();
    let level = LevelInput { unit: 1, points: &points, patches: &patches, skip: None, want_features: false };
    let foreign = FeatureTable::new(7_u8);
    let refused = runner().run_level(&level, Some(&foreign), &Silent).err().unwrap().to_string();
    assert!(refused.contains("another runner's"), "{refused}");
}

/// What is made of a cloud by what is known of the whole, and what is known then.
fn with_globals(
    cloud: &[Position],
    known: Option<&Globals>,
) -> Result<(Vec<Position>, Globals), CascadeError> {
    let (options, runner) = (CascadeOptions::default(), runner());
    let input = Input::prepare(cloud).unwrap();
    let mut globals = known.cloned().unwrap_or_else(|| Globals::new(input.frame));
    let run = Run { options: &options, runner: &runner, observer: &Silent, part: None };
    let dense = cascade(input, (Target::Ratio(4.0), Choice::Polished), &run, &mut globals)?;
    Ok((dense.positions, globals))
}

#[test]
fn what_is_known_of_the_whole_is_not_looked_for_again() {
    // Rough, so that points may be taken for outliers, and unlike clean input.
    let mut random = Rng::new(2);
    let mut rough = |p: &Position| {
        let height = 1.0 + 0.3 * random.f64();
        p.map(|c| c * height)
    };
    let cloud: Vec<Position> = sphere(400, 3).iter().map(&mut rough).collect();
    let (dense, globals) = with_globals(&cloud, None).unwrap();
    assert_eq!(globals.sizes, [800, 1600]);
    let known =
        |level: &globals::LevelGlobals| level.usual_distance.is_some() && level.most_strayed.is_some();
    assert!(globals.usual_spacings[0].is_some() && globals.evenness.is_some());
    assert!(globals.levels.iter().all(known), "{globals:?}");
    assert_eq!(with_globals(&cloud, Some(&globals)).unwrap(), (dense.clone(), globals.clone()));

    // Every one of them is what points are placed by; the evenness, where there is a smooth border.
    let changed = |cloud: &[Position], change: fn(&mut Globals)| {
        let (dense, mut globals) = with_globals(cloud, None).unwrap();
        change(&mut globals);
        with_globals(cloud, Some(&globals)).ok().is_none_or(|(other, _)| other != dense)
    };
    let square: Vec<Position> = (0..400).map(|_| [random.f64(), random.f64(), 0.0]).collect();
    assert!(changed(&square, |g| g.evenness = Some(1.0 - g.evenness.unwrap().round())), "the evenness");
    let changed = |change| changed(&cloud, change);
    assert!(changed(|g| g.usual_spacings[0] = Some(0.001)), "the usual spacing");
    assert!(changed(|g| g.usual_point = g.usual_point.map(|p| p + 0.5)), "the usual point's area");
    assert!(changed(|g| g.levels[0].usual_distance = Some(0.01)), "the usual distance");
    assert!(changed(|g| g.levels[1].most_strayed = Some(0.5)), "how far points may stray");
    assert!(changed(|g| g.polish.trust = g.polish.trust.map(|t| 1.0 - t.round())), "the trust");
    assert!(changed(|g| g.polish.input_a_sample = Some(1.0)), "the density");
    assert!(
        changed(|g| g.polish.usual_point = g.polish.usual_point.map(|p| p + 0.5)),
        "its area in the polish"
    );
    assert!(changed(|g| g.polish.midpoints = Some(0)), "the midpoints");
    assert!(changed(|g| g.polish.usual_area = g.polish.usual_area.map(|a| 3.0 * a)), "the usual area");
    assert!(
        changed(|g| g.polish.usual_density = g.polish.usual_density.map(|d| 3.0 * d)),
        "the usual density"
    );
}
