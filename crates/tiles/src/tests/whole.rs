//! A result in tiles is the one that was asked for, whoever makes its tiles, and in which order.

use proptest::prelude::*;

use super::support::{Bench, bytes, entries, ground, joined, large, read};
use crate::{Folder, Input, TilesError, Tiling};
use densecloud_cloud::{Attribute, Cloud, Crs, Values};
use densecloud_formats::{CloudReader, Limits};

fn get(cloud: &Cloud, name: &str, row: usize) -> f64 {
    let attribute = cloud.attributes.iter().find(|a| a.name == name);
    attribute.unwrap_or_else(|| panic!("no {name}")).values.get(row)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]
    #[test]
    fn counts_are_exact_and_the_input_is_kept(
        seed in any::<u64>(), n in 400_u32..1500, tile_points in 60_u64..390, ratio in 1.0_f64..6.0, by_area in any::<bool>(),
        no_polish in any::<bool>(), spoilt in 0_usize..20, twice in 0_usize..20,
    ) {
        let mut cloud = ground(n, seed);
        for i in 0..spoilt {
            cloud.positions[7 * i][i % 3] = if i % 2 == 0 { f64::NAN } else { f64::INFINITY };
        }
        for i in 0..twice {
            cloud.positions[3 * i + 1] = cloud.positions[200 + 7 * i];
        }
        let finite: Vec<usize> =
            (0..n as usize).filter(|i| cloud.positions[*i].iter().all(|c| c.is_finite())).collect();
        let parent = tempfile::tempdir().expect("a folder");
        let ratio = ratio.to_string();
        let spread = if by_area { "area" } else { "neighbourhood" };
        let no_polish = no_polish.to_string();
        let options = [
            ("ratio", &*ratio),
            ("no_polish", &*no_polish),
            ("keep_input", "true"),
            ("source_fields", "true"),
            ("spread", spread),
        ];
        let bench = Bench::new(tile_points, &options, "a.npy");
        let input = bytes(&cloud, "a.npy");
        let folder = Folder::temporary(parent.path()).expect("a folder");
        let tiling = bench.plan(&input, &folder).expect("a plan");
        let own: u64 = (0..tiling.len()).map(|tile| tiling.points(tile)[0]).sum();
        prop_assert_eq!(own, finite.len() as u64);
        prop_assert!(tiling.len() > 1 || finite.len() as u64 <= tile_points);
        tiling.run_all(&bench.work()).expect("tiles");
        let dense = read(&joined(&tiling).expect("a result"));
        let wanted = (ratio.parse::<f64>().expect("a number") * finite.len() as f64).round() as usize;
        prop_assert_eq!(dense.positions.len(), wanted);
        let mut seen = vec![false; n as usize];
        for row in 0..wanted {
            let source = get(&dense, "source_index", row) as usize;
            prop_assert!(cloud.positions[source].iter().all(|c| c.is_finite()));
            prop_assert!((0.0..=256.0).contains(&get(&dense, "red", row)));
            // The class is the nearest one's.
            prop_assert_eq!(get(&dense, "tree", row), (source % 9) as f64);
            if get(&dense, "is_generated", row) == 0.0 {
                prop_assert!(!std::mem::replace(&mut seen[source], true), "twice");
                prop_assert_eq!(dense.positions[row], cloud.positions[source]);
                prop_assert_eq!(get(&dense, "gps_time", row), 1e6 + source as f64 / 8.0);
            }
        }
        prop_assert!(finite.iter().all(|i| seen[*i]), "an input point is not there");
        drop((tiling, folder));
        prop_assert_eq!(entries(parent.path()), 0);
    }
}

