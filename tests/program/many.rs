//! `densecloud upsample` of several inputs, its events, and what it tells without working.

use std::collections::BTreeSet;
use std::process::Output;

use serde_json::Value;

use crate::support::{run, sphere, within};

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The events on standard output, which has nothing else.
fn events(output: &Output) -> Vec<Value> {
    let text = std::str::from_utf8(&output.stdout).expect("UTF-8");
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|why| panic!("{line}: {why}")))
        .collect()
}

fn files(folder: &str) -> BTreeSet<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8")).collect()
}

/// A folder of two clouds and one of too few points.
fn inputs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, points) in [("a.xyz", 100), ("b.xyz", 120), ("few.xyz", 3)] {
        std::fs::write(folder.path().join(name), sphere(points)).expect("a file");
    }
    folder
}

#[test]
fn each_input_has_its_result_and_one_that_fails_holds_up_no_other() {
    let folder = inputs();
    let path = within(&folder);
    let (all, to) = (path("*.xyz"), path("out/{stem}_2x.{ext}"));
    let many = |more: &[&str]| run(&[&["upsample", &all, "-o", &to, "--ratio", "2"], more].concat());
    let made = many(&[]);
    assert_eq!(made.status.code(), Some(1), "{made:?}");
    assert!(made.stdout.is_empty());
    let told = stderr(&made);
    let summary = format!("2 done, 1 failed:\n  {}: ", path("few.xyz"));
    assert!(told.contains(&summary) && told.contains("needs at least 17"), "{told}");
    assert_eq!(
        files(&path("out")),
        ["a_2x.xyz", "a_2x.xyz.provenance.txt", "b_2x.xyz", "b_2x.xyz.provenance.txt"]
            .map(str::to_owned)
            .into()
    );
    assert!(run(&["upsample", &path("a.xyz"), &path("one.txt"), "--ratio", "2"]).status.success());
    let read = |name: &str| std::fs::read(path(name)).expect("a file");
    assert!(read("out/a_2x.xyz") == read("one.txt"), "not as alone");

    let again = many(&[]);
    assert_eq!(again.status.code(), Some(64));
    assert!(stderr(&again).contains("a_2x.xyz is there already"), "{}", stderr(&again));
    std::fs::write(path("out/b_2x.xyz"), "kept").expect("a file");
    let rest = many(&["--existing", "skip"]);
    assert!(stderr(&rest).contains("0 done, 2 there already, 1 failed"), "{}", stderr(&rest));
    assert_eq!(read("out/b_2x.xyz"), b"kept");
    assert!(stderr(&many(&["--existing", "overwrite"])).contains("2 done, 1 failed"));
    assert!(read("out/b_2x.xyz") != b"kept");
}

#[test]
fn what_would_be_guessed_or_overwritten_is_refused_before_work_begins() {
    let folder = inputs();
    let path = within(&folder);
    let (a, b, all) = (path("a.xyz"), path("b.xyz"), path("*.xyz"));
    std::fs::write(path("a.ply"), "in the way").expect("a file");
    let before = files(&path(""));
    for (arguments, word) in [
        (vec![&*a, &*b, &*path("out.ply")], "give an input and an output"),
        (vec![&*all, &*path("out.ply")], "several inputs need --output"),
        (vec![&*a, &*b, "-o", &*path("out.ply")], "all results would be written there"),
        (vec![&*a, &*b, "-o", &*path("{name}")], "onto the input"),
        (vec![&*a, &*path("./a.xyz"), "-o", &*path("out/")], "would both be written to"),
        (vec![&*b, &*a, "-o", &*path("{stem}.ply")], "a.ply is there already"),
        (vec![&*a, "-o", &*path("{stem}.gif")], "gif"),
        (vec![&*path("*.e57"), "-o", &*path("out/")], "no file is called so"),
        (vec![&*all, "-o", &*path("out/"), "--report", &*path("page.html")], "--report"),
        (vec![&*a, "-", "--json"], "--json"),
        (vec![&*a, &*path("c.ply"), "--existing", "skip"], "--output"),
    ] {
        let refused = run(&[&["upsample"], &arguments[..]].concat());
        assert_eq!(refused.status.code(), Some(64), "{arguments:?}: {}", stderr(&refused));
        assert!(
            stderr(&refused).contains(word) && refused.stdout.is_empty(),
            "{arguments:?}: {}",
            stderr(&refused)
        );
        assert_eq!(files(&path("")), before, "{arguments:?}");
    }
}

