//! The program as a person runs it, with the model inside it.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn densecloud(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_densecloud"));
    command.args(arguments);
    command
}

fn run(arguments: &[&str]) -> Output {
    densecloud(arguments).output().expect("the program starts")
}

fn ok(arguments: &[&str]) -> Output {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    output
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn fed(arguments: &[&str], input: &[u8]) -> Output {
    let mut child = densecloud(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // A program that refuses its arguments ends without reading.
    if let Err(why) = child.stdin.take().expect("piped").write_all(input) {
        assert_eq!(why.kind(), std::io::ErrorKind::BrokenPipe, "{why}");
    }
    child.wait_with_output().expect("the program ends")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("temporary folders have UTF-8 names")
}

/// A sampled knot of `points` points in the given kind of file.
fn knot(folder: &Path, name: &str, points: &str) -> String {
    let path = text(&folder.join(name)).to_owned();
    ok(&["sample", "shape:knot", &path, "--points", points]);
    path
}

#[test]
fn the_same_input_gives_the_same_bytes_on_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = knot(folder.path(), "in.ply", "700");
    let dense = |threads: &str| {
        let output = folder.path().join(format!("{threads}.ply"));
        ok(&["upsample", &input, text(&output), "--ratio", "8", "--threads", threads]);
        std::fs::read(output).expect("a result")
    };
    let one = dense("1");
    assert!(one.starts_with(b"ply\nformat binary_little_endian 1.0\n"));
    assert!(String::from_utf8_lossy(&one[..900]).contains("element vertex 5600"));
    assert!(one == dense("2"), "2 threads differ from 1");
    assert!(one == dense("8"), "8 threads differ from 1");
}

#[test]
fn the_dense_cloud_lies_on_the_surface() {
    // Points of a unit sphere: whatever the weights, a trained cascade must stay close to it.
    let n = 600;
    let mut sparse = String::new();
    for i in 0..n {
        let z = 1.0 - (2 * i + 1) as f64 / n as f64;
        let (r, angle) = ((1.0 - z * z).sqrt(), f64::from(i) * 2.399_963);
        sparse += &format!("{} {} {}\n", 100.0 + r * angle.cos(), r * angle.sin(), z);
    }
    let output = fed(&["upsample", "-", "-", "--ratio", "4"], sparse.as_bytes());
    assert!(output.status.success(), "{}", stderr(&output));
    let dense = String::from_utf8(output.stdout).expect("text in, text out");
    let radii: Vec<f64> = dense
        .lines()
        .map(|line| {
            let p: Vec<f64> = line.split(' ').map(|c| c.parse().expect("a number")).collect();
            ((p[0] - 100.0).powi(2) + p[1].powi(2) + p[2].powi(2)).sqrt()
        })
        .collect();
    assert_eq!(radii.len(), 4 * n as usize);
    let mean = radii.iter().map(|r| (r - 1.0).abs()).sum::<f64>() / radii.len() as f64;
    assert!(mean < 0.01, "mean distance to the sphere is {mean}");
}

#[test]
fn standard_streams_give_what_files_give() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = knot(folder.path(), "in.ply", "400");
    let output = folder.path().join("out.ply");
    ok(&["upsample", &input, text(&output), "--points", "1000"]);
    let piped = fed(&["upsample", "-", "-", "--points", "1000"], &std::fs::read(&input).expect("the input"));
    assert!(piped.status.success(), "{}", stderr(&piped));
    assert!(piped.stdout == std::fs::read(output).expect("a result"));
}

/// A spiral of 60 points: `red` says how high, `label` which half.
fn coloured() -> String {
    let mut ply = "ply\nformat ascii 1.0\nelement vertex 60\nproperty float x\nproperty float y\n\
                   property float z\nproperty uchar red\nproperty int label\nelement camera 1\nproperty float view\n\
                   element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        .to_owned();
    for i in 0..60 {
        let t = f64::from(i) * 0.3;
        ply += &format!("{} {} {} {} {}\n", t.cos(), t.sin(), t * 0.1, i * 4, if i < 30 { 3 } else { 8 });
    }
    ply + "1.5\n3 0 1 2\n"
}

