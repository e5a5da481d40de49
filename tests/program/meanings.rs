//! What names and values of columns mean, through the whole program: files as other programs write them, made here.

use std::fmt::Write;
use std::path::Path;

use crate::support::run;

/// Points of a bumpy square, a tenth apart.
fn places() -> impl Iterator<Item = (usize, [f64; 3])> {
    (0..900).map(|i| {
        let (x, y) = ((i % 30) as f64 * 0.1, (i / 30) as f64 * 0.1);
        (i, [x, y, 0.2 * (1.3 * x).sin() * y.cos()])
    })
}

/// An ASCII PLY file of these points with further columns.
fn ply(types: &str, names: &[&str], of: impl Fn(usize, [f64; 3]) -> Vec<f64>) -> String {
    let axes = "property float x\nproperty float y\nproperty float z\n";
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex 900\n{axes}");
    for name in names {
        let _ = writeln!(text, "property {types} {name}");
    }
    text += "end_header\n";
    for (i, p) in places() {
        let numbers: Vec<String> = p.into_iter().chain(of(i, p)).map(|v| v.to_string()).collect();
        text += &(numbers.join(" ") + "\n");
    }
    text
}

/// Makes a file dense, and gives the rows of the result, which is an ASCII PLY file, and what was told.
fn dense(folder: &Path, input: &str, output: &str, options: &[&str]) -> (Vec<Vec<f64>>, String) {
    let path = |name: &str| folder.join(name).to_str().expect("a name").to_owned();
    let (from, to) = (path(input), path(output));
    let made = run(&[&["upsample", &from, &to], options].concat());
    let told = String::from_utf8_lossy(&made.stderr).into_owned();
    assert!(made.status.success(), "{told}");
    let text = std::fs::read(to).expect("a result");
    let text = String::from_utf8_lossy(&text);
    let rows = text.split_once("end_header\n").map_or("", |(_, rows)| rows).lines();
    let rows = rows.map(|row| row.split(' ').map(|field| field.parse().expect("a number")).collect());
    (rows.collect(), told)
}

#[test]
fn numbers_that_a_program_has_as_floats_stay_those_of_a_point() {
    let folder = tempfile::tempdir().expect("a folder");
    let names =
        ["scalar_Classification", "scalar_ring", "scalar_sem", "scalar_x7", "scalar_Intensity", "scalar_T"];
    let text = ply("float", &names, |i, [x, y, _]| {
        let class = if x < 1.5 { 2.0 } else { 6.0 };
        vec![class, (i / 30) as f64, class, class, class * 100.0, 20.5 + y]
    });
    std::fs::write(folder.path().join("in.ply"), text).expect("written");
    let (rows, told) = dense(folder.path(), "in.ply", "out.ply", &["--ratio", "4"]);
    assert_eq!(rows.len(), 3600);
    for row in &rows {
        for class in [row[3], row[5], row[6]] {
            assert!(class == 2.0 || class == 6.0, "{row:?}");
        }
        assert!(row[4].fract() == 0.0 && (0.0..30.0).contains(&row[4]), "{row:?}");
        assert!((200.0..=600.0).contains(&row[7]) && (20.5..=23.4 + 1e-5).contains(&row[8]), "{row:?}");
    }
    assert!(rows.iter().any(|row| row[7] > 210.0 && row[7] < 590.0), "an intensity varies");
    assert!(!told.contains("warning"), "{told}");
}

#[test]
fn colours_that_a_flag_calls_absent_have_no_weight_in_e57_and_elsewhere() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = ply("uchar", &["red", "green", "blue", "color_invalid"], |i, _| {
        if i.is_multiple_of(3) { vec![0.0, 0.0, 0.0, 1.0] } else { vec![200.0, 100.0, 50.0, 0.0] }
    });
    std::fs::write(folder.path().join("in.ply"), text).expect("written");
    dense(folder.path(), "in.ply", "in.e57", &["--ratio", "1", "--keep-input"]);
    for input in ["in.ply", "in.e57"] {
        dense(folder.path(), input, "out.csv", &["--ratio", "4"]);
        let text = folder.path().join("out.csv");
        let text = std::fs::read_to_string(text).expect("a result");
        let mut rows = text.lines();
        let header = rows.next().expect("names");
        assert!(header.ends_with("red,green,blue,color_invalid"), "{header}");
        let mut absent = 0;
        for row in rows {
            match row.splitn(4, ',').nth(3).expect("a colour") {
                "200,100,50,0" => {}
                "0,0,0,1" => absent += 1,
                other => panic!("{input}: {other}"),
            }
        }
        // No point is far from one with a colour, but one may lie on one without.
        assert!(absent < 36, "{absent}");
    }
}

#[test]
fn rotations_of_gaussian_splats_stay_rotations() {
    let folder = tempfile::tempdir().expect("a folder");
    let names = [
        "f_dc_0", "f_rest_0", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ];
    let text = ply("float", &names, |i, [x, y, _]| {
        let sign = if (i * 7).is_multiple_of(3) { -1.0 } else { 1.0 };
        let angle = 0.3 * x;
        let rotation = [angle.cos(), 0.0, angle.sin(), 0.0].map(|c| sign * c);
        [vec![0.5 * x, -0.25, 2.0, -3.0 - y, -4.0, -5.0], rotation.to_vec()].concat()
    });
    std::fs::write(folder.path().join("in.ply"), text).expect("written");
    let (rows, told) = dense(folder.path(), "in.ply", "out.ply", &["--ratio", "4"]);
    for row in &rows {
        let [w, x, y, z] = row[9..] else { panic!("{row:?}") };
        assert!(((w * w + y * y).sqrt() - 1.0).abs() < 1e-6 && x == 0.0 && z == 0.0, "{row:?}");
        assert!(((y / w).atan() - 0.3 * row[0]).abs() < 0.05, "{row:?}");
        assert_eq!(row[4], -0.25, "equal coefficients");
        assert_eq!(row[5], 2.0);
        assert!((-5.9001..=-3.0).contains(&row[6]) && row[7] == -4.0 && row[8] == -5.0, "{row:?}");
    }
    assert!(!told.contains("rotation"), "{told}");
    // Without its last part it is none.
    let text = ply("float", &names[6..9], |i, _| {
        if i.is_multiple_of(2) { vec![1.0, 0.0, 0.0] } else { vec![0.0, 0.6, 0.8] }
    });
    std::fs::write(folder.path().join("part.ply"), text).expect("written");
    let (rows, told) = dense(folder.path(), "part.ply", "out.ply", &["--ratio", "2"]);
    assert!(told.contains("not a whole rotation: rot_0, rot_1, rot_2"), "{told}");
    assert!(rows.iter().all(|row| row[3..] == [1.0, 0.0, 0.0] || (row[3] == 0.0 && row[5] > 0.79)));
}
