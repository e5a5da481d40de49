//! Clouds of more points than a tile holds, as a person works on them.
//!
//! `DENSECLOUD_KILLS=50 cargo test --test program tiles` takes minutes; without it there are a few kills.

use std::hash::{BuildHasher, RandomState};
use std::io::{Read, Write};
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use crate::support::{densecloud, run, sphere, within};

/// Points of a tile here, the fewest that are allowed.
const TILE: [&str; 2] = ["--tile-points", "1000"];

fn entries(folder: &Path) -> usize {
    std::fs::read_dir(folder).expect("a folder").count()
}

#[test]
fn the_steps_give_what_the_command_gives() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(2500)).expect("a file");
    let plain =
        ["upsample", &path("in.xyz"), &path("plain.laz"), "--ratio", "2", "--temp-dir", &path("temp")];
    let made = run(&[&plain[..], &TILE].concat());
    assert!(made.status.success(), "{made:?}");
    let told = String::from_utf8_lossy(&made.stderr).into_owned();
    assert!(told.contains("2500 -> 5000 points") && told.contains("(3 tiles)"), "{told}");
    assert_eq!(entries(&folder.path().join("temp")), 0);
    let planned = ["tiles", "plan", &path("in.xyz"), &path("work"), "--for", "x.laz", "--ratio", "2"];
    let planned = run(&[&planned[..], &TILE].concat());
    assert_eq!(planned.stdout, b"3\n", "{planned:?}");
    let refused = run(&["tiles", "join", &path("work"), &path("early.laz")]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("tiles are not done: 0, 1, 2"), "{refused:?}");
    for tiles in [&["2", "0"][..], &["2"], &[]] {
        let done = run(&[&["tiles", "run", &path("work")], tiles].concat());
        assert!(done.status.success(), "{done:?}");
    }
    let none = run(&["tiles", "run", &path("work"), "3"]);
    assert_eq!(none.status.code(), Some(64), "{none:?}");
    let other = run(&["tiles", "join", &path("work"), &path("other.ply")]);
    assert_eq!(other.status.code(), Some(64), "{other:?}");
    let joined = run(&["tiles", "join", &path("work"), &path("joined.laz")]);
    assert!(joined.status.success(), "{joined:?}");
    let read = |name: &str| std::fs::read(path(name)).expect("a file");
    assert!(read("joined.laz") == read("plain.laz"));
    std::fs::write(path("work/mine"), "a file").expect("a file");
    assert!(run(&["tiles", "remove", &path("work")]).status.success());
    assert_eq!((entries(&folder.path().join("work")), read("work/mine")), (1, b"a file".to_vec()));
    let none = run(&["tiles", "remove", &path("work")]);
    assert_eq!(none.status.code(), Some(1), "{none:?}");
    assert!(String::from_utf8_lossy(&none.stderr).contains("no tiles are planned there"), "{none:?}");
}

#[test]
fn tiles_without_a_polish_give_as_many_points_as_are_asked_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(2500)).expect("a file");
    for (ratio, points) in [("2", 5000), ("4", 10_000)] {
        let options = ["--ratio", ratio, "--no-polish", TILE[0], TILE[1]];
        let made = run(&[&["upsample", &path("in.xyz"), &path("out.xyz")], &options[..]].concat());
        assert!(made.status.success(), "{made:?}");
        assert!(String::from_utf8_lossy(&made.stderr).contains("(3 tiles)"), "{made:?}");
        let dense = std::fs::read_to_string(path("out.xyz")).expect("text");
        assert_eq!(dense.lines().count(), points);
    }
}

#[test]
fn memory_decides_how_large_tiles_are() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(9000)).expect("a file");
    let of = |size: [&str; 2]| {
        run(&[&["upsample", &path("in.xyz"), &path("out.ply"), "--ratio", "2"][..], &size].concat())
    };
    let told = |made: &std::process::Output| String::from_utf8_lossy(&made.stderr).into_owned();
    let few = of(["--max-memory", "175000000"]);
    assert!(few.status.success() && told(&few).contains(" tiles)"), "{few:?}");
    let whole = of(["--max-memory", "1000000000"]);
    assert!(whole.status.success() && !told(&whole).contains(" tiles)"), "{whole:?}");
    let refused = of(["--max-memory", "1000000"]);
    assert_eq!(refused.status.code(), Some(64), "{refused:?}");
    assert!(
        told(&refused).contains("--max-memory: 1000000 bytes of memory are too few for tiles; give "),
        "{refused:?}"
    );
    let both = run(&["upsample", "in.xyz", "out.ply", "--max-memory", "auto", TILE[0], TILE[1]]);
    assert_eq!(both.status.code(), Some(64), "{both:?}");
}

