//! What is written reads back as the same, in every format and encoding.

use proptest::prelude::*;

use super::*;
use std::sync::Arc;

use densecloud_cloud::{Column, Crs, Origin, Table};

fn formats() -> Vec<Format> {
    let mut all = vec![Format::TEXT];
    for encoding in ENCODINGS {
        all.push(ply(encoding, Scalar::F32));
        all.push(ply(encoding, Scalar::F64));
    }
    all
}

/// Finite and not, tiny and huge.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        5 => -1e6..1e6,
        1 => any::<f32>().prop_map(f64::from),
        1 => any::<f64>(),
        1 => Just(f64::NAN),
        1 => Just(-0.0),
    ]
}

fn same(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_format_gives_back_the_positions(
        positions in prop::collection::vec(prop::array::uniform3(coordinate()), 1..300),
        drip in any::<bool>(),
    ) {
        for format in formats() {
            let narrow = matches!(format, Format::Ply { scalar: Scalar::F32, .. });
            let mut expected = positions.clone();
            if narrow {
                for c in expected.as_flattened_mut() {
                    let too_large = c.is_finite() && (*c as f32).is_infinite();
                    *c = if too_large { 0.0 } else { f64::from(*c as f32) };
                }
            }
            let bytes = write(&expected, format);
            if let Some(length) = format.encoded_len(expected.len() as u64, &[], &Origin::default()) {
                prop_assert_eq!(length, bytes.len() as u64);
            }
            let cloud = if drip {
                let reader = CloudReader::open(Drip(&bytes), Limits::default()).expect("a header");
                prop_assert_eq!(reader.header().format, format);
                reader.read().expect("a cloud")
            } else {
                read(&bytes).expect("a cloud")
            };
            prop_assert!(cloud.dropped_properties.is_empty());
            prop_assert_eq!(cloud.positions.len(), expected.len());
            for (a, b) in cloud.positions.as_flattened().iter().zip(expected.as_flattened()) {
                prop_assert!(same(*a, *b), "{a} and {b} in {format:?}");
            }
        }
    }
}

#[test]
fn blocks_and_straddling_rows_are_read_whole() {
    // Larger than the reader's buffer, and no divisor of it.
    let positions: Vec<Position> = (0..100_003).map(|i| [f64::from(i), 0.5, -f64::from(i)]).collect();
    for format in formats() {
        assert_eq!(read(&write(&positions, format)).expect("a cloud").positions, positions, "{format:?}");
    }
}

#[test]
fn a_cloud_reads_the_same_in_every_encoding() {
    let positions = [[0.1_f32, 1.0 / 3.0, 16_777_217.0].map(f64::from)];
    for encoding in ENCODINGS {
        assert_eq!(
            read(&write(&positions, ply(encoding, Scalar::F32))).expect("a cloud").positions,
            positions
        );
    }
}

#[test]
fn a_writer_holds_its_promise() {
    let one = [[1.0; 3]];
    for format in formats() {
        let mut writer = CloudWriter::new(Vec::new(), format, 1).expect("a header");
        writer.write(&one).expect("a point");
        let error = writer.write(&one).expect_err("one too many");
        assert!(matches!(error, FormatError::WrongCount { promised: 1, written: 2 }), "{error}");
        assert!(writer.finish().is_ok());
        let error =
            CloudWriter::new(Vec::new(), format, 1).expect("a header").finish().expect_err("one too few");
        assert!(matches!(error, FormatError::WrongCount { promised: 1, written: 0 }), "{error}");
    }
}

#[test]
fn a_coordinate_too_large_for_floats_is_refused() {
    for encoding in ENCODINGS {
        let mut writer = CloudWriter::new(Vec::new(), ply(encoding, Scalar::F32), 1).expect("a header");
        let error = writer.write(&[[1e300, 0.0, 0.0]]).expect_err("too large");
        assert!(error.to_string().contains("1e300"), "{error}");
    }
}

#[test]
fn text_is_short() {
    assert_eq!(write(&[[0.1, -2.0, 1e-30]], Format::TEXT), b"0.1 -2.0 1e-30\n");
    let narrow = ply(PlyEncoding::Ascii, Scalar::F32);
    let text = String::from_utf8(write(&[[f64::from(0.1_f32), 2.0, 3.0]], narrow)).expect("text");
    assert!(text.ends_with("end_header\n0.1 2.0 3.0\n"), "{text}");
}

#[test]
fn extensions_tell_formats() {
    let of = |name: &str| Format::from_extension(std::path::Path::new(name));
    assert_eq!(of("a/b.PLY"), Some(ply(PlyEncoding::BinaryLittleEndian, Scalar::F32)));
    for name in ["a.xyz", "a.txt", "a.asc", "a.pts", "a.pwn"] {
        assert_eq!(of(name), Some(Format::TEXT));
    }
    assert_eq!(of("a.CSV"), Some(Format::text(Separator::Comma)));
    assert_eq!(of("a.stl"), None);
    assert_eq!(of("ply"), None);
}

fn column(name: &str, values: Values) -> Attribute {
    Attribute { name: name.to_owned(), values }
}

/// One column of every type, extremes among its values.
fn every_kind() -> Vec<Attribute> {
    vec![
        column("a", Values::I8(vec![i8::MIN, 0, i8::MAX])),
        column("red", Values::U8(vec![0, 7, u8::MAX])),
        column("c", Values::I16(vec![i16::MIN, 0, i16::MAX])),
        column("intensity", Values::U16(vec![0, 1, u16::MAX])),
        column("e", Values::I32(vec![i32::MIN, 0, i32::MAX])),
        column("f", Values::U32(vec![0, 1, u32::MAX])),
        column("g", Values::I64(vec![i64::MIN, 0, i64::MAX])),
        column("h", Values::U64(vec![0, 1, u64::MAX])),
        column("nx", Values::F32(vec![f32::MIN_POSITIVE, -0.1, f32::MAX])),
        column("time", Values::F64(vec![f64::MIN_POSITIVE, -0.1, f64::INFINITY])),
    ]
}

