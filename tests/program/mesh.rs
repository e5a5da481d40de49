//! `densecloud mesh` as a process.

use std::collections::HashMap;

use densecloud_formats::{read_cloud_file, read_mesh_file};
use densecloud_geometry::{Mesh, SurfaceDistance, shape};

use crate::support::{densecloud, run, within};

/// Sides of triangles by how many triangles have them, and the Euler characteristic.
fn topology(mesh: &Mesh) -> (HashMap<usize, usize>, i64) {
    let mut sides: HashMap<(u32, u32), usize> = HashMap::new();
    for t in &mesh.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            *sides.entry((a.min(b), a.max(b))).or_default() += 1;
        }
    }
    let euler = mesh.vertices.len() as i64 - sides.len() as i64 + mesh.triangles.len() as i64;
    let mut by_use = HashMap::new();
    sides.values().for_each(|n| *by_use.entry(*n).or_default() += 1);
    (by_use, euler)
}

/// A wavy sheet over a square of side 2, coloured red where x is above 0 and blue below, far from the origin.
fn sheet() -> String {
    let row = |i: i32| {
        (0..80).map(move |j| {
            let (x, y) = (f64::from(i) / 40.0 - 1.0, f64::from(j) / 40.0 - 1.0);
            let (red, blue) = if x > 0.0 { (255, 0) } else { (0, 255) };
            let (east, north) = (500_000.0 + x, 4_600_000.0 + y);
            format!("{east} {north} {} {red} 0 {blue}\n", 0.1 * (3.0 * x).sin())
        })
    };
    format!("x y z red green blue\n{}", (0..80).flat_map(row).collect::<String>())
}

fn said(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_closed_shape_comes_back_closed_near_the_true_one_and_the_same_on_any_threads() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let cloud = path("knot.ply");
    assert!(run(&["sample", "shape:knot", &cloud, "--points", "6000"]).status.success());
    for threads in ["1", "2"] {
        let mut program = densecloud();
        let out = path(&format!("{threads}.ply"));
        let done = program.args(["mesh", &cloud, &out]).env("RAYON_NUM_THREADS", threads).output();
        let done = done.expect("the program starts");
        assert!(done.status.success() && done.stderr.is_empty(), "{done:?}");
    }
    let made = std::fs::read(path("1.ply")).expect("a mesh");
    assert!(made == std::fs::read(path("2.ply")).expect("a mesh"), "bytes depend on threads");
    let mesh = read_mesh_file(path("1.ply").as_ref()).expect("a mesh");
    let (sides, euler) = topology(&mesh);
    assert_eq!((sides.keys().copied().collect::<Vec<_>>(), euler), (vec![2], 0), "a closed tube");
    let distances = SurfaceDistance::new(&shape("knot").expect("a shape")).distances(&mesh.vertices);
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    assert!(mean < 0.002, "{mean}");
    let volume: f64 = mesh
        .corners()
        .map(|[a, b, c]| {
            a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0])
        })
        .sum();
    assert!(volume > 0.0, "triangles face in");
}

#[test]
fn an_open_sheet_stays_open_with_its_colours_and_place_and_says_that_its_side_is_a_guess() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let (cloud, out) = (path("sheet.xyz"), path("sheet.ply"));
    std::fs::write(&cloud, sheet()).expect("a file");
    let done = run(&["mesh", &cloud, &out]);
    assert!(done.status.success() && said(&done).contains("is a guess"), "{done:?}");
    let (sides, euler) = topology(&read_mesh_file(out.as_ref()).expect("a mesh"));
    assert!(sides[&1] > 200 && sides.len() == 2 && euler == 1, "{sides:?} {euler}");
    let cloud_of = read_cloud_file(out.as_ref()).expect("a cloud").0;
    for (i, p) in cloud_of.positions.iter().enumerate() {
        let (x, y) = (p[0] - 500_000.0, p[1] - 4_600_000.0);
        // Past the last points, at 0.975, the sheet goes on for a spacing or two, and may bend by as much.
        let near = if x.abs().max(y.abs()) < 0.96 { 0.01 } else { 0.05 };
        assert!(x.abs() < 1.06 && y.abs() < 1.06 && (p[2] - 0.1 * (3.0 * x).sin()).abs() < near, "{p:?}");
        if x.abs() > 0.05 {
            let red = cloud_of.attributes.iter().find(|a| a.name == "red").expect("colours").values.get(i);
            assert_eq!(red, if x > 0.0 { 255.0 } else { 0.0 });
        }
    }
}

#[test]
fn triangles_face_the_sensor() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let (cloud, out) = (path("sheet.xyz"), path("sheet.ply"));
    std::fs::write(&cloud, sheet()).expect("a file");
    for (z, sign) in [(9.0, 1.0_f64), (-9.0, -1.0)] {
        let done = run(&["mesh", &cloud, &out, "--sensor", &format!("500000,4600000,{z}")]);
        assert!(done.status.success() && done.stderr.is_empty(), "{done:?}");
        let mesh = read_mesh_file(out.as_ref()).expect("a mesh");
        let up = |[a, b, c]: [[f64; 3]; 3]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        assert!(mesh.corners().map(|t| sign * up(t)).all(|up| up > -1e-9));
    }
}

