use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::{Backend, Fake};
use densecloud_geometry::Rng;

fn workers(threads: usize) -> Workers {
    Workers::new(Arc::new(Fake::new()), threads).unwrap()
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
    upsample(positions, Target::Ratio(ratio), &CascadeOptions::default(), &workers(threads), &Silent)
}

#[test]
fn every_ratio_is_exact() {
    let cloud = sphere(200, 1);
    for (ratio, points) in [(1.0, 200), (1.7, 340), (2.0, 400), (5.3, 1060), (16.0, 3200), (64.0, 12800)] {
        assert_eq!(run(&cloud, ratio, 2).unwrap().positions.len(), points, "ratio {ratio}");
    }
    let by_count =
        upsample(&cloud, Target::Points(777), &CascadeOptions::default(), &workers(1), &Silent).unwrap();
    assert_eq!(by_count.positions.len(), 777);
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
        upsample(&cloud, Target::Ratio(2.0), &settings, &workers(2), &Silent).unwrap()
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
        fn shape(&self) -> crate::backend::UnitShape {
            self.0.shape()
        }
        fn units(&self) -> usize {
            2
        }
        fn provider(&self) -> &str {
            "checked"
        }
        fn open(&self) -> Result<Box<dyn crate::backend::Session>, BackendError> {
            Ok(Box::new(Inspect(self.0.clone())))
        }
    }
    struct Inspect(Fake);
    impl crate::backend::Session for Inspect {
        fn run(
            &mut self,
            unit: usize,
            batch: &crate::backend::Batch<'_>,
            output: &mut crate::backend::Output,
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
    let workers = Workers::new(Arc::new(Checked(Fake::new())), 2).unwrap();
    upsample(&sphere(500, 4), Target::Ratio(8.0), &CascadeOptions::default(), &workers, &Silent).unwrap();
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
fn impossible_clouds_say_why() {
    let message = |cloud: &[Position]| run(cloud, 2.0, 1).unwrap_err().to_string();
    assert_eq!(message(&[]), "the cloud has no finite points");
    assert_eq!(message(&[[f64::NAN; 3]; 50]), "the cloud has no finite points");
    assert_eq!(message(&[[2.5; 3]; 50]), "all points are the same");
    assert!(message(&sphere(8, 1)).contains("8 distinct finite points; the model needs at least 9"));
    assert!(message(&[[-1e308; 3], [1e308; 3]]).contains("rescale"));
    assert!(matches!(run(&sphere(50, 1), 65.0, 1), Err(CascadeError::Ratio(_))));
    let settings = CascadeOptions { overlap: 0.5, ..CascadeOptions::default() };
    let low = upsample(&sphere(50, 1), Target::Ratio(2.0), &settings, &workers(1), &Silent);
    assert!(matches!(low, Err(CascadeError::Overlap(_))));
    for inner in [-0.1, 1.1, f64::NAN] {
        let settings = CascadeOptions { inner, ..CascadeOptions::default() };
        let refused = upsample(&sphere(50, 1), Target::Ratio(2.0), &settings, &workers(1), &Silent);
        assert!(matches!(refused, Err(CascadeError::Inner(_))), "{inner}");
    }
    for max_displacement in [0.0, -1.0, f64::NAN] {
        let settings = CascadeOptions { max_displacement, ..CascadeOptions::default() };
        let refused = upsample(&sphere(50, 1), Target::Ratio(2.0), &settings, &workers(1), &Silent);
        assert!(matches!(refused, Err(CascadeError::MaxDisplacement(_))), "{max_displacement}");
    }
    for max_distance in [0.0, -1.0, f64::NAN] {
        let settings = CascadeOptions { max_distance, ..CascadeOptions::default() };
        let refused = upsample(&sphere(50, 1), Target::Ratio(2.0), &settings, &workers(1), &Silent);
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
    let workers = Workers::new(Arc::new(fake.clone()), 1).unwrap();
    let stopper = Stopper { after: 5, seen: AtomicUsize::new(0) };
    let stopped =
        upsample(&sphere(500, 1), Target::Ratio(4.0), &CascadeOptions::default(), &workers, &stopper);
    assert!(matches!(stopped, Err(CascadeError::Cancelled)));
    assert_eq!(fake.batches(), 5, "work went on after the stop");
}

#[test]
fn a_failing_backend_is_an_error() {
    let fake = Fake::failing_at(3);
    let workers = Workers::new(Arc::new(fake), 2).unwrap();
    let failed = upsample(&sphere(500, 1), Target::Ratio(2.0), &CascadeOptions::default(), &workers, &Silent);
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
        let dense = upsample(&cloud, Target::Ratio(ratio), &settings, &workers(2), &Silent).unwrap();
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
