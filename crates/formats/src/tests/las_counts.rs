//! LAS files whose counts of points disagree, with each other or with the file.

use super::*;
use densecloud_cloud::Origin;

/// Where the counts stand: in 32 bits, and from version 1.4 on in 64.
const LEGACY: usize = 107;
const MODERN: usize = 247;

/// A file of version 1.4 of point format 6, or 1 where the system has a code.
fn file(points: usize, compressed: bool, old_format: bool) -> Vec<u8> {
    let positions: Vec<Position> = (0..points).map(|i| [i as f64, (i % 7) as f64, 0.5]).collect();
    let crs = old_format.then(|| "EPSG:25832".parse().expect("a code"));
    let origin = Origin { crs, ..Origin::default() };
    encode(Vec::new(), Format::Las { compressed }, &positions, &[], &origin).expect("a file")
}

fn with(mut bytes: Vec<u8>, legacy: u32, modern: u64) -> Vec<u8> {
    bytes[LEGACY..LEGACY + 4].copy_from_slice(&legacy.to_le_bytes());
    bytes[MODERN..MODERN + 8].copy_from_slice(&modern.to_le_bytes());
    bytes
}

/// The points that are read, and what is told of them.
fn told(bytes: &[u8]) -> (usize, Vec<String>) {
    let claimed = CloudReader::open(bytes, Limits::default()).expect("a header").header().points;
    let cloud = read(bytes).expect("a cloud");
    assert_eq!(claimed, Some(cloud.positions.len() as u64));
    assert!(cloud.positions.iter().enumerate().all(|(i, p)| p[0] == i as f64));
    (cloud.positions.len(), cloud.notes)
}

fn refused(bytes: &[u8]) -> String {
    read(bytes).expect_err("no cloud").to_string()
}

#[test]
fn of_two_counts_that_of_64_bits_rules() {
    for (compressed, old_format) in [(false, false), (true, false), (false, true), (true, true)] {
        let whole = file(100, compressed, old_format);
        assert_eq!(told(&whole), (100, Vec::new()));
        for (legacy, modern, sentence) in [
            (100, 100, None),
            (0, 100, None),
            (80, 100, Some("80 points in 32 bits and 100 in 64; the 100 of 64 bits were read")),
            (120, 100, Some("120 points in 32 bits and 100 in 64; the 100 of 64 bits were read")),
            (100, 0, Some("100 points in 32 bits and 0 in 64; the 100 of 32 bits were read")),
        ] {
            let (points, notes) = told(&with(whole.clone(), legacy, modern));
            assert_eq!((points, notes.len()), (100, usize::from(sentence.is_some())), "{legacy}, {modern}");
            assert!(sentence.is_none_or(|sentence| notes[0].contains(sentence)), "{notes:?}");
        }
        let limits = Limits { max_points: Some(99), ..Limits::default() };
        let error = CloudReader::open(&with(whole, 80, 100)[..], limits).err().expect("too many");
        assert!(matches!(error, FormatError::TooManyPoints { points: 100, .. }));
    }
}

#[test]
fn points_that_the_header_does_not_count_are_told() {
    for compressed in [false, true] {
        let whole = file(100, compressed, false);
        let (points, notes) = told(&with(whole.clone(), 0, 90));
        let there = if compressed { "the file has 100;" } else { "the file has room for 100;" };
        assert!(points == 90 && notes.len() == 1 && notes[0].contains(there), "{points} {notes:?}");
        let error = refused(&with(whole.clone(), 0, 0));
        assert!(error.contains("counts no points, but the file has") && error.contains("100"), "{error}");
        assert!(error.starts_with("byte 247"), "{error}");
    }
    // Before version 1.4 there is one count.
    let mut old = file(100, false, true);
    old[25] = 2;
    assert!(refused(&with(old.clone(), 0, 100)).starts_with("byte 107"));
    assert_eq!(told(&with(old, 100, 90)), (100, Vec::new()));
    // Half a point is none.
    let mut padded = file(100, false, false);
    padded.extend([0; 29]);
    assert_eq!(told(&padded), (100, Vec::new()));
    padded.push(0);
    assert!(told(&padded).1[0].contains("room for 101"));
}

#[test]
fn chunks_without_a_count_of_their_own_are_counted_as_far_as_they_tell() {
    // Three chunks of 50,000.
    let whole = file(100_001, true, true);
    assert_eq!(told(&whole), (100_001, Vec::new()));
    let (points, notes) = told(&with(whole.clone(), 99_999, 99_999));
    assert!(points == 99_999 && notes[0].contains("at least 100000"), "{notes:?}");
    assert!(refused(&with(whole, 0, 0)).contains("at least 100000"));
}

#[test]
fn a_count_that_reaches_beyond_the_points_is_refused() {
    let compressed = file(100, true, false);
    assert!(refused(&with(compressed, 0, 120)).contains("counts 120 points, the file has 100"));
    let plain = file(100, false, false);
    assert!(refused(&with(plain, 0, 120)).contains("counts more than is there"));
    // A long record follows the points.
    let crs = Some(densecloud_cloud::Crs::Wkt(format!("PROJCS[\"{}\"]", "x".repeat(70_000))));
    let origin = Origin { crs, ..Origin::default() };
    let positions = vec![[0.0, 1.0, 2.0]; 100];
    let las = Format::Las { compressed: false };
    let bytes = encode(Vec::new(), las, &positions, &[], &origin).expect("a file");
    assert_eq!(read(&bytes).expect("a cloud").notes, [""; 0]);
    let error = refused(&with(bytes, 0, 120));
    assert!(error.contains("counts 120 points, the file has room for 100"), "{error}");
}
