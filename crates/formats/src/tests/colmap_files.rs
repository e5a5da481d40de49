//! COLMAP's points, as text and as records.

use proptest::prelude::*;

use super::*;
use densecloud_cloud::Origin;

const TEXT: &str = "# 3D point list with one line of data per point:\n\
                    #   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n\
                    # Number of points: 3, mean track length: 1\n# kept by hand\n\
                    7 1.5 -2 3 10 20 30 0.5 1 8 2 9\n5000000000 0.25 0 -1e-3 255 0 7 1.25\n\n12 4 5 6 1 2 3 0 3 4\n";

/// The same points as records.
fn records() -> Vec<u8> {
    let mut bytes = 3_u64.to_le_bytes().to_vec();
    for (key, position, colour, error, track) in [
        (7_u64, [1.5, -2.0, 3.0], [10, 20, 30], 0.5, &[1_u32, 8, 2, 9][..]),
        (5_000_000_000, [0.25, 0.0, -1e-3], [255, 0, 7], 1.25, &[]),
        (12, [4.0, 5.0, 6.0], [1, 2, 3], 0.0, &[3, 4]),
    ] {
        bytes.extend(key.to_le_bytes());
        bytes.extend(position.iter().flat_map(|c: &f64| c.to_le_bytes()));
        bytes.extend(colour);
        bytes.extend(f64::to_le_bytes(error));
        bytes.extend((track.len() as u64 / 2).to_le_bytes());
        bytes.extend(track.iter().flat_map(|n| n.to_le_bytes()));
    }
    bytes
}

fn both() -> [(bool, Vec<u8>); 2] {
    [(false, TEXT.as_bytes().to_vec()), (true, records())]
}

fn format(binary: bool) -> Format {
    Format::Colmap { binary }
}

