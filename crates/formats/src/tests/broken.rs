//! Binary PLY of every kind, limits, and input that means harm.

use proptest::prelude::*;

use super::*;
use densecloud_cloud::Column;

/// A binary PLY with an element before and after the vertices, lists, and mixed types.
fn mixed(big: bool) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_{}_endian 1.0\nobj_info x\nelement camera 2\nproperty list ushort double m\n\
         property int8 id\nelement vertex 2\nproperty short x\nproperty uchar red\nproperty double y\n\
         property uint z\nelement face 1\nproperty list uchar int vertex_indices\nelement nothing 4000000000\n\
         end_header\n",
        if big { "big" } else { "little" }
    )
    .into_bytes();
    let mut put = |word: &[u8]| {
        let mut word = word.to_vec();
        if big {
            word.reverse();
        }
        bytes.extend(word);
    };
    put(&1_u16.to_le_bytes());
    put(&9.0_f64.to_le_bytes());
    put(&[1]);
    put(&0_u16.to_le_bytes());
    put(&[2]);
    for (x, y, z) in [(-1_i16, 2.5_f64, 4_000_000_000_u32), (300, -0.125, 7)] {
        put(&x.to_le_bytes());
        put(&[255]);
        put(&y.to_le_bytes());
        put(&z.to_le_bytes());
    }
    put(&[3]);
    for i in [0_i32, 1, 0] {
        put(&i.to_le_bytes());
    }
    bytes
}

#[test]
fn mixed_types_and_other_elements_are_read() {
    for big in [false, true] {
        let bytes = mixed(big);
        let reader = CloudReader::open(Drip(&bytes), Limits::default()).expect("a header");
        let header = reader.header().clone();
        assert_eq!(header.points, Some(2));
        assert_eq!(header.attributes, ["red"]);
        assert_eq!(header.dropped_properties, ["nothing"]);
        let encoding = if big { PlyEncoding::BinaryBigEndian } else { PlyEncoding::BinaryLittleEndian };
        assert_eq!(header.format, ply(encoding, Scalar::F64));
        let cloud = reader.read().expect("a cloud");
        assert_eq!(cloud.positions, [[-1.0, 2.5, 4e9], [300.0, -0.125, 7.0]]);
        assert_eq!(cloud.origin.comments, ["x"]);
        let [camera, face] = cloud.origin.tables.as_slice() else { panic!("two tables") };
        assert_eq!(
            (camera.name.as_str(), camera.rows, face.name.as_str(), face.rows),
            ("camera", 2, "face", 1)
        );
        let list = Column::List { lengths: Values::U16(vec![1, 0]), items: Values::F64(vec![9.0]) };
        assert_eq!(
            camera.columns,
            [("m".to_owned(), list), ("id".to_owned(), Column::Scalar(Values::I8(vec![1, 2])))]
        );
        let list = Column::List { lengths: Values::U8(vec![3]), items: Values::I32(vec![0, 1, 0]) };
        assert_eq!(face.columns, [("vertex_indices".to_owned(), list)]);
    }
}

#[test]
fn a_property_that_is_declared_twice_is_read_under_two_names() {
    let header = |encoding: &str| {
        format!(
            "ply\nformat {encoding} 1.0\nelement vertex 2\nproperty float x\nproperty uchar red\nproperty float y\n\
             property uchar red\nproperty float z\nproperty short red\nelement camera 1\nproperty uchar id\n\
             property uchar id\nend_header\n"
        )
    };
    let mut binary = header("binary_little_endian").into_bytes();
    for (x, numbers) in [(1.0_f32, [7_u8, 8]), (2.0, [9, 10])] {
        binary.extend(
            [&x.to_le_bytes()[..], &numbers[..1], &[0; 4], &numbers[1..], &[0; 4], &[11, 1]].concat(),
        );
    }
    binary.extend([1, 2]);
    let text = header("ascii") + "1 7 0 8 0 267\n2 9 0 10 0 267\n1 2\n";
    for bytes in [binary.as_slice(), text.as_bytes()] {
        let cloud = read(bytes).expect("a cloud");
        assert_eq!(cloud.positions, [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]);
        let attributes: Vec<(&str, &Values)> =
            cloud.attributes.iter().map(|a| (a.name.as_str(), &a.values)).collect();
        let (first, second, third) =
            (Values::U8(vec![7, 9]), Values::U8(vec![8, 10]), Values::I16(vec![267, 267]));
        assert_eq!(attributes, [("red", &first), ("red_", &second), ("red_2", &third)]);
        assert_eq!(
            cloud.notes,
            [
                "`red` is the name of several properties of `vertex`; a later one is called `red_`",
                "`red` is the name of several properties of `vertex`; a later one is called `red_2`",
                "`id` is the name of several properties of `camera`; a later one is called `id_`",
            ]
        );
        // As it is written, others read it.
        let again = encode(
            Vec::new(),
            ply(PlyEncoding::Ascii, Scalar::F32),
            &cloud.positions,
            &cloud.attributes,
            &cloud.origin,
        );
        let again = String::from_utf8(again.expect("a file")).expect("ascii");
        assert!(again.contains("property uchar red_\nproperty short red_2\n"), "{again}");
        assert!(again.contains("property uchar id\nproperty uchar id_\n"), "{again}");
    }
    // Which of two is the coordinate, nothing tells.
    let error = read(text.replacen("uchar red", "uchar x", 1).as_bytes()).expect_err("x twice").to_string();
    assert!(error.contains("x, x may all be the coordinate x"), "{error}");
    // Of a hostile header, some are told.
    let many = "property uchar red\n".repeat(900);
    let text = text
        .replacen("property uchar red\n", &many, 1)
        .replace(" 7 ", &" 7 ".repeat(900))
        .replace(" 9 ", &" 9 ".repeat(900));
    let cloud = read(text.as_bytes()).expect("a cloud");
    assert_eq!((cloud.attributes.len(), cloud.notes.len()), (902, 20));
    assert_eq!(cloud.notes[19], "and 883 more of this kind");
}