#[test]
fn every_format_holds_the_same_triangles_or_is_refused_where_it_cannot() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let (cloud, far) = (path("gear.ply"), path("far.xyz"));
    assert!(run(&["sample", "shape:gear", &cloud, "--points", "3000"]).status.success());
    let write = |name: &str| {
        let done = run(&["mesh", &cloud, &path(name), "--triangles", "5000"]);
        assert!(done.status.success(), "{done:?}");
        std::fs::read(path(name)).expect("a mesh")
    };
    write("m.ply");
    let mesh = read_mesh_file(path("m.ply").as_ref()).expect("a mesh");
    assert!((4500..=5500).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
    let text = String::from_utf8(write("m.obj")).expect("text");
    assert_eq!(text.lines().filter(|line| line.starts_with("f ")).count(), mesh.triangles.len());
    assert_eq!(read_cloud_file(path("m.obj").as_ref()).expect("vertices").0.positions, mesh.vertices);
    let stl = write("m.stl");
    assert_eq!(stl.len(), 84 + 50 * mesh.triangles.len());
    let number = |at: usize| f32::from_le_bytes(stl[at..at + 4].try_into().expect("four bytes"));
    assert_eq!(number(96), mesh.vertices[mesh.triangles[0][0] as usize][0] as f32);
    let glb = write("m.glb");
    let length = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().expect("four bytes")) as usize;
    let json: serde_json::Value = serde_json::from_slice(&glb[20..20 + length(12)]).expect("JSON");
    assert_eq!((&glb[..4], length(8)), (&b"glTF"[..], glb.len()));
    assert_eq!(json["accessors"][1]["count"], 3 * mesh.triangles.len());
    assert_eq!(json["buffers"][0]["byteLength"], glb.len() - 28 - length(12));

    std::fs::write(&far, sheet().replace(" 4", " 464")).expect("a file");
    let refused = run(&["mesh", &far, &path("far.stl"), "--quiet"]);
    assert!(refused.status.code() == Some(1) && said(&refused).contains("32-bit"), "{refused:?}");
}

#[test]
fn what_has_no_surface_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let line: String = (0..100).map(|i| format!("{i} {} 0\n", 2 * i)).collect();
    let few: String = (0..8).map(|i| format!("{} {} {}\n", i & 1, i >> 1 & 1, i >> 2)).collect();
    for (name, text, why) in
        [("line", line, "one line"), ("few", few, "too few"), ("one", "1 2 3\n".repeat(50), "the same")]
    {
        let cloud = path(&format!("{name}.xyz"));
        std::fs::write(&cloud, text).expect("a file");
        let refused = run(&["mesh", &cloud, &path("out.ply")]);
        assert!(refused.status.code() == Some(1) && said(&refused).contains(why), "{refused:?}");
    }
    let cloud = path("knot.ply");
    assert!(run(&["sample", "shape:knot", &cloud, "--points", "1000"]).status.success());
    for (options, code, why) in [
        (["--triangles", "9000000"], 1, "the points tell no more"),
        (["--size", "1e-7"], 1, "take larger ones"),
        (["--size", "-1"], 64, ""),
        (["--trim", "4"], 64, "at most 3"),
        (["--sensor", "1,2"], 64, "three numbers"),
    ] {
        let refused = run(&[&["mesh", &cloud, &path("out.ply")][..], &options].concat());
        assert!(refused.status.code() == Some(code) && said(&refused).contains(why), "{refused:?}");
    }
    let refused = run(&["mesh", &cloud, &path("out.png")]);
    assert!(refused.status.code() == Some(64) && said(&refused).contains(".glb"), "{refused:?}");
    assert!(["out.ply", "out.png"].iter().all(|name| !std::path::Path::new(&path(name)).exists()));
}

#[test]
fn a_result_comes_with_its_mesh() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    let [cloud, dense, out] = ["knot.ply", "dense.ply", "surface.ply"].map(&path);
    assert!(run(&["sample", "shape:knot", &cloud, "--points", "2000"]).status.success());
    let done = run(&["upsample", &cloud, &dense, "--mesh", &out, "--quiet"]);
    assert!(done.status.success() && done.stderr.is_empty(), "{done:?}");
    let mesh = read_mesh_file(out.as_ref()).expect("a mesh");
    let (sides, euler) = topology(&mesh);
    assert_eq!((sides.keys().copied().collect::<Vec<_>>(), euler), (vec![2], 0), "a closed tube");
    assert_eq!(read_cloud_file(dense.as_ref()).expect("a cloud").0.positions.len(), 8000);
    for (arguments, code, why) in [
        (vec!["upsample", &cloud, &dense, "--mesh", "out.png"], 64, ".glb"),
        (vec!["upsample", &cloud, &dense, "--mesh", &out, "--tile-points", "1000"], 1, "--bounds"),
        (vec!["upsample", &cloud, &out, "-o", "{stem}_b.ply", "--mesh", "m.ply"], 64, "one input"),
    ] {
        let refused = run(&arguments);
        assert!(refused.status.code() == Some(code) && said(&refused).contains(why), "{refused:?}");
    }
}