#[test]
fn attributes_are_carried_over_and_what_is_not_is_named() {
    let output = fed(&["upsample", "-", "-", "--ratio", "4"], coloured().as_bytes());
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("not carried over: face ("), "{}", stderr(&output));
    let text = String::from_utf8(output.stdout).expect("text");
    let (header, rows) = text.split_once("end_header\n").expect("a header");
    let camera = "element camera 1\nproperty float view\n";
    let own = format!("property float z\nproperty uchar red\nproperty int label\n{camera}");
    assert!(header.ends_with(&own), "{header}");
    let rows = rows.strip_suffix("1.5\n").expect("the camera");
    let rows: Vec<Vec<f64>> =
        rows.lines().map(|l| l.split(' ').map(|f| f.parse().expect("a number")).collect()).collect();
    assert_eq!(rows.len(), 240);
    for row in &rows {
        let [_, _, z, red, label] = row[..] else { panic!("{row:?}") };
        // The spiral climbs 0.03 a point, and the network moves points by less than one turn.
        assert!((red - z / 0.03 * 4.0).abs() < 40.0, "{row:?}");
        assert!(label == 3.0 || label == 8.0, "{row:?}");
    }
    assert!(rows.iter().any(|r| r[3] % 4.0 != 0.0), "colours are interpolated");
    let quiet = fed(&["upsample", "-", "-", "--ratio", "2", "--quiet"], coloured().as_bytes());
    assert_eq!(stderr(&quiet), "");
}

#[test]
fn rules_for_attributes_are_set_by_name() {
    let run = |rules: &str| {
        fed(&["upsample", "-", "-", "--ratio", "4", "--attributes", rules], coloured().as_bytes())
    };
    let nearest = run("red:nearest,label:drop");
    assert!(nearest.status.success(), "{}", stderr(&nearest));
    let text = String::from_utf8(nearest.stdout).expect("text");
    assert!(!text.contains("property int label"));
    let (_, rows) = text.split_once("end_header\n").expect("a header");
    let red = |row: &str| row.split(' ').nth(3).expect("red").parse::<u32>().expect("a number");
    assert!(rows.lines().take(240).all(|row| red(row) % 4 == 0), "values of the source alone");
    for (rules, told) in
        [("blue:mean", "no attribute \"blue\"; the input has red, label"), ("red", "NAME:mean")]
    {
        let refused = run(rules);
        assert_eq!(refused.status.code(), Some(64));
        assert!(stderr(&refused).contains(told), "{}", stderr(&refused));
    }
}

#[test]
fn mistakes_are_told_with_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = knot(folder.path(), "in.xyz", "100");
    let out = folder.path().join("out.ply");
    let out = text(&out);
    let few = folder.path().join("few.xyz");
    std::fs::write(&few, "0 0 0\n1 0 0\n0 1 0\n").expect("written");
    let noise = folder.path().join("noise.ply");
    std::fs::write(&noise, [0_u8, 159, 146, 150].repeat(100)).expect("written");
    for (arguments, code, expected) in [
        (vec!["upsample", &input, out, "--ratio", "65"], 64, "not a number from 1 to 64"),
        (vec!["upsample", &input, out, "--ratio", "nan"], 64, "not a number from 1 to 64"),
        (vec!["upsample", &input, out, "--ratio", "2", "--points", "200"], 64, "cannot be used with"),
        (vec!["upsample", &input, out, "--points", "99"], 1, "ask for 100 to 6400"),
        (vec!["upsample", text(&few), out], 1, "needs at least 17"),
        (vec!["upsample", text(&noise), out], 1, "noise.ply"),
        (vec!["upsample", "/nowhere/in.ply", out], 1, "No such file"),
        (vec!["upsample", &input, "/nowhere/out.ply"], 1, "No such file"),
        (vec!["upsample", &input, out, "--model", "/nowhere"], 1, "model.toml"),
        (vec!["upsample", &input], 64, "Usage"),
        (vec!["frobnicate"], 64, "unrecognized subcommand"),
    ] {
        let output = run(&arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
        assert!(!Path::new(out).exists(), "{arguments:?} left a file");
    }
}

#[test]
fn a_missing_runtime_is_told_with_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = knot(folder.path(), "in.xyz", "100");
    let out = folder.path().join("out.xyz");
    let output = densecloud(&["upsample", &input, text(&out)])
        .env("ORT_DYLIB_PATH", "/nowhere/libonnxruntime.so")
        .output()
        .expect("the program starts");
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("set ORT_DYLIB_PATH"), "{}", stderr(&output));
}

