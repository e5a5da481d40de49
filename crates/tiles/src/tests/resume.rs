//! Works that are stopped, fail, or are gone on with.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use super::support::{Bench, bytes, entries, ground, joined, large};
use crate::{Folder, Step, TilesError, Tiling, Watch, plan};
use densecloud_cascade::{CascadeError, Fake, Observer, Patchwise};

/// Stops a work once so many tiles are done.
struct StopAt {
    tiles: u32,
    done: AtomicU32,
}

impl Observer for StopAt {
    fn cancelled(&self) -> bool {
        self.done.load(Ordering::Relaxed) >= self.tiles
    }
}

impl Watch for StopAt {
    fn step(&self, step: Step) {
        if let Step::Tile { done, .. } = step {
            self.done.store(done, Ordering::Relaxed);
        }
    }
}

/// Goes on in the folder, or begins there.
fn gone_on(bench: &Bench, input: &[u8], folder: &Folder) -> Result<Vec<u8>, TilesError> {
    let large = large(input, bench.tile_points);
    let tiling = match folder.has_plan() {
        true => Tiling::resumed(large, &bench.work(), folder)?,
        false => plan(large, &bench.work(), folder)?,
    };
    tiling.run_all(&bench.work())?;
    joined(&tiling)
}

#[test]
fn a_work_that_is_stopped_anywhere_goes_on_to_the_same_bytes() {
    let input = bytes(&ground(1000, 3), "a.laz");
    let parent = tempfile::tempdir().expect("a folder");
    let options = [("ratio", "2"), ("source_fields", "true")];
    let bench = || Bench::new(220, &options, "b.laz");
    let expected = bench().dense(&input, parent.path()).expect("a result");
    let tiles = {
        let folder = Folder::temporary(parent.path()).expect("a folder");
        bench().plan(&input, &folder).expect("a plan").len()
    };
    assert!(tiles >= 4);
    for stop in 0..tiles {
        let folder = Folder::kept(parent.path(), "dense.laz").expect("a folder");
        let stopped = Bench { watch: Box::new(StopAt { tiles: stop, done: AtomicU32::new(0) }), ..bench() };
        let why = gone_on(&stopped, &input, &folder).expect_err("stopped");
        assert!(matches!(why, TilesError::Cascade(CascadeError::Cancelled)), "{stop}: {why}");
        drop(folder);
        let folder = Folder::kept(parent.path(), "dense.laz").expect("a folder");
        assert_eq!(folder.has_plan(), stop > 0);
        assert!(gone_on(&bench(), &input, &folder).expect("a result") == expected, "{stop}");
        folder.remove().expect("removed");
    }
    assert_eq!(entries(parent.path()), 0);
}

#[test]
fn another_work_does_not_go_on_with_it() {
    let input = bytes(&ground(600, 3), "a.ply");
    let parent = tempfile::tempdir().expect("a folder");
    let bench = Bench::new(220, &[("ratio", "2")], "b.ply");
    let folder = Folder::kept(parent.path(), "b.ply").expect("a folder");
    gone_on(&bench, &input, &folder).expect("a result");
    let refused = |bench: &Bench, input: &[u8], what: &str| {
        let why = gone_on(bench, input, &folder).expect_err(what).to_string();
        assert!(why.contains(&format!("begun with another {what}")), "{why}");
    };
    refused(
        &Bench::new(220, &[("ratio", "3")], "b.ply"),
        &input,
        "set of options (ratio=2, and now ratio=3)",
    );
    refused(&Bench::new(221, &[("ratio", "2")], "b.ply"), &input, "number of points a tile");
    refused(&Bench::new(220, &[("ratio", "2")], "b.las"), &input, "format of the result");
    refused(&bench, &bytes(&ground(600, 4), "a.ply"), "input");
    let other = densecloud::backends::ModelName { name: "fake".into(), sha256: "01".into() };
    refused(&Bench { model: other, ..Bench::new(220, &[("ratio", "2")], "b.ply") }, &input, "model");
    gone_on(&bench, &input, &folder).expect("the same work");
}

#[test]
fn a_tile_that_fails_is_named_and_the_others_stay() {
    let input = bytes(&ground(1000, 3), "a.npy");
    let parent = tempfile::tempdir().expect("a folder");
    let bench = Bench::new(220, &[("ratio", "2")], "b.npy");
    let expected = bench.dense(&input, parent.path()).expect("a result");
    let folder = Folder::kept(parent.path(), "b.npy").expect("a folder");
    let tiling = bench.plan(&input, &folder).expect("a plan");
    tiling.run(0, &*bench.runner, &densecloud_cascade::Silent).expect("a part");
    let failing = Bench {
        runner: Arc::new(Patchwise::new(Arc::new(Fake::failing_at(1)))),
        ..Bench::new(220, &[("ratio", "2")], "b.npy")
    };
    let why = tiling.run_all(&failing.work()).expect_err("asked to fail");
    assert!(matches!(why, TilesError::Tile { tile: 1, .. }), "{why}");
    let why = why.to_string();
    assert!(why.starts_with("tile 1, from (5000") && why.contains("asked to fail"), "{why}");
    assert!(tiling.done(0).expect("a record").is_some() && tiling.done(1).expect("none").is_none());
    assert!(gone_on(&bench, &input, &folder).expect("a result") == expected);
}

#[test]
fn parts_that_are_not_as_they_were_written_are_refused() {
    let input = bytes(&ground(500, 3), "a.npy");
    let parent = tempfile::tempdir().expect("a folder");
    let bench = Bench::new(220, &[("ratio", "2")], "b.npy");
    let folder = Folder::temporary(parent.path()).expect("a folder");
    let tiling = bench.plan(&input, &folder).expect("a plan");
    tiling.run_all(&bench.work()).expect("tiles");
    let part = folder.part(1);
    let whole = std::fs::read(&part).expect("a part");
    let mut damaged = whole.clone();
    damaged[200] ^= 1;
    for bytes in [&damaged[..], &[], &whole[..whole.len() - 3]] {
        std::fs::write(&part, bytes).expect("a part");
        assert!(matches!(joined(&tiling), Err(TilesError::Broken { .. })));
    }
    std::fs::write(&part, &whole).expect("a part");
    joined(&tiling).expect("a result");
    std::fs::write(folder.own(0), b"").expect("a file");
    let why = tiling.run(0, &*bench.runner, &densecloud_cascade::Silent).expect_err("no points");
    assert!(matches!(why, TilesError::Broken { .. }), "{why}");
}
