//! What may lie about a file: gzip, UTF-16.

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::*;

const TEXT: &str = "x y z Größe\n1 2 3 7\n4.5 5 6 8\n";

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

fn utf16(text: &str, is_big: bool) -> Vec<u8> {
    let units = std::iter::once(0xFEFF).chain(text.encode_utf16());
    units.flat_map(|unit| if is_big { unit.to_be_bytes() } else { unit.to_le_bytes() }).collect()
}

fn is_the_same(bytes: &[u8]) {
    let plain = read_content(TEXT.as_bytes()).expect("a cloud");
    assert_eq!(read_content(bytes).expect("a cloud"), plain);
    let dripped =
        CloudReader::open(Drip(bytes), Limits::default()).and_then(CloudReader::read).expect("a cloud");
    assert_eq!(dripped.positions, [[1.0, 2.0, 3.0], [4.5, 5.0, 6.0]]);
    assert_eq!(dripped.attributes, plain.attributes);
    assert_eq!(dripped.attributes[0].name, "Größe");
}

#[test]
fn text_is_read_in_gzip_and_in_utf_16() {
    is_the_same(&gzip(TEXT.as_bytes()));
    for is_big in [false, true] {
        is_the_same(&utf16(TEXT, is_big));
        is_the_same(&gzip(&utf16(TEXT, is_big)));
    }
    // Members one after another are one file.
    is_the_same(&[gzip(&TEXT.as_bytes()[..20]), gzip(&TEXT.as_bytes()[20..])].concat());
    let cloud = read(&gzip(TEXT.as_bytes())).expect("a cloud");
    let again = read(&gzip(TEXT.as_bytes())).expect("a cloud");
    assert_eq!(cloud.origin.sha256, again.origin.sha256);
    assert_ne!(
        cloud.origin.sha256,
        read(TEXT.as_bytes()).expect("a cloud").origin.sha256,
        "of the file as it lies"
    );
}

#[test]
fn characters_of_four_bytes_come_through_wherever_they_are_cut() {
    for pad in 0..3 {
        let name = "😀".repeat(40_000);
        let text = format!("x y z {}{name}\n1 2 3 4\n", "a".repeat(pad));
        let cloud = read(&utf16(&text, false)).expect("a cloud");
        assert!(cloud.attributes[0].name.ends_with(&name), "{pad}");
    }
}

#[test]
fn other_formats_are_read_in_gzip_too() {
    let positions = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 10.0]];
    for format in [ply(PlyEncoding::BinaryLittleEndian, Scalar::F64), Format::Las { compressed: false }] {
        let file = encode(Vec::new(), format, &positions, &[], &densecloud_cloud::Origin::default())
            .expect("a file");
        assert_eq!(read(&gzip(&file)).expect("a cloud").positions, positions, "{format}");
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("cloud.gz");
        std::fs::write(&path, gzip(&file)).expect("a file");
        assert_eq!(read_cloud_file(&path).expect("a cloud").0.positions, positions, "{format}");
    }
}

#[test]
fn limits_hold_for_what_is_inside_of_gzip() {
    let text = "1 2 3\n".repeat(100_000);
    let packed = gzip(text.as_bytes());
    let limited = |max_bytes| {
        let limits = Limits { max_bytes: Some(max_bytes), max_points: None };
        CloudReader::open(&packed[..], limits).and_then(CloudReader::read)
    };
    assert!(packed.len() < 10_000);
    assert_eq!(limited(600_000).expect("at the limit").positions.len(), 100_000);
    let error = limited(599_999).expect_err("too large");
    assert!(matches!(error, FormatError::TooLarge { limit: 599_999, .. }), "{error}");
}

#[test]
fn damaged_gzip_is_named() {
    let whole = gzip("1 2 3\n4 5 6\n".repeat(100).as_bytes());
    let error = read(&whole[..whole.len() - 12]).expect_err("cut off");
    assert!(matches!(error, FormatError::Truncated { .. }), "{error}");
    let mut damaged = whole.clone();
    let middle = damaged.len() - 6;
    damaged[middle] ^= 0xFF;
    let error = read(&damaged).expect_err("damaged");
    assert!(matches!(error, FormatError::Malformed { .. }), "{error}");
    assert!(error.to_string().contains("gzip"), "{error}");
    let mut followed = whole;
    followed.extend(b"no gzip");
    assert!(read(&followed).is_err());
}

/// A `points3D.bin` of this many points, with an empty track each but for the first.
fn colmap(points: u64, sightings: u64) -> Vec<u8> {
    let mut bytes = points.to_le_bytes().to_vec();
    for key in 1..=points {
        bytes.extend(key.to_le_bytes());
        bytes.extend([1.5, -2.0, key as f64].iter().flat_map(|c| c.to_le_bytes()));
        bytes.extend([1, 2, 3]);
        bytes.extend(0.5_f64.to_le_bytes());
        let seen = if key == 1 { sightings } else { 0 };
        bytes.extend(seen.to_le_bytes());
        bytes.resize(bytes.len() + 8 * seen as usize, 7);
    }
    bytes
}

#[test]
fn a_count_of_points_is_no_mark_of_text_or_gzip() {
    for points in [0xFEFF, 0xFFFE, 0x8_8B1F] {
        let bytes = colmap(points, 2);
        for bytes in [gzip(&bytes), bytes] {
            let cloud = read(&bytes).unwrap_or_else(|why| panic!("{points} points: {why}"));
            assert_eq!(cloud.positions.len() as u64, points);
        }
    }
}

#[test]
fn a_long_track_does_not_hide_what_a_file_is() {
    for sightings in [500, 5000] {
        assert_eq!(read(&colmap(3, sightings)).expect("a cloud").positions.len(), 3);
    }
    assert!(
        read(&colmap(3, 5000)[..10_000]).expect_err("cut off").to_string().contains("a track of 5000 images")
    );
}

#[test]
fn a_mark_of_utf_8_is_taken_off_where_the_format_is_said() {
    let read_as = |text: &str, name: &str| {
        let reading = Reading { format: Some(name.parse().expect("a format")), ..Reading::default() };
        let marked = ["\u{feff}", text].concat();
        CloudReader::open_as(marked.as_bytes(), Limits::default(), &reading).and_then(CloudReader::read)
    };
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let pcd = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nDATA ascii\n";
    for (text, name) in [
        (format!("{ply}1 2 3\n"), "ply"),
        (format!("{pcd}1 2 3\n"), "pcd"),
        ("7 1 2 3 9 9 9 0.5\n".to_owned(), "colmap"),
    ] {
        let cloud = read_as(&text, name).unwrap_or_else(|why| panic!("{name}: {why}"));
        assert_eq!(cloud.positions, [[1.0, 2.0, 3.0]], "{name}");
    }
    // Bare numbers have no mark: 16 bytes of them are a point.
    assert!(read_as("0123456789abc", "kitti").is_ok());
}
