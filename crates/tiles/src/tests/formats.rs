//! Whatever comes and goes.

use super::support::{Bench, bytes, entries, ground, read};
use crate::TilesError;
use densecloud_cloud::{Crs, Role};

#[test]
fn every_format_that_is_written_in_parts_is_written() {
    let mut cloud = ground(900, 5);
    cloud.origin.crs = Some(Crs::Epsg { horizontal: 2992, vertical: None });
    let parent = tempfile::tempdir().expect("a folder");
    for from in ["a.ply", "a.las", "a.laz", "a.xyz", "a.csv", "a.npy", "a.pcd", "a.e57", "a.copc.laz"] {
        let input = bytes(&cloud, from);
        for to in ["b.ply", "b.las", "b.laz", "b.xyz", "b.csv", "b.npy", "b.pcd", "b.copc.laz"] {
            if from != "a.ply" && !["b.ply", "b.laz", "b.copc.laz"].contains(&to) && from[1..] != to[1..] {
                continue;
            }
            let bench = Bench::new(250, &[("ratio", "2")], to);
            let dense =
                bench.dense(&input, parent.path()).unwrap_or_else(|why| panic!("{from} to {to}: {why}"));
            let dense = read(&dense);
            assert_eq!(dense.positions.len(), 1800, "{from} to {to}");
            let near = dense.positions.iter().all(|p| (5e5 - 1.0..5e5 + 41.0).contains(&p[0]));
            assert!(near, "{from} to {to}: not where it was");
            let is_red = |name: &str| Role::of(name) == Some(Role::Red);
            let named = dense.attributes.iter().any(|a| is_red(&a.name)) || to == "b.xyz" || from == "a.xyz";
            assert!(named, "{from} to {to}: no colour");
            let holds =
                |name: &str| name.ends_with(".las") || name.ends_with(".laz") || name.ends_with(".ply");
            if holds(from) && holds(to) {
                assert_eq!(dense.origin.crs, cloud.origin.crs, "{from} to {to}");
            }
        }
    }
    assert_eq!(entries(parent.path()), 0);
}

#[test]
fn what_needs_a_whole_cloud_is_refused_before_any_work() {
    let parent = tempfile::tempdir().expect("a folder");
    let input = bytes(&ground(300, 5), "a.e57");
    let bench = Bench::new(100, &[("ratio", "2")], "b.e57");
    let why = bench.dense(&input, parent.path()).expect_err("E57");
    assert!(matches!(why, TilesError::NotInParts { .. }));
    let why = why.to_string();
    assert!(
        why.contains("E57 is written of a whole cloud") && why.contains(".ply") && why.contains("100 points"),
        "{why}"
    );
    assert!(!why.contains(".e57"), "{why}");
    // As it is where nobody says which.
    let mut bench = Bench::new(100, &[("ratio", "2")], "b.e57");
    bench.options.format = None;
    assert!(matches!(bench.dense(&input, parent.path()), Err(TilesError::NotInParts { .. })));
}
