//! Parts leave while later tiles are worked on, and make the file that all of them joined would.

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::support::{Bench, bytes, entries, ground, joined, read};
use crate::{Folder, Step, TilesError, Watch};
use densecloud_cascade::{
    CascadeError, FeatureTable, LevelInput, LevelOutput, LevelRunner, Observer, UnitShape,
};

/// Longer than anything here takes; a test that needs it all has failed.
const PATIENCE: Duration = Duration::from_secs(60);

/// Holds the second tile back until something is written.
struct HeldBack(Mutex<Receiver<usize>>);

impl Observer for HeldBack {}

impl Watch for HeldBack {
    fn step(&self, step: Step) {
        if let Step::Tile { done: 1, .. } = step {
            let written = self.0.lock().expect("no panic").recv_timeout(PATIENCE);
            assert!(written.expect("the first part comes before the second tile is begun") > 0);
        }
    }
}

/// Tells of each piece that it takes, up to so many.
struct Told {
    bytes: Vec<u8>,
    tell: Sender<usize>,
    most: usize,
}

impl Write for Told {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.bytes.len() + bytes.len() > self.most {
            return Err(io::Error::other("the disk is full"));
        }
        self.bytes.extend_from_slice(bytes);
        // Nobody may listen any more.
        let _ = self.tell.send(bytes.len());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_result_is_the_same_whether_its_parts_flow_or_are_joined() {
    let mut cloud = ground(900, 5);
    cloud.positions[3] = [f64::NAN; 3];
    cloud.positions[4] = cloud.positions[5];
    let input = bytes(&cloud, "a.npy");
    let parent = tempfile::tempdir().expect("a folder");
    for (to, flows) in [
        ("b.ply", true),
        ("b.csv", true),
        ("b.xyz", true),
        ("b.npy", true),
        ("b.pcd", true),
        ("b.las", false),
        ("b.laz", false),
        ("points3D.txt", false),
    ] {
        let bench = Bench::new(250, &[("ratio", "2"), ("confidence", "true")], to);
        let folder = Folder::temporary(parent.path()).expect("a folder");
        let tiling = bench.plan(&input, &folder).expect("a plan");
        tiling.run_all(&bench.work()).expect("tiles");
        let expected = joined(&tiling).expect("a result");
        let report = tiling.join().expect("parts").report().clone();
        drop((tiling, folder));
        let folder = Folder::temporary(parent.path()).expect("a folder");
        let tiling = Arc::new(bench.plan(&input, &folder).expect("a plan"));
        assert_eq!(tiling.flows(), flows, "{to}");
        let mut sink = Vec::new();
        let told = tiling.run_into(&bench.work(), &mut sink).expect("a result");
        assert!(sink == expected, "{to}");
        assert_eq!(told, report, "{to}");
        let parts = (0..tiling.len()).filter(|tile| folder.part(*tile).exists()).count();
        assert_eq!(parts, if flows { 0 } else { tiling.len() as usize }, "{to}");
    }
    assert_eq!(entries(parent.path()), 0);
}

#[test]
fn what_is_left_out_for_its_confidence_is_counted_first() {
    let input = bytes(&ground(900, 5), "a.npy");
    let parent = tempfile::tempdir().expect("a folder");
    let bench = Bench::new(250, &[("ratio", "2"), ("min_confidence", "0.3")], "b.ply");
    let folder = Folder::temporary(parent.path()).expect("a folder");
    let tiling = Arc::new(bench.plan(&input, &folder).expect("a plan"));
    assert!(!tiling.flows());
    let mut sink = Vec::new();
    let report = tiling.run_into(&bench.work(), &mut sink).expect("a result");
    assert_eq!(read(&sink).positions.len() as u64, report.points_out);
}

#[test]
fn the_first_part_leaves_before_the_second_tile_is_begun() {
    let input = bytes(&ground(900, 5), "a.ply");
    let parent = tempfile::tempdir().expect("a folder");
    let expected =
        Bench::new(250, &[("ratio", "2")], "b.ply").dense(&input, parent.path()).expect("a result");
    let (tell, told) = mpsc::channel();
    let watch = Box::new(HeldBack(Mutex::new(told)));
    let bench = Bench { watch, ..Bench::new(250, &[("ratio", "2")], "b.ply") };
    let folder = Folder::kept(parent.path(), "b.ply").expect("a folder");
    let tiling = Arc::new(bench.plan(&input, &folder).expect("a plan"));
    let mut sink = Told { bytes: Vec::new(), tell, most: usize::MAX };
    tiling.run_into(&bench.work(), &mut sink).expect("a result");
    assert!(sink.bytes == expected);
    // What is gone on with keeps its parts.
    assert!(tiling.not_done().expect("records").is_empty() && joined(&tiling).expect("a result") == expected);
}

#[test]
fn a_sink_that_fails_ends_the_work_with_its_own_words() {
    let input = bytes(&ground(900, 5), "a.ply");
    let parent = tempfile::tempdir().expect("a folder");
    let (tell, told) = mpsc::channel();
    let watch = Box::new(HeldBack(Mutex::new(told)));
    let bench = Bench { watch, ..Bench::new(250, &[("ratio", "2")], "b.ply") };
    let folder = Folder::temporary(parent.path()).expect("a folder");
    let tiling = Arc::new(bench.plan(&input, &folder).expect("a plan"));
    // The header, and no point.
    let why = tiling.run_into(&bench.work(), Told { bytes: Vec::new(), tell, most: 600 }).expect_err("full");
    assert!(matches!(why, TilesError::Format(_)) && why.to_string().contains("the disk is full"), "{why}");
    assert!(!tiling.not_done().expect("records").is_empty(), "it went on in vain");
}

/// Says when the second tile is begun.
struct Second(Arc<AtomicBool>);

impl Observer for Second {}

impl Watch for Second {
    fn step(&self, step: Step) {
        self.0.fetch_or(matches!(step, Step::Tile { done: 1, .. }), Ordering::Relaxed);
    }
}

/// A runner whose units take for ever from the second tile on, unless they are stopped.
struct Endless {
    runner: Arc<dyn LevelRunner>,
    is_second: Arc<AtomicBool>,
}

impl LevelRunner for Endless {
    fn shape(&self) -> UnitShape {
        self.runner.shape()
    }