fn written(cloud: &Cloud, binary: bool) -> Vec<u8> {
    encode(Vec::new(), format(binary), &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

fn keys(cloud: &Cloud) -> Vec<u64> {
    let column = cloud.attributes.iter().find(|a| a.name == "point3d_id").expect("keys");
    (0..column.values.len()).map(|i| column.values.get(i) as u64).collect()
}

#[test]
fn both_forms_are_read_alike() {
    for (binary, bytes) in both() {
        let reader = CloudReader::open(Drip(&bytes), Limits::default()).expect("a header");
        assert_eq!((reader.header().format, reader.header().points), (format(binary), binary.then_some(3)));
        let cloud = reader.read().expect("a cloud");
        assert_eq!(cloud.positions, [[1.5, -2.0, 3.0], [0.25, 0.0, -1e-3], [4.0, 5.0, 6.0]]);
        let column = |i: usize| (cloud.attributes[i].name.as_str(), cloud.attributes[i].values.clone());
        assert_eq!(column(0), ("point3d_id", Values::I64(vec![7, 5_000_000_000, 12])));
        assert_eq!(column(1), ("red", Values::U8(vec![10, 255, 1])));
        assert_eq!(column(3), ("blue", Values::U8(vec![30, 7, 3])));
        assert_eq!(column(4), ("error", Values::F64(vec![0.5, 1.25, 0.0])));
        assert_eq!(cloud.dropped_properties, ["the tracks of 2 points"]);
        assert_eq!(cloud.origin.comments.len(), usize::from(!binary));
    }
    assert_eq!(read(TEXT.as_bytes()).expect("a cloud").origin.comments, ["kept by hand"]);
    // Small keys are small numbers.
    let small = read(TEXT.replace("5000000000", "50").as_bytes()).expect("a cloud");
    assert_eq!(small.attributes[0].values, Values::U8(vec![7, 50, 12]));
}

#[test]
fn what_is_written_reads_back() {
    for (from, bytes) in both() {
        let cloud = read_content(&bytes).expect("a cloud");
        for binary in [false, true] {
            let bytes = written(&cloud, binary);
            let length = format(binary).encoded_len(3, &cloud.attributes, &cloud.origin);
            assert_eq!(length, binary.then_some(bytes.len() as u64));
            let back = read_content(&bytes).expect("a cloud");
            assert_eq!((&back.positions, &back.attributes), (&cloud.positions, &cloud.attributes));
            assert!(back.dropped_properties.is_empty(), "tracks are empty");
            assert_eq!(back.origin.comments.len(), usize::from(!from && !binary));
        }
    }
    let text = String::from_utf8(written(&read(&records()).expect("a cloud"), false)).expect("text");
    assert!(
        text.contains("# Number of points: 3, mean track length: 0\n7 1.5 -2.0 3.0 10 20 30 0.5\n"),
        "{text}"
    );
}

#[test]
fn an_error_that_nobody_knows_is_no_number() {
    let error =
        |cloud: &Cloud| cloud.attributes.iter().find(|a| a.name == "error").expect("one").values.clone();
    let mut bytes = records();
    bytes[8 + 35..8 + 43].copy_from_slice(&(-1.0_f64).to_le_bytes());
    for bytes in [bytes, TEXT.replacen("30 0.5", "30 -1", 1).into_bytes()] {
        let cloud = read(&bytes).expect("a cloud");
        assert!(error(&cloud).get(0).is_nan() && error(&cloud).get(1) == 1.25);
        let text = String::from_utf8(written(&cloud, false)).expect("text");
        assert!(text.contains("\n7 1.5 -2.0 3.0 10 20 30 -1.0\n"), "{text}");
        assert_eq!(written(&cloud, true)[8 + 35..8 + 43], (-1.0_f64).to_le_bytes());
    }
    // Under another program's name, too.
    let attributes =
        vec![Attribute { name: "scalar_error".into(), values: Values::F32(vec![0.5, f32::INFINITY]) }];
    let cloud = Cloud { attributes, ..Cloud::from(vec![[0.0; 3], [1.0; 3]]) };
    assert!(format(true).cannot_hold(&cloud.attributes, &cloud.origin).is_empty());
    let back = error(&read(&written(&cloud, true)).expect("a cloud"));
    assert!(back.get(0) == 0.5 && back.get(1).is_nan(), "{back:?}");
}

#[test]
fn text_has_as_many_points_as_it_counts() {
    let lines: Vec<&str> = TEXT.lines().collect();
    let error = read(lines[..6].join("\n").as_bytes()).expect_err("cut").to_string();
    assert_eq!(error, "the data end at line 6: line 3 counts 3 points, and 2 are there");
    let error = read((TEXT.to_owned() + "13 4 5 6 1 2 3 0\n").as_bytes()).expect_err("more").to_string();
    assert!(error.starts_with("line 3: it counts 3 points, and 4 follow; "), "{error}");
    let none = lines[..4].join("\n");
    assert!(read(none.as_bytes()).expect_err("none").to_string().contains("line 3 counts 3 points, and 0"));
    // As others write it, and in words that are no count of COLMAP's.
    for (from, to) in [
        ("mean track length: 1", "mean track length: 1.3333"),
        ("mean track length: 1", "mean track length: nan"),
        ("points: 3, mean track length: 1", "points: 7"),
        ("points: 3, mean", "points: about 7, mean"),
        ("# kept by hand", "# Number of points: 7, mean track length: 2"),
    ] {
        let text = TEXT.replacen(from, to, 1);
        assert_eq!(read(text.as_bytes()).expect(&text).positions.len(), 3);
    }
    // What another file says of itself is no count of this one.
    let mut cloud = read(TEXT.as_bytes()).expect("a cloud");
    cloud.origin.comments = vec!["Number of points: 7, mean track length: 2".into(), "a\nNumber".into()];
    let back = read(&written(&cloud, false)).expect("a cloud");
    assert_eq!((back.positions.len(), back.origin.comments), (3, vec!["a Number".to_owned()]));
}

#[test]
fn every_point_has_a_key_and_those_of_the_source_keep_theirs() {
    let source = read(TEXT.as_bytes()).expect("a cloud");
    // Its second point, a new one, its first, its second again, and another new one; each with the nearest one's attributes.
    let rows = [1, 1, 0, 1, 2];
    let mut positions: Vec<Position> = rows.iter().map(|row| source.positions[*row as usize]).collect();
    positions[1][0] += 0.5;
    positions[4][2] -= 0.5;
    let attributes: Vec<Attribute> = source
        .attributes
        .iter()
        .map(|a| Attribute { name: a.name.clone(), values: a.values.gather(&rows) })
        .collect();
    let dense = Cloud { positions, attributes, origin: source.origin.clone(), ..Cloud::default() };
    for binary in [false, true] {
        let back = read(&written(&dense, binary)).expect("a cloud");
        assert_eq!(keys(&back), [5_000_000_000, 5_000_000_001, 7, 5_000_000_002, 5_000_000_003]);
        assert_eq!(back.attributes[1].values, Values::U8(vec![255, 255, 10, 255, 1]));
    }
    assert!(format(true).cannot_hold(&dense.attributes, &dense.origin).is_empty());
    // Of another source, they count from 1, and its own are lost.
    let dense = Cloud { origin: Origin::default(), ..dense };
    assert_eq!(format(true).cannot_hold(&dense.attributes, &dense.origin), ["point3d_id"]);
    assert_eq!(keys(&read(&written(&dense, true)).expect("a cloud")), [1, 2, 3, 4, 5]);
}

#[test]
fn other_clouds_have_black_points_of_unknown_error_and_what_is_lost_is_told() {
    let add = |name: &str, values| Attribute { name: name.into(), values };
    let attributes = vec![
        add("nx", Values::F32(vec![1.0, 0.0])),
        add("Red", Values::U8(vec![9, 8])),
        add("Green", Values::U8(vec![7, 6])),
        add("Blue", Values::U8(vec![5, 4])),
        add("intensity", Values::U16(vec![1, 2])),
    ];
    let cloud = Cloud { positions: vec![[1.0; 3], [f64::NAN, 2.0, 1e300]], attributes, ..Cloud::default() };
    assert_eq!(format(true).cannot_hold(&cloud.attributes, &cloud.origin), ["nx", "intensity"]);
    // Such coordinates are not recognised.
    let reading = Reading { format: "colmap".parse().ok(), ..Reading::default() };
    let read = |bytes: &[u8]| CloudReader::open_as(bytes, Limits::default(), &reading)?.read();
    for binary in [false, true] {
        let back = read(&written(&cloud, binary)).expect("a cloud");
        assert_eq!((back.positions[0], back.positions[1][2]), ([1.0; 3], 1e300));
        assert_eq!(back.attributes[2].values, Values::U8(vec![7, 6]));
        assert!((0..2).all(|i| back.attributes[4].values.get(i).is_nan()), "{:?}", back.attributes[4]);
        let plain = Cloud::from(cloud.positions.clone());
        let back = read(&written(&plain, binary)).expect("a cloud");
        assert_eq!(back.attributes[1].values, Values::U8(vec![0, 0]));
    }
}

#[test]
fn colours_of_every_depth_become_bytes() {
    let cloud = |values: [Values; 3]| {
        let names = ["R", "G", "B"];
        let attributes =
            names.into_iter().zip(values).map(|(name, values)| Attribute { name: name.into(), values });
        Cloud { attributes: attributes.collect(), ..Cloud::from(vec![[0.0; 3], [1.0; 3]]) }
    };
    let wide = |a, b| Values::U16(vec![a, b]);
    let real = |a, b| Values::F64(vec![a, b]);
    for (values, expected) in [
        ([wide(255 * 257, 0), wide(128 * 257, 1), wide(7 * 256, 255)], [[255, 128, 7], [0, 0, 0]]),
        ([wide(255, 0), wide(128, 1), wide(7, 255)], [[255, 128, 7], [0, 1, 255]]),
        ([real(1.0, 0.0), real(0.5, f64::NAN), real(0.2, -3.0)], [[255, 128, 51], [0, 0, 0]]),
        ([real(255.0, 0.0), real(127.6, 1.0), real(7.0, 2.0)], [[255, 128, 7], [0, 1, 2]]),
    ] {
        let cloud = cloud(values);
        assert!(format(true).cannot_hold(&cloud.attributes, &cloud.origin).is_empty());
        let back = read(&written(&cloud, true)).expect("a cloud");
        for (row, expected) in expected.iter().enumerate() {
            let bytes: Vec<f64> = (1..4).map(|i| back.attributes[i].values.get(row)).collect();
            assert_eq!(bytes, expected.map(f64::from), "{:?}", cloud.attributes);
        }
    }
    // No white is that bright.
    let cloud = cloud([real(70_000.0, 0.0), real(0.0, 0.0), real(0.0, 0.0)]);
    assert_eq!(format(true).cannot_hold(&cloud.attributes, &cloud.origin), ["R", "G", "B"]);
}

#[test]
fn names_and_media_types_tell_which_form() {
    for (name, binary) in [("a/points3D.txt", false), ("POINTS3D.BIN", true)] {
        assert_eq!(Format::of_output(name.as_ref()).expect("a format"), Some(format(binary)));
        assert_eq!(Format::from_media_type(format(binary).media_type()), Some(format(binary)));
    }
    assert_eq!(Format::from_extension("my_points3D.txt".as_ref()), Some(Format::TEXT));
    assert!(Format::of_output("other.bin".as_ref()).is_err());
    // Without the comments, the name tells.
    let folder = tempfile::tempdir().expect("a folder");
    let bare = "1 0.5 0 0 1 2 3 0.25 4 5\n2 1 0 0 1 2 3 0.25\n";
    std::fs::write(folder.path().join("points3D.txt"), bare).expect("a file");
    let (cloud, header) = read_cloud_file(&folder.path().join("points3D.txt")).expect("a cloud");
    assert_eq!((header.format, cloud.positions[0]), (format(false), [0.5, 0.0, 0.0]));
    // One record could be anything, but for its name.
    let mut one = records();
    one[0] = 1;
    one.truncate(8 + 51 + 16);
    assert!(read(&one).is_err());
    std::fs::write(folder.path().join("points3D.bin"), &one).expect("a file");
    let (cloud, header) = read_cloud_file(&folder.path().join("points3D.bin")).expect("a cloud");
    assert_eq!((header.format, cloud.positions[0]), (format(true), [1.5, -2.0, 3.0]));
}

#[test]
fn what_is_wrong_is_told() {
    for (from, to, told) in [
        ("10 20 30", "10 20 256", "line 5: 256 is not a whole number from 0 to 255 (B)"),
        ("10 20 30", "0.5 20 30", "line 5: 0.5 is not a whole number from 0 to 255 (R)"),
        ("1 8 2 9", "1 8 2", "line 5: a track of 3 numbers"),
        ("1 8 2 9", "1 8 2 nine", "line 5: `nine` is not a whole number (TRACK)"),
        ("255 0 7 1.25", "255 0 7", "line 6: no ERROR"),
        ("7 1.5", "-7 1.5", "line 5: `-7` is no POINT3D_ID"),
        ("7 1.5", "18446744073709551615 1.5", "is no POINT3D_ID"),
        ("-2 3", "-2 x", "line 5: `x` is not a number (Z)"),
    ] {
        let error = read(TEXT.replacen(from, to, 1).as_bytes()).expect_err(told).to_string();
        assert!(error.contains(told), "{error}");
    }
    let bytes = records();
    for end in 130..bytes.len() {
        assert!(read(&bytes[..end]).is_err(), "cut at {end}");
    }
    let error = read(&bytes[..bytes.len() - 8]).expect_err("a track").to_string();
    assert!(error.contains("a track of 1 images"), "{error}");
    let error = read(&bytes[..140]).expect_err("a record").to_string();
    assert!(error.contains("the file counts 3 points, and 2 are there"), "{error}");
    let more = [&bytes[..], &[1]].concat();
    assert!(read(&more).expect_err("more").to_string().contains("data go on"));
    // A claim of what is not there takes no room.
    let mut claim = bytes;
    claim[3] = 200;
    assert!(matches!(read(&claim), Err(FormatError::Truncated { .. })));
    let limits = Limits { max_points: Some(2), max_bytes: None };
    assert!(matches!(CloudReader::open(&claim[..], limits), Err(FormatError::TooManyPoints { .. })));
    let limits = Limits { max_points: None, max_bytes: Some(500) };
    assert!(matches!(CloudReader::open(&claim[..], limits), Err(FormatError::TooLarge { .. })));
    let limits = Limits { max_points: Some(2), max_bytes: None };
    let error = CloudReader::open(TEXT.as_bytes(), limits).expect("a header").read();
    assert!(matches!(error, Err(FormatError::TooManyPoints { points: 3, limit: 2 })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn damage_never_panics(
        binary in any::<bool>(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = if binary { records() } else { TEXT.as_bytes().to_vec() };
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.positions.capacity() <= bytes.len());
        }
    }
}