#[test]
fn pipes_on_both_sides_give_the_same() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let cloud = sphere(2200);
    std::fs::write(path("in.xyz"), &cloud).expect("a file");
    let options =
        ["--ratio", "1.5", "--quiet", "--keep-input", "--temp-dir", &path("temp"), TILE[0], TILE[1]];
    let made = run(&[&["upsample", &path("in.xyz"), &path("out.xyz")], &options[..]].concat());
    assert!(made.status.success(), "{made:?}");
    let mut piped = densecloud()
        .args(["upsample", "-", "-"])
        .args(options)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut stdin = piped.stdin.take().expect("piped");
    let feeder = std::thread::spawn(move || stdin.write_all(cloud.as_bytes()));
    let output = piped.wait_with_output().expect("the program ends");
    feeder.join().expect("no panic").expect("all is read");
    assert!(output.status.success() && output.stdout == std::fs::read(path("out.xyz")).expect("a file"));
    assert_eq!(output.stdout.iter().filter(|byte| **byte == b'\n').count(), 3300);
    let refused = run(&[&["upsample", &path("in.xyz"), &path("out.e57")], &options[..]].concat());
    assert_eq!(refused.status.code(), Some(64), "{refused:?}");
    assert!(
        String::from_utf8_lossy(&refused.stderr).contains("E57 is written of a whole cloud"),
        "{refused:?}"
    );
    assert_eq!(entries(&folder.path().join("temp")), 0);
}

#[test]
fn a_reader_that_leaves_ends_the_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(2500)).expect("a file");
    // The first part alone is more than lies between.
    let options = ["--ratio", "64", "--quiet", "--temp-dir", &path("temp"), TILE[0], TILE[1]];
    let mut piped = densecloud()
        .args(["upsample", &path("in.xyz"), "-"])
        .args(options)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut stdout = piped.stdout.take().expect("piped");
    stdout.read_exact(&mut [0; 100]).expect("points");
    drop(stdout);
    let ended = piped.wait_with_output().expect("the program ends");
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    assert!(String::from_utf8_lossy(&ended.stderr).contains("-: Broken pipe"), "{ended:?}");
    assert_eq!(entries(&folder.path().join("temp")), 0);
}

#[test]
fn a_killed_work_goes_on_and_leaves_nothing() {
    let kills = std::env::var("DENSECLOUD_KILLS").map_or(4, |count| count.parse().expect("a number"));
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(4000)).expect("a file");
    let command = |output: &str, more: &[&str]| {
        let mut command = densecloud();
        command.args(["upsample", &path("in.xyz"), &path(output), "--ratio", "2", "--quiet"]);
        command.args(["--temp-dir", &path("temp")]).args(TILE).args(more);
        command
    };
    let begin = std::time::Instant::now();
    assert!(command("expected.ply", &[]).status().expect("the program starts").success());
    let whole = begin.elapsed();
    for kill in 0..kills {
        // Whenever it is, the result is the same.
        let share = RandomState::new().hash_one(kill) as f64 / u64::MAX as f64;
        for more in [&["--resume"][..], &[]] {
            let mut child = command("out.ply", more).spawn().expect("the program starts");
            std::thread::sleep(Duration::from_secs_f64(share * whole.as_secs_f64()));
            child.kill().expect("killed");
            child.wait().expect("the program ends");
        }
        assert!(command("out.ply", &["--resume"]).status().expect("the program starts").success());
        let made = std::fs::read(path("out.ply")).expect("a file");
        assert!(made == std::fs::read(path("expected.ply")).expect("a file"), "after {share} of the time");
        std::fs::remove_file(path("out.ply")).expect("a file");
    }
    // Whatever was left by works that were not to go on is gone with the next one.
    assert!(command("last.ply", &[]).status().expect("the program starts").success());
    assert_eq!(entries(&folder.path().join("temp")), 0);
}