fn write_all(cloud: &Cloud, format: Format) -> Vec<u8> {
    let points = cloud.positions.len();
    let mut writer = CloudWriter::with(Vec::new(), format, points as u64, &cloud.attributes, &cloud.origin)
        .expect("a header");
    let (first, rest) = cloud.positions.split_at(1.min(points));
    writer.write_rows(first, &cloud.attributes, 0).expect("points");
    writer.write_rows(rest, &cloud.attributes, first.len()).expect("points");
    writer.finish().expect("the promised count")
}

#[test]
fn every_type_of_attribute_comes_back_in_every_encoding_of_ply() {
    let positions = vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]];
    let cloud = Cloud { positions, attributes: every_kind(), ..Cloud::default() };
    for encoding in ENCODINGS {
        for scalar in [Scalar::F32, Scalar::F64] {
            let bytes = write_all(&cloud, ply(encoding, scalar));
            if let Some(length) = ply(encoding, scalar).encoded_len(3, &cloud.attributes, &cloud.origin) {
                assert_eq!(length, bytes.len() as u64);
            }
            assert_eq!(read_content(&bytes).expect("a cloud"), cloud, "{encoding:?}");
            let dripped = CloudReader::open(Drip(&bytes), Limits::default()).unwrap().read().unwrap();
            assert_eq!(dripped, read(&bytes).expect("a cloud"));
        }
    }
}

#[test]
fn attributes_in_text_come_back_with_their_names() {
    let positions = vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]];
    let attributes = vec![
        column("red", Values::U8(vec![0, 7, 255])),
        column("a b", Values::I64(vec![i64::MIN, 0, i64::MAX])),
        column("time", Values::F64(vec![0.1, f64::NAN, 1e300])),
    ];
    let cloud = Cloud { positions, attributes, ..Cloud::default() };
    let bytes =
        write_all(&cloud, Format::Xyz { names: true, separator: Separator::Space, decimal: Decimal::Point });
    assert!(bytes.starts_with(b"x y z red a_b time\n1.0 2.0 3.0 0 -9223372036854775808 0.1\n"));
    let back = read(&bytes).expect("a cloud");
    assert_eq!(back.positions, cloud.positions);
    assert_eq!(back.attributes[..1], cloud.attributes[..1]);
    assert_eq!(back.attributes[1], column("a_b", cloud.attributes[1].values.clone()));
    assert!(back.attributes[2].values.get(1).is_nan());
}

#[test]
fn what_a_ply_file_tells_of_the_whole_comes_back() {
    let list = |lengths, items| Column::List { lengths, items };
    let rows = 40_000;
    let tables = vec![
        Table {
            name: "face".into(),
            rows: 3,
            columns: vec![
                ("vertex_indices".into(), list(Values::U8(vec![3, 0, 4]), Values::I32((0..7).collect()))),
                ("area".into(), Column::Scalar(Values::F32(vec![0.1, f32::MIN, 1e-30]))),
            ],
        },
        // More than is written at a time.
        Table {
            name: "track".into(),
            rows,
            columns: vec![
                ("time".into(), Column::Scalar(Values::F64((0..rows).map(|i| i as f64 * 0.1).collect()))),
                (
                    "ids".into(),
                    list(
                        Values::U16((0..rows).map(|i| i as u16 % 3).collect()),
                        Values::I64((0..rows as i64 - 1).map(|i| i64::MAX - i).collect()),
                    ),
                ),
            ],
        },
        Table {
            name: "empty".into(),
            rows: 0,
            columns: vec![("a".into(), Column::Scalar(Values::I8(vec![])))],
        },
    ];
    let origin = Origin {
        crs: Some(Crs::Epsg { horizontal: 2992, vertical: Some(5703) }),
        comments: vec!["made by hand".into(), "crs: of another".into()],
        tables: Arc::new(tables),
        ..Origin::default()
    };
    let attributes = vec![column("red", Values::U8(vec![0, 7]))];
    let positions = vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
    let cloud = Cloud { positions, attributes, origin, ..Cloud::default() };
    for encoding in ENCODINGS {
        let format = ply(encoding, Scalar::F64);
        let bytes = write_all(&cloud, format);
        let back = read_content(&bytes).expect("a cloud");
        assert!(back == cloud, "{encoding:?}");
        let length = format.encoded_len(2, &cloud.attributes, &cloud.origin);
        assert_eq!(length, (encoding != PlyEncoding::Ascii).then_some(bytes.len() as u64));
    }
    assert_eq!(Format::TEXT.cannot_hold(&[], &cloud.origin).len(), 4, "the system and three tables");
}

#[test]
fn large_files_with_attributes_are_read_whole() {
    let positions: Vec<Position> = (0..50_001).map(|i| [f64::from(i), 0.5, -f64::from(i)]).collect();
    let attributes = vec![
        column("intensity", Values::U16((0..50_001).map(|i| i as u16).collect())),
        column("id", Values::U32((0..50_001).collect())),
    ];
    let cloud = Cloud { positions, attributes, ..Cloud::default() };
    for encoding in ENCODINGS {
        assert_eq!(read_content(&write_all(&cloud, ply(encoding, Scalar::F64))).expect("a cloud"), cloud);
    }
}