/// A folder of meshes with a cube, and sparse and dense samples of it beside that.
fn benchmark(folder: &Path) -> [String; 3] {
    let [meshes, inputs, references] =
        ["meshes", "inputs", "references"].map(|name| text(&folder.join(name)).to_owned());
    for name in [&meshes, &inputs, &references] {
        std::fs::create_dir(name).expect("a folder");
    }
    let mesh = format!("{meshes}/cube.off");
    let cube = "OFF 8 6 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n4 0 3 2 1\n4 4 5 6 7\n\
                4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n";
    std::fs::write(&mesh, cube).expect("a mesh");
    ok(&["sample", &mesh, &format!("{inputs}/cube.xyz"), "--points", "300"]);
    ok(&["sample", &mesh, &format!("{references}/cube.ply"), "--points", "600"]);
    [meshes, inputs, references]
}

#[test]
fn evaluate_scores_the_cascade_beside_its_controls() {
    let folder = tempfile::tempdir().expect("a folder");
    let [meshes, inputs, references] = benchmark(folder.path());
    let report = folder.path().join("report.json");
    let common = ["--input", &inputs, "--reference", &references, "--mesh", &meshes, "--controls"];
    let made = ok(&[&["evaluate", "--ratio", "2", "--json", text(&report)], &common[..]].concat());
    let tables = String::from_utf8_lossy(&made.stdout).into_owned();
    assert_eq!(tables.lines().filter(|l| l.starts_with("mean of 1")).count(), 8, "{tables}");

    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(&report).expect("a report")).expect("JSON");
    let row = |method: &str| {
        let rows = json["rows"].as_array().expect("rows");
        rows.iter().find(|r| r["method"] == method).unwrap_or_else(|| panic!("no {method} in {json}")).clone()
    };
    for method in ["prediction", "floor", "repeat", "midpoints"] {
        assert_eq!(row(method)["points"], 600);
    }
    // What is known of any benchmark: another sample of the surface is on it and beats repetition.
    let score = |method: &str, name: &str| row(method)["published"][name].as_f64().expect("a number");
    assert!(score("floor", "point_to_face") < 1e-9 && score("repeat", "point_to_face") < 1e-9);
    assert!(score("floor", "chamfer") > 0.0);
    assert!(score("floor", "chamfer") < score("repeat", "chamfer"));
    // Infinite: nothing is less uniform than duplicates.
    assert!(row("repeat")["corrected"]["spacing_variation"].is_null());

    // The same clouds read from files score the same.
    let dense = text(&folder.path().join("cube.ply")).to_owned();
    ok(&["upsample", &format!("{inputs}/cube.xyz"), &dense, "--ratio", "2"]);
    let read =
        ok(&["evaluate", "--pred", &dense, "--reference", &references, "--mesh", &meshes, "--json", "-"]);
    let read: serde_json::Value = serde_json::from_slice(&read.stdout).expect("JSON");
    assert_eq!(read["rows"][0]["published"], row("prediction")["published"]);
}

#[test]
fn a_polished_cloud_is_smoother_and_more_even_than_what_the_network_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = text(&folder.path().join("in.xyz")).to_owned();
    let reference = text(&folder.path().join("reference.xyz")).to_owned();
    let mesh = text(&folder.path().join("ball.off")).to_owned();
    std::fs::write(&mesh, ball()).expect("a mesh");
    ok(&["sample", &mesh, &input, "--points", "600"]);
    ok(&["sample", &mesh, &reference, "--points", "2400", "--seed", "1"]);
    let scores = |more: &[&str]| -> [f64; 2] {
        let arguments =
            ["evaluate", "--input", &input, "--reference", &reference, "--mesh", &mesh, "--json", "-"];
        let output = ok(&[&arguments[..], more].concat());
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let corrected = &json["rows"][0]["corrected"];
        ["to_surface", "spacing_variation"].map(|name| corrected[name].as_f64().expect("a number"))
    };
    let (polished, raw) = (scores(&[]), scores(&["--no-polish"]));
    assert!(polished[0] < raw[0] && polished[1] < 0.6 * raw[1], "{polished:?} from {raw:?}");
    // With next to no distance allowed, the new points are those nearest to the old.
    let strict = scores(&["--max-distance", "0.1"]);
    assert!(strict[1] > polished[1], "points all near the input's cannot be even: {strict:?}");
}