#[test]
fn events_are_lines_of_json_and_words_go_elsewhere() {
    let folder = inputs();
    let path = within(&folder);
    let to = path("{stem}.ply");
    let output = run(&["upsample", &path("*.xyz"), "-o", &to, "--ratio", "2", "--json"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("1 failed"), "{}", stderr(&output));
    let events = events(&output);
    let of = |kind: &str| events.iter().filter(|event| event["event"] == kind).collect::<Vec<_>>();
    assert_eq!((of("begin").len(), of("done").len(), of("failed").len()), (3, 2, 1), "{events:?}");
    let done = of("done")[1];
    assert_eq!((&done["input"], &done["output"]), (&path("b.xyz").into(), &path("b.ply").into()));
    assert_eq!((done["points_in"].as_u64(), done["points_out"].as_u64()), (Some(120), Some(240)));
    assert!(done["seconds"].is_f64() && done["stages"].is_object() && done["tiles"].is_null(), "{done}");
    assert!(
        done["warnings"].is_array() && done["provenance"].is_string() && done["format"].is_string(),
        "{done}"
    );
    let failed = of("failed")[0];
    assert!(failed["why"].as_str().is_some_and(|why| why.contains("at least 17")), "{failed}");
    assert_eq!(failed["exit_code"], 1);
    let end = events.last().expect("an event");
    assert_eq!(*end, serde_json::json!({ "event": "end", "done": 2, "skipped": 0, "failed": 1 }));
    for progress in of("progress") {
        assert!((0.0..=1.0).contains(&progress["fraction"].as_f64().expect("a number")), "{progress}");
    }
}

#[test]
fn one_input_tells_events_too_and_tiles_tell_their_number() {
    let folder = inputs();
    let path = within(&folder);
    std::fs::write(path("large.xyz"), sphere(30_000)).expect("a file");
    let (input, to) = (path("large.xyz"), path("dense.xyz"));
    let output =
        run(&["upsample", &input, &to, "--ratio", "1", "--tile-points", "10000", "--json", "--quiet"]);
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    let events = events(&output);
    let done = events.last().expect("an event");
    assert_eq!((&done["event"], done["points_out"].as_u64()), (&"done".into(), Some(30_000)));
    assert!(done["tiles"].as_u64().is_some_and(|tiles| tiles > 2), "{done}");
    assert!(events.iter().any(|event| event["event"] == "progress"), "{events:?}");
}

#[test]
fn a_dry_run_tells_what_the_work_would_come_to_and_writes_nothing() {
    let folder = inputs();
    let path = within(&folder);
    let before = files(&path(""));
    let dry = |more: &[&str]| {
        let output = run(&[&["upsample", "--dry-run"], more].concat());
        assert_eq!(files(&path("")), before, "{more:?}");
        output
    };
    let (a, b, few, out) = (path("a.xyz"), path("b.xyz"), path("few.xyz"), path("out.ply"));
    let one = dry(&[&a, &out, "--ratio", "3"]);
    let words = String::from_utf8_lossy(&one.stdout).into_owned();
    assert!(one.status.success(), "{one:?}");
    assert!(words.contains("100 -> 300 points, about ") && words.contains(" MB of memory"), "{words}");
    let many = dry(&[&b, &few, "-o", &path("out/"), "--json"]);
    assert_eq!(many.status.code(), Some(1), "few points are told, too");
    let estimate = &events(&many)[1];
    assert_eq!((&estimate["event"], estimate["points_out"].as_u64()), (&"estimate".into(), Some(480)));
    let bytes = |estimate: &Value| estimate["bytes"].as_u64().expect("a number");
    assert!(estimate["seconds"].as_f64().is_some_and(|seconds| seconds > 0.0) && bytes(estimate) > 1 << 20);
    assert_eq!(estimate["in_tiles"], false);
    // More work takes more, and so do attributes that the warnings tell of.
    let best = &events(&dry(&[&b, &out, "--json", "--quality", "best"]))[1];
    assert!(bytes(best) > bytes(estimate), "{best}");
    let tiled = &events(&dry(&[&b, &path("out.xyz"), "--json", "--tile-points", "100"]));
    assert!(
        tiled.iter().all(|event| event["in_tiles"] != true),
        "the fewest points of a tile are more: {tiled:?}"
    );
    for refused in [&[&*a, &out, "--resume"][..], &[&a, &out, "--server", "http://localhost"]] {
        assert_eq!(dry(refused).status.code(), Some(64), "{refused:?}");
    }
}