#[test]
fn every_cut_is_an_error() {
    let bytes = mixed(false);
    for end in 0..bytes.len() {
        assert!(read(&bytes[..end]).is_err(), "cut at {end}");
    }
}

#[test]
fn padding_may_follow_and_data_may_not() {
    let mut bytes = mixed(false);
    bytes.extend(b"\n\0\0\x1A");
    assert!(read(&bytes).is_ok());
    bytes.push(b'7');
    let error = read(&bytes).expect_err("data after the end").to_string();
    assert!(error.contains(&format!("byte {}", bytes.len() - 1)), "{error}");
}

fn vertices(count: &str, body: &[u8]) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n\
         property float z\nend_header\n"
    )
    .into_bytes();
    bytes.extend(body);
    bytes
}

#[test]
fn a_claim_that_the_data_do_not_keep_names_where_they_end() {
    for count in ["4000000000", "18446744073709551615"] {
        let bytes = vertices(count, &[0; 30]);
        let error = read(&bytes).expect_err("too short");
        assert!(matches!(error, FormatError::Truncated { .. }));
        let text = error.to_string();
        assert!(text.contains(count) && text.contains("2 are there"), "{text}");
    }
}

#[test]
fn limits_are_checked_from_the_header_and_while_reading() {
    let open = |bytes: &[u8], max_bytes, max_points| {
        CloudReader::open(bytes, Limits { max_bytes, max_points }).map(|r| r.header().clone())
    };
    let bytes = vertices("4000000000", &[]);
    let error = open(&bytes, None, Some(1000)).expect_err("too many");
    assert!(matches!(error, FormatError::TooManyPoints { points: 4_000_000_000, limit: 1000 }));
    assert!(error.to_string().contains("max_points = 1000"), "{error}");
    let error = open(&bytes, Some(1 << 20), None).expect_err("too large");
    assert!(matches!(error, FormatError::TooLarge { bytes: 48_000_000_000, .. }), "{error}");
    assert!(error.to_string().contains("max_bytes = 1048576"), "{error}");

    let text = "1 2 3\n".repeat(100);
    let read = |text: &str, max_bytes, max_points| {
        CloudReader::open(text.as_bytes(), Limits { max_bytes, max_points })?.read()
    };
    assert_eq!(read(&text, Some(600), Some(100)).expect("at the limits").positions.len(), 100);
    assert!(matches!(read(&text, Some(599), None), Err(FormatError::TooLarge { bytes: 600, limit: 599 })));
    let error = read(&text, None, Some(99)).expect_err("too many");
    assert!(matches!(error, FormatError::TooManyPoints { points: 100, limit: 99 }));
    let error = read(&format!("100\n{text}"), None, Some(99)).expect_err("too many");
    assert!(matches!(error, FormatError::TooManyPoints { points: 100, limit: 99 }));
}

#[test]
fn headers_without_positions_are_refused() {
    for (properties, what) in [
        ("element vertex 1\nproperty float x\nproperty float y\n", "`z`"),
        ("element vertex 1\nproperty list uchar float x\nproperty float y\nproperty float z\n", "`x`"),
        ("element vertex 4000000000\n", "`x`"),
        ("element face 1\nproperty list uchar int vertex_indices\n", "`vertex`"),
    ] {
        let text = format!("ply\nformat ascii 1.0\n{properties}end_header\n1 2 3\n");
        let error = read(text.as_bytes()).expect_err("no positions").to_string();
        assert!(error.contains(what), "{error}");
    }
}