/// A unit sphere of 800 quadrilaterals, as OFF.
fn ball() -> String {
    let (rings, around) = (20, 40);
    let mut off = format!("OFF {} {} 0\n", (rings + 1) * around, rings * around);
    for ring in 0..=rings {
        for step in 0..around {
            let (a, b) = (f64::from(ring) / f64::from(rings), f64::from(step) / f64::from(around));
            let (polar, angle) = (std::f64::consts::PI * a, std::f64::consts::TAU * b);
            off += &format!("{} {} {}\n", polar.sin() * angle.cos(), polar.sin() * angle.sin(), polar.cos());
        }
    }
    for ring in 0..rings {
        for step in 0..around {
            let next = (step + 1) % around;
            let (low, high) = (ring * around, (ring + 1) * around);
            off += &format!("4 {} {} {} {}\n", low + step, low + next, high + next, high + step);
        }
    }
    off
}

#[test]
fn evaluate_says_what_is_missing() {
    let folder = tempfile::tempdir().expect("a folder");
    let [meshes, inputs, references] = benchmark(folder.path());
    for (arguments, code, words) in [
        (vec!["--reference", &references], 64, "--pred"),
        (vec!["--pred", &inputs, "--reference", &references, "--controls"], 64, "--mesh"),
        (vec!["--pred", &inputs, "--reference", &references, "--ratio", "4"], 64, "--ratio"),
        (vec!["--pred", &inputs, "--reference", &references, "--overlap", "3"], 64, "--overlap"),
        (vec!["--input", &inputs, "--reference", &references, "--ratio", "65"], 64, "65"),
        (vec!["--pred", &inputs, "--reference", &references, "--tolerance", "0"], 64, "--tolerance"),
        (vec!["--pred", &inputs, "--reference", &references, "--shapes", "cow"], 1, "`cow`"),
        (vec!["--pred", &meshes, "--reference", &references], 1, "no clouds"),
    ] {
        let output = run(&[&["evaluate"], &arguments[..]].concat());
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(words), "{arguments:?}: {}", stderr(&output));
    }
}

/// The rows of a text PLY file, and its header.
fn table(ply: &str) -> (&str, Vec<Vec<f64>>) {
    let (header, rows) = ply.split_once("end_header\n").expect("a header");
    let numbers = |line: &str| line.split(' ').map(|f| f.parse().expect("a number")).collect();
    (header, rows.lines().map(numbers).collect())
}

#[test]
fn the_input_is_kept_exactly_where_that_is_wanted() {
    let source = coloured();
    let arguments = ["upsample", "-", "-", "--ratio", "3", "--keep-input", "--source-fields"];
    let output = fed(&arguments, source.as_bytes());
    assert!(output.status.success(), "{}", stderr(&output));
    let result = String::from_utf8(output.stdout).expect("text");
    let (header, rows) = table(&result);
    assert!(header.contains("property uint source_index\nproperty uchar is_generated\n"), "{header}");
    let (_, own) = table(&source);
    for (i, row) in rows.iter().take(180).enumerate() {
        let generated = f64::from(u8::from(i >= 60));
        assert_eq!(row[6], generated, "row {i}");
        if i < 60 {
            // 32-bit floats in both, so the digits may differ, not the numbers.
            assert_eq!(
                row[..3].iter().map(|c| *c as f32).collect::<Vec<_>>(),
                own[i][..3].iter().map(|c| *c as f32).collect::<Vec<_>>()
            );
            assert_eq!((&row[3..5], row[5]), (&own[i][3..5], i as f64));
        }
    }
}

#[test]
fn normals_are_estimated_on_the_side_of_the_sensor() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = knot(folder.path(), "in.xyz", "600");
    let output = ok(&[
        "upsample",
        &input,
        "-",
        "--ratio",
        "2",
        "--normals",
        "estimate",
        "--sensor",
        "0,0,-90",
        "--seed",
        "3",
    ]);
    let result = String::from_utf8(output.stdout).expect("text");
    let mut towards = 0;
    for line in result.lines() {
        let row: Vec<f64> = line.split(' ').filter_map(|f| f.parse().ok()).collect();
        let [x, y, z, nx, ny, nz] = row[..] else { panic!("{line}") };
        let side = -(x * nx + y * ny) + (-90.0 - z) * nz;
        assert!((nx * nx + ny * ny + nz * nz - 1.0).abs() < 1e-5, "{line}");
        towards += usize::from(side >= 0.0);
    }
    assert_eq!((towards, result.lines().count()), (1200, 1200));
}

