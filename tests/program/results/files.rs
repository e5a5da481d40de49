//! Clouds as files, written by hand, so that no writer of the program's is trusted.

use super::clouds::{self, Column, Kind, Points};

/// All files that cases begin with, by their names.
pub(super) fn inputs() -> Vec<(&'static str, Vec<u8>)> {
    let [f32s, f64s] = [Kind::F32, Kind::F64];
    let signed = |points| clouds::ring(points).with("rgb", Kind::U32, |i| (i * 65_793 % (1 << 24)) as f64);
    vec![
        ("ring.ply", ply(&clouds::ring(700), "binary_little_endian", f32s)),
        ("hill.ply", ply(&clouds::hill(600).coloured().measured(), "ascii", f64s)),
        ("chest.ply", ply(&clouds::chest(500).coloured(), "ascii", f32s)),
        ("big-endian.ply", ply(&clouds::hill(500).measured(), "binary_big_endian", f64s)),
        ("big-endian-float.ply", ply(&clouds::ring(400).coloured(), "binary_big_endian", f32s)),
        ("ground.ply", ply(&clouds::ground(600).coloured(), "binary_little_endian", f64s)),
        ("holes.ply", ply(&clouds::holes(600).measured(), "binary_little_endian", f32s)),
        ("ball.ply", ply(&clouds::ball(500, 0.0).directed(), "binary_little_endian", f32s)),
        ("noisy.ply", ply(&clouds::ball(1500, 0.02), "binary_little_endian", f64s)),
        ("ring.xyz", text(&clouds::ring(500), " ", false)),
        ("ground.txt", text(&clouds::ground(400).coloured(), "\t", false)),
        ("hill.csv", text(&clouds::hill(400).measured(), ",", true)),
        ("ground.las", las(&clouds::ground(500))),
        ("ring.pcd", pcd(&signed(400), "ascii")),
        ("binary.pcd", pcd(&signed(400), "binary")),
        ("compressed.pcd", pcd(&clouds::chest(400).measured(), "binary_compressed")),
        ("table.npy", npy_table(&clouds::ring(400), f32s)),
        ("columns.npy", npy_table(&clouds::ground(400).coloured(), f64s)),
        ("fields.npy", npy_fields(&clouds::holes(500).coloured().measured())),
        ("grid.off", off(&clouds::grid(18), 18)),
        ("ball.obj", obj(&clouds::ball(400, 0.0))),
    ]
}

/// Each point's numbers, its position first.
fn rows(points: &Points, scalar: Kind) -> impl Iterator<Item = Vec<(Kind, f64)>> {
    points.positions.iter().enumerate().map(move |(i, position)| {
        let beside = points.columns.iter().map(move |column| (column.kind, column.values[i]));
        position.iter().map(|c| (scalar, *c)).chain(beside).collect()
    })
}

fn lines(points: &Points, scalar: Kind, separator: &str) -> Vec<u8> {
    let line = |row: Vec<(Kind, f64)>| {
        let numbers: Vec<String> = row.into_iter().map(|(kind, value)| kind.text(value)).collect();
        numbers.join(separator) + "\n"
    };
    rows(points, scalar).map(line).collect::<String>().into()
}

fn packed(points: &Points, scalar: Kind, big_endian: bool) -> Vec<u8> {
    let number = |(kind, value): (Kind, f64)| {
        let mut bytes = kind.little(value);
        if big_endian {
            bytes.reverse();
        }
        bytes
    };
    rows(points, scalar).flatten().flat_map(number).collect()
}

fn ply(points: &Points, encoding: &str, scalar: Kind) -> Vec<u8> {
    let property = |kind: Kind, name: &str| {
        let kind = match kind {
            Kind::U8 => "uchar",
            Kind::U16 => "ushort",
            Kind::U32 => "uint",
            Kind::I32 => "int",
            Kind::F32 => "float",
            Kind::F64 => "double",
        };
        format!("property {kind} {name}\n")
    };
    let count = points.positions.len();
    let mut head = format!("ply\nformat {encoding} 1.0\ncomment crs: EPSG:25832\nelement vertex {count}\n");
    head.extend(["x", "y", "z"].map(|axis| property(scalar, axis)));
    head.extend(points.columns.iter().map(|c| property(c.kind, c.name)));
    head += "end_header\n";
    let data = match encoding {
        "ascii" => lines(points, scalar, " "),
        other => packed(points, scalar, other == "binary_big_endian"),
    };
    [head.into_bytes(), data].concat()
}