#[test]
fn order_repetition_threads_and_other_programs_change_nothing() {
    let mut cloud = ground(1500, 4);
    cloud.origin.crs = Some(Crs::Epsg { horizontal: 2992, vertical: None });
    let normals = [("ratio", "3"), ("normals", "estimate"), ("sensor", "0,0,1e5"), ("confidence", "true")];
    for (from, to) in [("a.laz", "b.las"), ("a.ply", "b.ply"), ("a.csv", "b.laz")] {
        let input = bytes(&cloud, from);
        let bench = Bench::new(300, &normals, to);
        let parent = tempfile::tempdir().expect("a folder");
        let expected = bench.dense(&input, parent.path()).expect("a result");
        assert_eq!(read(&expected).positions.len(), 4500);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().expect("threads");
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
        let alone = one.install(|| bench.dense(&input, parent.path())).expect("a result");
        assert!(alone == expected, "{from}: the number of threads changes the result");
        pool.install(|| {
            let path = parent.path().join("work");
            let folder = Folder::new(&path).expect("a folder");
            let tiles = bench.plan(&input, &folder).expect("a plan").len();
            assert!(tiles >= 5);
            // As other programs do, which have nothing but the folder.
            for tile in (0..tiles).rev().chain([2, 0, 2]) {
                let folder = Folder::at(&path);
                let tiling = Tiling::load(&folder).expect("a plan");
                if tile == 1 {
                    assert!(
                        matches!(tiling.join().map(drop), Err(TilesError::NotDone(left)) if left == [0, 1])
                    );
                }
                tiling.run(tile, &*bench.runner, &densecloud_cascade::Silent).expect("a part");
            }
            let tiling = Tiling::load(&folder).expect("a plan");
            assert!(matches!(
                tiling.run(tiles, &*bench.runner, &densecloud_cascade::Silent),
                Err(TilesError::NoTile { .. })
            ));
            assert!(joined(&tiling).expect("a result") == expected, "{from}: the order changes the result");
            folder.remove().expect("removed");
        });
        assert_eq!(entries(parent.path()), 0);
    }
}

#[test]
fn what_is_told_is_what_is_told_of_a_cloud_in_one_piece() {
    let mut cloud = ground(1200, 9);
    cloud.positions[5] = [f64::NAN; 3];
    cloud.positions[6] = cloud.positions[7];
    // Colours are shares, a class is in floats, and a quarter of a value is absent.
    for (place, of) in [(0, 7), (1, 5), (2, 3)] {
        let share = (0..1200).map(|i| f64::from(i * of % 256) / 256.0);
        cloud.attributes[place].values = Values::F64(share.collect());
    }
    cloud.attributes.push(Attribute {
        name: "heat".into(),
        values: Values::F32((0..1200).map(|i| if i % 4 == 0 { f32::NAN } else { 20.5 }).collect()),
    });
    let input = bytes(&cloud, "a.npy");
    let options = [("ratio", "2"), ("keep_input", "true")];
    let bench = Bench::new(250, &options, "b.las");
    let parent = tempfile::tempdir().expect("a folder");
    let folder = Folder::temporary(parent.path()).expect("a folder");
    let tiling = bench.plan(&input, &folder).expect("a plan");
    tiling.run_all(&bench.work()).expect("tiles");
    let join = tiling.join().expect("parts");
    let whole = densecloud::Upsampler::with_runner(bench.runner.clone(), bench.model.clone());
    let reader = CloudReader::open(&input[..], Limits::default()).expect("a header");
    let Input::Small(small, header) = Input::read(reader, 1200).expect("a cloud") else { panic!("small") };
    let small = densecloud::Input { cloud: *small, format: header.format };
    let whole = whole.upsample(small, bench.options.clone()).expect("a result");
    let told = |warnings: &[String]| {
        // How many lie apart is up to what is around them.
        warnings.iter().filter(|told| !told.contains("apart")).cloned().collect::<Vec<_>>()
    };
    assert_eq!(told(&join.report().warnings), told(&whole.report.warnings));
    assert_eq!(join.report().format, whole.report.format);
    assert_eq!(join.report().points_out, whole.report.points_out);
    let provenance = whole.report.provenance.replace(" keep_input", " tile_points=250 keep_input");
    assert_eq!(join.report().provenance, provenance);
    let mut made = Vec::new();
    join.write(&mut made).expect("a file");
    let made = read(&made);
    assert_eq!(made.positions.len(), 2398);
    let kinds = |attributes: &[Attribute]| -> Vec<(String, densecloud_cloud::Kind)> {
        attributes.iter().map(|a| (a.name.clone(), a.values.kind())).collect()
    };
    let mut of_whole = Vec::new();
    whole.write(&mut of_whole).expect("a file");
    assert_eq!(kinds(&made.attributes), kinds(&read(&of_whole).attributes));
    let heat = made.attributes.iter().find(|a| a.name == "heat").expect("heat");
    assert!((0..2398).all(|i| [20.5].contains(&heat.values.get(i)) || heat.values.get(i).is_nan()));
}