#[test]
fn a_result_tells_where_it_comes_from() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = knot(folder.path(), "in.ply", "600");
    for name in ["dense.ply", "dense.xyz"] {
        let dense = folder.path().join(name);
        ok(&["upsample", &input, text(&dense), "--points", "1500", "--seed", "9"]);
        let inspected = ok(&["inspect", text(&dense), "--json"]);
        let told: serde_json::Value = serde_json::from_slice(&inspected.stdout).expect("JSON");
        assert_eq!(told["points"], 1500);
        let hash = String::from_utf8(ok(&["inspect", &input, "--json"]).stdout).expect("text");
        let hash: serde_json::Value = serde_json::from_str(&hash).expect("JSON");
        let line = told["provenance"][0].as_str().expect("provenance").to_owned();
        let expected = format!(
            "input_sha256={} input_points=600 points=1500 seed=9",
            hash["sha256"].as_str().expect("a hash")
        );
        assert!(line.contains(&expected), "{line}");
        let people = String::from_utf8(ok(&["inspect", text(&dense)]).stdout).expect("text");
        assert!(people.contains("made by      densecloud version="), "{people}");
    }
}

#[test]
fn a_spacing_or_a_density_is_met() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = knot(folder.path(), "in.ply", "3000");
    let inspect = |path: &str| -> serde_json::Value {
        serde_json::from_slice(&ok(&["inspect", path, "--json"]).stdout).expect("JSON")
    };
    let own = inspect(&input);
    let (area, spacing) =
        (own["area"].as_f64().expect("area"), own["mean_spacing"].as_f64().expect("spacing"));
    let dense = folder.path().join("dense.ply");
    let wanted = spacing / 2.3;
    ok(&["upsample", &input, text(&dense), "--spacing", &wanted.to_string()]);
    let reached = inspect(text(&dense))["mean_spacing"].as_f64().expect("spacing");
    assert!((reached / wanted - 1.0).abs() < 0.05, "{reached} for {wanted}");
    let wanted = 9000.0 / area;
    ok(&["upsample", &input, text(&dense), "--density", &wanted.to_string()]);
    let told = inspect(text(&dense));
    assert!((told["points"].as_f64().expect("points") / 9000.0 - 1.0).abs() < 0.01);
    assert!((told["density"]["median"].as_f64().expect("density") / wanted - 1.0).abs() < 0.1, "{told}");
    // It is this cloud that cannot be made so dense, as with --points.
    let refused = run(&["upsample", &input, text(&dense), "--spacing", "1e-6"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("from 1 to 64 is possible here: spacing"), "{}", stderr(&refused));
}

#[test]
fn coordinates_far_from_the_origin_keep_their_detail() {
    let folder = tempfile::tempdir().expect("a folder");
    let near = knot(folder.path(), "near.xyz", "800");
    let far = folder.path().join("far.ply");
    // Multiples of 2^-20, so that moving them is exact in 64 bits, as 32-bit floats where these hold them.
    let at = [465_123.0, 5_204_987.0, 812.0];
    let mut ply = "ply\nformat ascii 1.0\nelement vertex 800\nproperty double x\nproperty double y\nproperty double z\nend_header\n".to_owned();
    let mut text_near = String::new();
    for line in std::fs::read_to_string(&near).expect("points").lines() {
        let p: Vec<f64> = line
            .split(' ')
            .map(|f| (f.parse::<f64>().expect("a number") * 1_048_576.0).round() / 1_048_576.0)
            .collect();
        text_near += &format!("{} {} {}\n", p[0], p[1], p[2]);
        ply += &format!("{} {} {}\n", p[0] + at[0], p[1] + at[1], p[2] + at[2]);
    }
    std::fs::write(&near, text_near).expect("a file");
    std::fs::write(&far, ply).expect("a file");
    let dense = |input: &str, output: &str| -> Vec<[f64; 3]> {
        let output = folder.path().join(output);
        ok(&["upsample", input, text(&output), "--ratio", "4"]);
        let result = std::fs::read_to_string(output).expect("a result");
        let rows = result.split_once("end_header\n").map_or(result.as_str(), |(_, rows)| rows);
        rows.lines()
            .map(|l| {
                let row: Vec<f64> = l.split(' ').map(|f| f.parse().expect("a number")).collect();
                [row[0], row[1], row[2]]
            })
            .collect()
    };
    let (near, far) = (dense(&near, "a.xyz"), dense(text(&far), "b.ply"));
    for (a, b) in near.iter().zip(&far) {
        for axis in 0..3 {
            assert!((a[axis] + at[axis] - b[axis]).abs() < 2e-9, "{a:?} {b:?}");
        }
    }
}