    fn units(&self) -> usize {
        self.runner.units()
    }

    fn provider(&self) -> &str {
        self.runner.provider()
    }

    fn run_level(
        &self,
        level: &LevelInput<'_>,
        previous: Option<&FeatureTable>,
        observer: &dyn Observer,
    ) -> Result<LevelOutput, CascadeError> {
        if !self.is_second.load(Ordering::Relaxed) {
            return self.runner.run_level(level, previous, observer);
        }
        let start = Instant::now();
        while !observer.cancelled() {
            assert!(start.elapsed() < PATIENCE, "it is not stopped");
            std::thread::yield_now();
        }
        Err(CascadeError::Cancelled)
    }
}

#[test]
fn a_sink_that_fails_ends_a_tile_in_the_middle() {
    let input = bytes(&ground(900, 5), "a.ply");
    let parent = tempfile::tempdir().expect("a folder");
    let is_second = Arc::new(AtomicBool::new(false));
    let bench = Bench::new(250, &[("ratio", "2")], "b.ply");
    let runner = Arc::new(Endless { runner: bench.runner, is_second: Arc::clone(&is_second) });
    let bench = Bench { runner, watch: Box::new(Second(is_second)), ..bench };
    let folder = Folder::temporary(parent.path()).expect("a folder");
    let tiling = Arc::new(bench.plan(&input, &folder).expect("a plan"));
    let sink = Told { bytes: Vec::new(), tell: mpsc::channel().0, most: 600 };
    let why = tiling.run_into(&bench.work(), sink).expect_err("full");
    assert!(matches!(why, TilesError::Format(_)) && why.to_string().contains("the disk is full"), "{why}");
}
