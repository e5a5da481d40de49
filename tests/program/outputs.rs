//! Names of outputs that nothing is written as, and inputs that are none of what is read.

use std::process::Output;

use crate::support::{Serving, run, sphere, within};

/// Extensions of files that people want, and that would hold something else than they say.
const UNWRITTEN: [&str; 12] =
    ["ptx", "stl", "bin", "vtk", "xyz.gz", "glb", "npz", "splat", "off", "obj", "xyzn", "xyzrgb"];

/// Asserts that the name was refused, with what may be in its place.
fn assert_refused(output: &Output, extension: &str) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(64), "{extension}: {stderr}");
    let last = extension.rsplit('.').next().unwrap_or_default();
    assert!(stderr.contains(&format!("nothing is written as `.{last}`")), "{stderr}");
    for ending in [".ply", ".laz", ".csv", "points3D.bin"] {
        assert!(stderr.contains(ending), "{stderr}");
    }
}

#[test]
fn an_output_is_refused_that_would_not_be_what_its_name_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(40)).expect("a file");
    let input = path("in.xyz");
    let upsample = |out: &str| run(&["upsample", &input, out, "--ratio", "1", "--quiet"]);
    for extension in UNWRITTEN {
        let out = path(&format!("out.{extension}"));
        assert_refused(&upsample(&out), extension);
        // Nobody is there; the name comes first.
        let server = ["--server", "http://127.0.0.1:9"];
        let remote = [&["upsample", &input, &out, "--ratio", "2"][..], &server].concat();
        assert_refused(&run(&remote), extension);
        assert_refused(&run(&[&["job", "get", "1", &out][..], &server].concat()), extension);
        assert_refused(&run(&["sample", "shape:cube", &out, "--points", "20"]), extension);
        let drawn = run(&["render", &input, &out]);
        assert_eq!(drawn.status.code(), Some(64), "{drawn:?}");
        assert!(String::from_utf8_lossy(&drawn.stderr).contains("name it .png"), "{drawn:?}");
        assert!(!std::path::Path::new(&out).exists(), "{out}");
    }
    // As the input, whose name it has; but what is no text is no text under such a name.
    for extension in ["dat", "XYZN", "3d"] {
        std::fs::copy(&input, path(&format!("own.{extension}"))).expect("a copy");
        let out = path(&format!("out.{}", extension.to_lowercase()));
        let done =
            run(&["upsample", &path(&format!("own.{extension}")), &out, "--ratio", "1", "--keep-input"]);
        assert!(done.status.success(), "{done:?}");
        let text = std::fs::read_to_string(&out).expect("text");
        assert_eq!(text.lines().count(), 40, "{extension}");
        assert!(text.starts_with("500000.222205 0.0 0.975\n"), "{text}");
    }
    assert!(upsample(&path("cloud.ply")).status.success());
    std::fs::copy(path("cloud.ply"), path("cloud.splat")).expect("a copy");
    let splat = ["upsample", &path("cloud.splat"), &path("other.splat"), "--ratio", "1"];
    assert_refused(&run(&splat), "splat");
    assert_refused(&run(&["upsample", &path("none.dat"), &path("out2.dat"), "--ratio", "1"]), "dat");
    // Without an extension, as the input.
    assert!(upsample(&path("out")).status.success());
    let text = std::fs::read_to_string(path("out")).expect("text");
    assert_eq!(text.lines().count(), 40);
    assert!(upsample(&path("points3D.txt")).status.success());
    let colmap = std::fs::read_to_string(path("points3D.txt")).expect("text");
    assert!(colmap.starts_with("# 3D point list with one line of data per point:\n"), "{colmap}");
}

#[test]
fn a_jobs_result_is_not_saved_under_the_name_of_another_format() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(40)).expect("a file");
    let server = Serving::start(&["--data-dir", &path("jobs")]);
    let url = server.url("");
    let job = |arguments: &[&str]| run(&[&["job"], arguments, &["--server", &url]].concat());
    let id = job(&["submit", &path("in.xyz"), "--ratio", "1", "--quiet"]);
    let id = String::from_utf8_lossy(&id.stdout).trim().to_owned();
    assert!(job(&["watch", &id]).status.success());
    let wrong = job(&["get", &id, &path("out.ply")]);
    assert_eq!(wrong.status.code(), Some(64), "{wrong:?}");
    assert!(String::from_utf8_lossy(&wrong.stderr).contains("the job's result is text"), "{wrong:?}");
    assert!(!folder.path().join("out.ply").exists());
    for right in ["out.xyz", "out.csv", "out"] {
        assert!(job(&["get", &id, &path(right)]).status.success(), "{right}");
    }
}

#[test]
fn sweeps_are_read_where_their_format_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let floats: Vec<u8> = (0..40_u16)
        .flat_map(|i| [f32::from(i % 8), f32::from(i / 8), 0.5, f32::from(i) / 40.0])
        .flat_map(f32::to_le_bytes)
        .collect();
    std::fs::write(path("sweep.bin"), floats).expect("a file");
    let unsaid = run(&["upsample", &path("sweep.bin"), &path("out.ply"), "--ratio", "1"]);
    assert_eq!(unsaid.status.code(), Some(1), "{unsaid:?}");
    let stderr = String::from_utf8_lossy(&unsaid.stderr);
    assert!(
        stderr.contains("--format") && stderr.contains("kitti") && stderr.contains("nuscenes"),
        "{stderr}"
    );
    let said = [
        "upsample",
        &path("sweep.bin"),
        &path("out.xyz"),
        "--ratio",
        "1",
        "--keep-input",
        "--format",
        "kitti",
    ];
    assert!(run(&said).status.success());
    let text = std::fs::read_to_string(path("out.xyz")).expect("text");
    assert_eq!(
        text.lines().take(3).collect::<Vec<_>>(),
        ["x y z intensity", "0.0 0.0 0.5 0.0", "1.0 0.0 0.5 0.025"]
    );
}
