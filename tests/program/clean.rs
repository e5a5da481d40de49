//! `densecloud clean` on files.

use std::fs::read_to_string;
use std::process::Output;

use crate::support::{run, sphere, within};

/// The last line of what it said.
fn said(output: &Output) -> String {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    stderr.lines().last().unwrap_or_default().to_owned()
}

/// A sphere of 2,000 points in UTM coordinates with an attribute, a duplicate, one point far off and one without a place.
fn scan() -> String {
    let mut text = String::from("x y z intensity\n");
    for (i, line) in sphere(2000).lines().enumerate() {
        text += &format!("{line} {i}\n");
    }
    let first = text.lines().nth(1).expect("a point").to_owned();
    text + &first + "\n500003.0 0.0 0.0 2001\nnan 0 0 2002\n"
}

#[test]
fn what_is_no_surface_is_left_out_and_the_rest_stays_as_it_is() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("scan.xyz"), scan()).expect("a file");
    let told = said(&run(&["clean", &path("scan.xyz"), &path("clean.xyz")]));
    assert!(
        told.ends_with("2003 -> 2000 points: 1 not finite, 1 duplicates, 1 alone or beside a surface"),
        "{told}"
    );
    let (before, after) = (scan(), read_to_string(path("clean.xyz")).expect("text"));
    let rows = |text: &str| -> Vec<Vec<f64>> {
        let rows = text.lines().filter(|line| line.starts_with("50") || line.starts_with("49"));
        rows.map(|line| line.split(' ').map(|word| word.parse().expect("a number")).collect()).collect()
    };
    assert_eq!(rows(&after), rows(&before)[..2000]);
    // Again: nothing is left to do.
    let told = said(&run(&["clean", &path("clean.xyz"), &path("again.xyz")]));
    assert!(told.ends_with("2000 -> 2000 points: none left out"), "{told}");
    assert_eq!(rows(&read_to_string(path("again.xyz")).expect("text")), rows(&after));
}

#[test]
fn each_option_does_what_it_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("scan.xyz"), scan()).expect("a file");
    let (input, output) = (path("scan.xyz"), path("out.ply"));
    let clean = |options: &[&str]| said(&run(&[&["clean", &input, &output][..], options].concat()));
    let told = clean(&["--keep-duplicates", "--keep-outliers"]);
    assert!(told.ends_with("2003 -> 2002 points: 1 not finite"), "{told}");
    let told = clean(&["--points", "500"]);
    assert!(told.contains("-> 500 points") && told.ends_with("1500 thinned"), "{told}");
    for thinning in [["--voxel", "0.2"], ["--spacing", "0.2"]] {
        let told = clean(&thinning);
        assert!(told.contains(" thinned") && !told.contains("-> 2000 "), "{told}");
    }
    let told = clean(&["--radius", "0.3", "--neighbours", "3", "--keep-outliers"]);
    assert!(told.contains("1 with few others in the radius"), "{told}");
    let told = clean(&["--statistical", "5", "--keep-outliers"]);
    assert!(told.contains("1 further from others than most"), "{told}");
    for method in ["--smooth=mls", "--smooth=bilateral", "--smooth=wlop"] {
        let told = clean(&[method]);
        assert!(told.contains("0 points moved, 2000 lie within 0.45 spacings"), "{told}");
    }
    assert!(clean(&["--smooth", "--smooth-above", "0"]).contains("2000 points moved"));
    let file = std::fs::read(&output).expect("a file");
    let head = String::from_utf8_lossy(&file[..400]);
    assert!(head.contains("comment densecloud clean") && head.contains("2000 points moved"), "{head}");
    let json = clean(&["--json", "--dry-run"]);
    let told: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!((&told["points_out"], &told["left_out"]["outliers"]), (&2000.into(), &1.into()));
    std::fs::remove_file(&output).expect("it was written before");
    clean(&["--dry-run"]);
    assert!(!std::path::Path::new(&output).exists());
}

#[test]
fn what_makes_no_sense_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("scan.xyz"), scan()).expect("a file");
    let (input, output) = (path("scan.xyz"), path("out.ply"));
    for wrong in [
        &["--voxel", "0"][..],
        &["--voxel", "nan"],
        &["--voxel", "1", "--spacing", "1"],
        &["--radius", "1"],
        &["--neighbours", "3"],
        &["--smooth-above", "1"],
        &["--outliers", "-1"],
        &["--smooth=median"],
        &["--statistical", "0"],
        &["--keep-outliers", "--outliers", "3"],
    ] {
        let refused = run(&[&["clean", &input, &output][..], wrong].concat());
        assert_eq!(refused.status.code(), Some(64), "{wrong:?}: {refused:?}");
    }
    let nothing = run(&["clean", &input, &output, "--radius", "1e-9", "--neighbours", "2"]);
    let stderr = String::from_utf8_lossy(&nothing.stderr);
    assert_eq!(nothing.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("no point is left after points with few others in the radius"), "{stderr}");
    assert!(!std::path::Path::new(&output).exists());
}

#[test]
fn a_cloud_is_cleaned_before_it_is_made_dense_and_the_result_tells() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("scan.xyz"), scan()).expect("a file");
    let (input, output, two) = (path("scan.xyz"), path("out.ply"), path("two.ply"));
    let upsample = |input: &str, output: &str, more: &[&str]| {
        run(&[&["upsample", input, output, "--points", "4000"][..], more].concat())
    };
    let done = upsample(&input, &output, &["--clean"]);
    let told = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && told.contains("cleaned: 2003 -> 2000 points"), "{told}");
    let head = String::from_utf8_lossy(&std::fs::read(&output).expect("a file")[..900]).into_owned();
    assert!(head.contains("comment densecloud clean") && head.contains("input_points=2000"), "{head}");
    // As in two steps, but for the hash of the file between them.
    run(&["clean", &input, &path("clean.xyz"), "--quiet"]);
    assert!(upsample(&path("clean.xyz"), &two, &["--quiet"]).status.success());
    let points = |file: &str| {
        let bytes = std::fs::read(file).expect("a file");
        let end = b"end_header\n";
        let at = bytes.windows(end.len()).position(|window| window == end).expect("a header");
        bytes[at..].to_vec()
    };
    assert!(points(&output) == points(&two));
    let large = upsample(&input, &output, &["--clean=smooth", "--tile-points", "1000"]);
    assert_eq!(large.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&large.stderr).contains("densecloud clean IN OUT"), "{large:?}");
}