fn text(points: &Points, separator: &str, named: bool) -> Vec<u8> {
    let names = ["x", "y", "z"].into_iter().chain(points.columns.iter().map(|c| c.name));
    let head = names.collect::<Vec<_>>().join(separator) + "\n";
    let head = if named { head.into_bytes() } else { Vec::new() };
    [head, lines(points, Kind::F64, separator)].concat()
}

/// LAS 1.2 with times and colours (point format 3), in steps of a centimetre.
fn las(points: &Points) -> Vec<u8> {
    let offset = [465_000.0, 5_204_000.0, 600.0];
    let steps = |p: &[f64; 3]| [0, 1, 2].map(|axis| ((p[axis] - offset[axis]) * 100.0).round() as i32);
    let steps: Vec<[i32; 3]> = points.positions.iter().map(steps).collect();
    let record = |(i, steps): (usize, &[i32; 3])| las_record(i, *steps);
    let records: Vec<u8> = steps.iter().enumerate().flat_map(record).collect();
    [las_header(&steps, offset), records].concat()
}

fn las_header(steps: &[[i32; 3]], offset: [f64; 3]) -> Vec<u8> {
    let count = steps.len() as u32;
    // Signature, source, encoding, project, version, system, software.
    let mut head = [&b"LASF"[..], &[9, 0, 0, 0], &[7; 16], &[1, 2]].concat();
    head.extend([&b"a made-up scanner"[..], &[0; 15], &b"by hand"[..], &[0; 25]].concat());
    for number in [120_u16, 2021, 227] {
        head.extend(number.to_le_bytes());
    }
    head.extend([227_u32, 0].map(u32::to_le_bytes).concat());
    head.extend([3, 34, 0]);
    // Points, then those of the first to the fifth return: two of three are a first one.
    let second = count / 3;
    head.extend([count, count - second, second, 0, 0, 0].map(u32::to_le_bytes).concat());
    head.extend([0.01; 3].map(f64::to_le_bytes).concat());
    head.extend(offset.map(f64::to_le_bytes).concat());
    for axis in 0..3 {
        let ends = [steps.iter().map(|s| s[axis]).max(), steps.iter().map(|s| s[axis]).min()];
        for end in ends {
            head.extend((f64::from(end.expect("points")) * 0.01 + offset[axis]).to_le_bytes());
        }
    }
    head
}

fn las_record(i: usize, steps: [i32; 3]) -> Vec<u8> {
    let mut record = steps.map(i32::to_le_bytes).concat();
    record.extend((i as u16 * 97).to_le_bytes());
    // Return number and number of returns; class, angle, user data.
    let returns = if i % 3 == 2 { 2 | 2 << 3 } else { 1 | 2 << 3 };
    record.extend([returns, (i % 6) as u8, (i % 41) as u8, (i % 251) as u8, 5, 0]);
    record.extend((1e6 + i as f64 / 8.0).to_le_bytes());
    record.extend([i * 31, i * 57, i * 111].map(|c| (c as u16).to_le_bytes()).concat());
    record
}