#[test]
fn empty_and_foreign_files_are_named() {
    for bytes in [b"".as_slice(), b"# nothing\n\n", &vertices("0", &[])] {
        assert!(matches!(read(bytes), Err(FormatError::Empty("points"))));
    }
    for (bytes, name) in
        [(b"\x89HDF\r\n".as_slice(), "HDF5"), (b"\xFF\xFE\0\0x", "UTF-32"), (b"\x00\x01\x02", "binary data")]
    {
        let error = read(bytes).expect_err("foreign");
        assert!(matches!(error, FormatError::Unrecognised { .. }));
        assert!(error.to_string().contains(name), "{error}");
    }
}

#[test]
fn content_wins_over_the_extension() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cloud.xyz");
    std::fs::write(&path, vertices("1", &[0; 12])).expect("a file");
    let (cloud, header) = read_cloud_file(&path).expect("a cloud");
    assert_eq!(cloud.positions, [[0.0; 3]]);
    assert_eq!(header.format, ply(PlyEncoding::BinaryLittleEndian, Scalar::F32));
    let path = folder.path().join("cloud.ply");
    std::fs::write(&path, "1 2 3\n").expect("a file");
    assert!(matches!(read_cloud_file(&path), Err(FormatError::Unrecognised { .. })));
    let path = folder.path().join("cloud");
    std::fs::write(&path, "1 2 3\n").expect("a file");
    assert_eq!(read_cloud_file(&path).expect("a cloud").0.positions, [[1.0, 2.0, 3.0]]);
    assert!(matches!(read_cloud_file(&folder.path().join("none")), Err(FormatError::Io(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// No input panics, and none makes more points than it has bytes.
    #[test]
    fn arbitrary_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..500), prefix in 0_usize..4) {
        let prefix = ["", "ply\n", "1 2 3\n", "OFF\n"][prefix];
        let bytes = [prefix.as_bytes(), &bytes].concat();
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.positions.capacity() <= 8 * bytes.len());
        }
        let _ = read_mesh(bytes.as_slice());
    }

    #[test]
    fn damaged_files_are_survived(
        kind in 0..5,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = match kind {
            0 => mixed(false),
            1 => mixed(true),
            2 => b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                   property float z\nelement face 1\nproperty list uchar int vertex_index\nend_header\n\
                   0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n".to_vec(),
            3 => b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n".to_vec(),
            _ => b"x,y,z\n1,2,3\n4,5,6\n".to_vec(),
        };
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        bytes.truncate(cut.index(2 * bytes.len()));
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.positions.capacity() <= 8 * bytes.len());
        }
        let _ = read_mesh(bytes.as_slice());
    }
}

#[test]
fn coordinates_are_known_by_their_names_in_any_case() {
    let file = |properties: &str| {
        let lines: String = properties.split(' ').map(|name| format!("property double {name}\n")).collect();
        format!("ply\nformat ascii 1.0\nelement vertex 1\n{lines}end_header\n1 2 3 4 5 6\n")
    };
    for (properties, position, others) in [
        ("X Y Z a b c", [1.0, 2.0, 3.0], ["a", "b", "c"]),
        ("a z Y b X c", [5.0, 3.0, 2.0], ["a", "b", "c"]),
        ("Easting Northing Elevation a b c", [1.0, 2.0, 3.0], ["a", "b", "c"]),
        ("lat lon a height b c", [2.0, 1.0, 4.0], ["a", "b", "c"]),
        // What is named as it should be comes before what is only like it.
        ("X Y Z x y z", [4.0, 5.0, 6.0], ["X", "Y", "Z"]),
    ] {
        let cloud = read(file(properties).as_bytes()).expect(properties);
        assert_eq!(cloud.positions, [position], "{properties}");
        let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(names, others, "{properties}");
    }
    for (properties, told) in [
        ("X Y a b c d", "no number `z`, and no coordinates by other names: X, Y, a, b, c, d"),
        ("u v w b c d", "no number `x`"),
        ("X y Z x b c", "may all be the coordinate x"),
    ] {
        let error = read(file(properties).as_bytes()).expect_err(properties).to_string();
        assert!(error.contains(told), "{error}");
    }
    // A list is no coordinate.
    let list = file("x y z a b c").replacen("property double x", "property list uchar double x", 1);
    assert!(read(list.as_bytes()).expect_err("a list").to_string().contains("no number `x`"));
}