#[test]
fn one_tile_gives_the_bytes_of_a_cloud_in_none() {
    let mut cloud = ground(800, 6);
    cloud.positions[11] = [f64::INFINITY; 3];
    cloud.positions[12] = cloud.positions[13];
    for (from, to, no_polish) in [("a.las", "b.laz", "false"), ("a.csv", "b.ply", "true")] {
        cloud.positions.retain(|p| from != "a.las" || p[0].is_finite());
        cloud
            .attributes
            .iter_mut()
            .for_each(|a| a.values = a.values.gather(&(0..cloud.positions.len() as u32).collect::<Vec<_>>()));
        let input = bytes(&cloud, from);
        let options = [
            ("ratio", "4"),
            ("no_polish", no_polish),
            ("source_fields", "true"),
            ("confidence", "true"),
            ("normals", "estimate"),
            ("keep_input", "true"),
        ];
        let bench = Bench::new(1000, &options, to);
        let whole = densecloud::Upsampler::with_runner(bench.runner.clone(), bench.model.clone());
        let reader = CloudReader::open(&input[..], Limits::default()).expect("a header");
        let format = reader.header().format;
        let small = densecloud::Input { cloud: reader.read().expect("a cloud"), format };
        let whole = whole.upsample(small, bench.options.clone()).expect("a result");
        let mut expected = Vec::new();
        whole.write(&mut expected).expect("a file");
        let parent = tempfile::tempdir().expect("a folder");
        let folder = Folder::temporary(parent.path()).expect("a folder");
        let tiling = crate::plan(large(&input, 0), &bench.work(), &folder).expect("a plan");
        assert_eq!(tiling.len(), 1);
        tiling.run_all(&bench.work()).expect("a tile");
        assert!(joined(&tiling).expect("a result") == expected, "{from} to {to}");
    }
}

#[test]
fn clouds_without_points_or_without_extent_are_refused_as_in_one_piece() {
    for (point, told) in [([f64::NAN; 3], "no finite points"), ([1.0; 3], "all points are the same")] {
        let mut cloud = ground(300, 1);
        cloud.positions.fill(point);
        let bench = Bench::new(100, &[("ratio", "2")], "a.npy");
        let parent = tempfile::tempdir().expect("a folder");
        let why = bench.dense(&bytes(&cloud, "a.npy"), parent.path()).expect_err("nothing to do").to_string();
        assert!(why.contains(told), "{why}");
    }
    let bench = Bench::new(100, &[("points", "100")], "a.npy");
    let parent = tempfile::tempdir().expect("a folder");
    let input = bytes(&ground(300, 1), "a.npy");
    let why = bench.dense(&input, parent.path()).expect_err("too few").to_string();
    assert!(why.contains("100 points from 300"), "{why}");
    let bench = Bench::new(100, &[("ratio", "2"), ("attributes", "leaf:drop")], "a.npy");
    let why = bench.dense(&input, parent.path()).expect_err("no leaf").to_string();
    assert!(why.starts_with("no attribute \"leaf\"; the input has red"), "{why}");
    assert_eq!(entries(parent.path()), 0);
    drop(large(&input, 100));
}

#[test]
fn a_spacing_and_a_density_give_the_points_of_the_surface() {
    let input = bytes(&ground(3000, 2), "a.npy");
    let points = |option: (&str, &str), tile_points: u64| {
        let bench = Bench::new(tile_points, &[option], "a.npy");
        let parent = tempfile::tempdir().expect("a folder");
        read(&bench.dense(&input, parent.path()).expect("a result")).positions.len() as f64
    };
    // 40 by 40, a little more for its bumps.
    let density = points(("density", "6"), 700);
    assert!((9_600.0..11_500.0).contains(&density), "{density}");
    let spacing = points(("spacing", "0.4"), 1100);
    let wanted = 1600.0 * (0.885_f64 / 0.4).powi(2);
    assert!((1.0..1.2).contains(&(spacing / wanted)), "{spacing}");
}