fn pcd(points: &Points, encoding: &str) -> Vec<u8> {
    let kinds = [Kind::F32; 3].into_iter().chain(points.columns.iter().map(|c| c.kind));
    let names = ["x", "y", "z"].into_iter().chain(points.columns.iter().map(|c| c.name));
    let letter = |kind| match kind {
        Kind::F32 | Kind::F64 => "F",
        Kind::I32 => "I",
        _ => "U",
    };
    let words = |words: Vec<String>| words.join(" ");
    let count = points.positions.len();
    let head = format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {count}\nHEIGHT 1\n\
         VIEWPOINT 0.5 -0.25 4 1 0 0 0\nPOINTS {count}\nDATA {encoding}\n",
        words(names.clone().map(str::to_owned).collect()),
        words(kinds.clone().map(|kind| kind.size().to_string()).collect()),
        words(kinds.map(|kind| letter(kind).to_owned()).collect()),
        words(names.map(|_| "1".to_owned()).collect()),
    );
    let data = match encoding {
        "ascii" => lines(points, Kind::F32, " "),
        "binary" => packed(points, Kind::F32, false),
        _ => compressed(&by_column(points)),
    };
    [head.into_bytes(), data].concat()
}

/// All numbers of x, then of y, and so on.
fn by_column(points: &Points) -> Vec<u8> {
    let axes = (0..3).map(|axis| points.positions.iter().map(|p| (Kind::F32, p[axis])).collect::<Vec<_>>());
    let column = |c: &Column| c.values.iter().map(|value| (c.kind, *value)).collect();
    let numbers = axes.chain(points.columns.iter().map(column)).flatten();
    numbers.flat_map(|(kind, value)| kind.little(value)).collect()
}

/// LZF that copies nothing: runs of up to 32 bytes as they are. Before it both lengths.
fn compressed(bytes: &[u8]) -> Vec<u8> {
    let run = |run: &[u8]| [&[run.len() as u8 - 1], run].concat();
    let runs: Vec<u8> = bytes.chunks(32).flat_map(run).collect();
    [&(runs.len() as u32).to_le_bytes()[..], &(bytes.len() as u32).to_le_bytes(), &runs].concat()
}

fn npy(kind: &str, shape: &str, data: Vec<u8>) -> Vec<u8> {
    let literal = format!("{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}\n");
    let length = (literal.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], literal.as_bytes(), &data].concat()
}

/// All numbers in one type.
fn npy_table(points: &Points, kind: Kind) -> Vec<u8> {
    let name = format!("'<f{}'", kind.size());
    let shape = format!("({}, {})", points.positions.len(), 3 + points.columns.len());
    let numbers = rows(points, kind).flatten();
    npy(&name, &shape, numbers.flat_map(|(_, value)| kind.little(value)).collect())
}

fn npy_fields(points: &Points) -> Vec<u8> {
    let field = |name: &str, kind: Kind| {
        let letter = match kind {
            Kind::F32 | Kind::F64 => "<f",
            Kind::I32 => "<i",
            Kind::U8 => "|u",
            _ => "<u",
        };
        format!("('{name}', '{letter}{}')", kind.size())
    };
    let axes = ["x", "y", "z"].map(|axis| field(axis, Kind::F32));
    let fields: Vec<String> =
        axes.into_iter().chain(points.columns.iter().map(|c| field(c.name, c.kind))).collect();
    let shape = format!("({},)", points.positions.len());
    npy(&format!("[{}]", fields.join(", ")), &shape, packed(points, Kind::F32, false))
}

/// A grid of `side` times `side` points, with two triangles for each of its squares.
fn off(grid: &Points, side: usize) -> Vec<u8> {
    let mut faces = String::new();
    for i in (0..side * (side - 1)).filter(|i| i % side + 1 < side) {
        let [beside, below, across] = [i + 1, i + side, i + side + 1];
        faces += &format!("3 {i} {beside} {below}\n3 {beside} {across} {below}\n");
    }
    let head = format!("OFF\n{} {} 0\n", grid.positions.len(), faces.lines().count());
    [head.into_bytes(), lines(grid, Kind::F64, " "), faces.into_bytes()].concat()
}

/// A ball about the origin, whose normals are its points.
fn obj(ball: &Points) -> Vec<u8> {
    let entry = |name: &str, [x, y, z]: &[f64; 3]| format!("{name} {x} {y} {z}\n");
    let points = ball.positions.iter().map(|p| entry("v", p));
    points.chain(ball.positions.iter().map(|p| entry("vn", p))).collect::<String>().into()
}
