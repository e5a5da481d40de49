//! What is written reads back as the same, in every format and encoding.

use proptest::prelude::*;

use super::*;

fn formats() -> Vec<Format> {
    let mut all = vec![Format::Xyz];
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
            if let Some(length) = format.encoded_len(expected.len() as u64) {
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
    assert_eq!(write(&[[0.1, -2.0, 1e-30]], Format::Xyz), b"0.1 -2.0 1e-30\n");
    let narrow = ply(PlyEncoding::Ascii, Scalar::F32);
    let text = String::from_utf8(write(&[[f64::from(0.1_f32), 2.0, 3.0]], narrow)).expect("text");
    assert!(text.ends_with("end_header\n0.1 2.0 3.0\n"), "{text}");
}

#[test]
fn extensions_tell_formats() {
    let of = |name: &str| Format::from_extension(std::path::Path::new(name));
    assert_eq!(of("a/b.PLY"), Some(ply(PlyEncoding::BinaryLittleEndian, Scalar::F32)));
    for name in ["a.xyz", "a.txt", "a.asc", "a.pts", "a.pwn", "a.CSV"] {
        assert_eq!(of(name), Some(Format::Xyz));
    }
    assert_eq!(of("a.obj"), None);
    assert_eq!(of("ply"), None);
}
