//! NumPy arrays, made by hand.

use proptest::prelude::*;

use super::*;

/// A file with this literal and these data, in the version 1 of the format.
fn npy(literal: &str, data: &[u8]) -> Vec<u8> {
    let length = (literal.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], literal.as_bytes(), data].concat()
}

fn array(kind: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let fortran = if fortran { "True" } else { "False" };
    npy(&format!("{{'descr': {kind}, 'fortran_order': {fortran}, 'shape': {shape}, }}\n"), data)
}

fn doubles(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn format(scalar: Scalar, fields: bool) -> Format {
    Format::Npy { scalar, fields }
}

fn format_of(bytes: &[u8]) -> Format {
    CloudReader::open(bytes, Limits::default()).expect("a header").header().format
}

/// Two points and a time, of 22 bytes with padding; a name and an array are no numbers.
fn structured() -> Vec<u8> {
    let kind = "[('x', '<f4'), ('Y', '>i2'), ('', '|V2'), ('z', '|u1'), ('time', '<f8'), ('n', '|S1'), \
                (('title', 'p'), '<i2', (2,))]";
    let mut data = Vec::new();
    for (x, y, z, time) in [(1.5_f32, -2_i16, 3, 1e9), (-4.0, 5, 255, 2e9)] {
        data.extend(x.to_le_bytes());
        data.extend(y.to_be_bytes());
        data.extend([9, 9, z]);
        data.extend(f64::to_le_bytes(time));
        data.extend([b'n', 1, 2, 3, 4]);
    }
    array(kind, false, "(2,)", &data)
}

#[test]
fn tables_are_read_by_row_and_by_column() {
    let rows = array("'<f8'", false, "(2, 4)", &doubles(&[1.0, 2.0, 3.0, 0.5, 4.0, 5.0, 6.0, -0.5]));
    let columns = array("'<f8'", true, "(2, 4L)", &doubles(&[1.0, 4.0, 2.0, 5.0, 3.0, 6.0, 0.5, -0.5]));
    let grid = array("'<f8'", false, "(1, 2, 4)", &doubles(&[1.0, 2.0, 3.0, 0.5, 4.0, 5.0, 6.0, -0.5]));
    for bytes in [rows, columns, grid] {
        let cloud = read(&bytes).expect("a cloud");
        assert_eq!(cloud.positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        let attribute = Attribute { name: "column 4".into(), values: Values::F64(vec![0.5, -0.5]) };
        assert_eq!(cloud.attributes, [attribute]);
        assert_eq!(format_of(&bytes), format(Scalar::F64, false));
    }
}

#[test]
fn dimensions_of_one_are_none() {
    let data = doubles(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let by_column = doubles(&[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
    for (fortran, shape, data) in [
        (false, "(1, 2, 3)", &data),
        (false, "(2, 1, 3)", &data),
        (false, "(1, 2, 1, 3)", &data),
        (true, "(1, 2, 3)", &by_column),
        (true, "(2, 1, 3)", &by_column),
    ] {
        let cloud = read(&array("'<f8'", fortran, shape, data)).expect(shape);
        assert_eq!(cloud.positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{shape}");
    }
    // Three points, a point a row, as everywhere.
    let square = array("'<f8'", false, "(3, 3)", &doubles(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]));
    assert_eq!(read(&square).expect("a cloud").positions[1], [4.0, 5.0, 6.0]);
    let kind = "[('X', '<f8'), ('Y', '<f8'), ('Z', '<f8')]";
    let column = array(kind, false, "(2, 1)", &data);
    assert_eq!(read(&column).expect("a cloud").positions[1], [4.0, 5.0, 6.0]);
    let geographic = array("[('height', '<f8'), ('lat', '<f8'), ('lon', '<f8')]", false, "(2,)", &data);
    assert_eq!(read(&geographic).expect("a cloud").positions[1], [6.0, 5.0, 4.0]);
}

#[test]
fn types_and_byte_orders_are_read() {
    for (kind, data, scalar) in [
        ("'|i1'", vec![1, 254, 3], Scalar::F32),
        ("'>u2'", vec![0, 1, 255, 254, 0, 3], Scalar::F32),
        ("'<f2'", vec![0, 0x3C, 0, 0xC0, 0, 0x42], Scalar::F32),
        ("'>f4'", [1.0_f32, -2.0, 3.0].iter().flat_map(|v| v.to_be_bytes()).collect(), Scalar::F32),
        ("'<i8'", [1_i64, -2, 3].iter().flat_map(|v| v.to_le_bytes()).collect(), Scalar::F64),
    ] {
        let bytes = array(kind, false, "(1, 3)", &data);
        let y = if kind == "'>u2'" { 65_534.0 } else { -2.0 };
        assert_eq!(read(&bytes).expect(kind).positions, [[1.0, y, 3.0]], "{kind}");
        assert_eq!(format_of(&bytes), format(scalar, false));
    }
}

#[test]
fn columns_of_a_table_are_told_by_their_values() {
    let data = doubles(&[
        0.0, 0.0, 0.0, 255.0, 7.0, 0.0, 0.6, 0.8, 0.0, 0.1, 0.2, 0.3, 9.0, 8.0, 7.0, 0.0, 0.0, -1.0,
    ]);
    let cloud = read(&array("'<f8'", false, "(2, 9)", &data)).expect("a cloud");
    let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(names, ["red", "green", "blue", "nx", "ny", "nz"]);
}

#[test]
fn fields_are_read_by_name_and_what_is_no_number_is_named() {
    let bytes = structured();
    let cloud = read(&bytes).expect("a cloud");
    assert_eq!(cloud.positions, [[1.5, -2.0, 3.0], [-4.0, 5.0, 255.0]]);
    assert_eq!(cloud.attributes, [Attribute { name: "time".into(), values: Values::F64(vec![1e9, 2e9]) }]);
    assert_eq!(cloud.dropped_properties, ["n", "p"]);
    assert_eq!(format_of(&bytes), format(Scalar::F32, true));
}

#[test]
fn what_is_written_reads_back_and_its_length_is_known() {
    let positions: Vec<Position> = (0..9000).map(|i| [f64::from(i) / 8.0, -0.0, 1e6]).collect();
    let attributes = [
        ("it's a \\", Values::I64((0..9000).map(|i| i64::MAX - i).collect())),
        ("größe\n", Values::F32((0..9000).map(|i| i as f32 / 3.0).collect())),
        ("x", Values::U8((0..9000).map(|i| i as u8).collect())),
        ("", Values::U16((0..9000).map(|i| i as u16).collect())),
    ];
    let attributes: Vec<Attribute> =
        attributes.into_iter().map(|(name, values)| Attribute { name: name.into(), values }).collect();
    for (scalar, fields, kept) in
        [(Scalar::F64, true, 4), (Scalar::F32, true, 3), (Scalar::F64, false, 0), (Scalar::F32, false, 0)]
    {
        let attributes = &attributes[..kept];
        let format = format(scalar, fields);
        let bytes = encode(Vec::new(), format, &positions, attributes, &Default::default()).expect("a file");
        assert_eq!(format.encoded_len(9000, attributes, &Default::default()), Some(bytes.len() as u64));
        let cloud = read(&bytes).expect("a cloud");
        assert!(cloud.positions == positions);
        assert_eq!(cloud.attributes.len(), kept);
        for (read, (given, name)) in
            cloud.attributes.iter().zip(attributes.iter().zip(["it's a \\", "größe_", "x_", "column 7"]))
        {
            assert!(read.name == name && read.values == given.values, "{name}");
        }
        assert_eq!(format_of(&bytes), Format::Npy { scalar, fields: kept > 0 });
    }
    let table = format(Scalar::F32, false);
    let bytes = encode(Vec::new(), table, &positions, &attributes[2..], &Default::default()).expect("a file");
    assert_eq!(table.encoded_len(9000, &attributes[2..], &Default::default()), Some(bytes.len() as u64));
    let cloud = read(&bytes).expect("a cloud");
    assert_eq!(cloud.attributes[0].values, Values::F32((0..9000).map(|i| f32::from(i as u8)).collect()));
}

#[test]
fn what_is_no_cloud_is_refused_with_its_reason() {
    for (kind, shape, why) in [
        ("'<f8'", "(4, 2)", "(4, 2)"),
        ("'<f8'", "(9,)", "(9,)"),
        ("'<f4'", "(2, 600, 3)", "(2, 600, 3) holds 2 clouds"),
        ("'<f4'", "(2, 600, 3)", "save one as a[0], or all as one: a.reshape(-1, 3)"),
        ("'<f4'", "(480, 640, 3)", "or the rows of a picture"),
        ("'<f4'", "(1, 2, 600, 3)", "a.reshape(-1, 3)"),
        ("'<f4'", "(3, 600)", "(3, 600) has its points side by side; transpose it: a.T"),
        ("'<f4'", "(3, 4)", "transpose"),
        ("'<f4'", "(6, 5000)", "transpose"),
        ("'<f4'", "(1, 3, 600)", "transpose"),
        ("[('x', '<f4'), ('y', '<f4'), ('z', '<f4')]", "(4, 5)", "all as one: a.ravel()"),
        ("'<U8'", "(4, 3)", "text (`<U8`)"),
        ("'|S5'", "(4, 3)", "text"),
        ("'<M8[ns]'", "(4, 3)", "times"),
        ("'<f8'", "()", "alone"),
        ("'<f8'", "(1, 1000000000)", "columns"),
        ("'<c16'", "(1, 3)", "`<c16`"),
        ("'|O'", "(1, 3)", "objects"),
        ("[('x', '<f8'), ('y', '<f8')]", "(1,)", "`z`"),
        ("[('x', '<f8', (9999999999, 9999999999))]", "(1,)", "too many bytes"),
        ("7", "(1,)", "neither"),
        ("((((((((((((((((((('a'", "(1,)", "too deep"),
        ("'<f8'", "(1 3)", "no `)`"),
    ] {
        let error = read(&array(kind, false, shape, &[0; 24])).expect_err(why).to_string();
        assert!(error.contains(why), "{error}");
    }
    let error = read(b"\x93NUMPY\x02\x00\xFF\xFF\xFF\xFF{").expect_err("too long").to_string();
    assert!(error.contains("longer than"), "{error}");
    assert!(read(b"\x93NUMPY\x07\x00aaaa").expect_err("a version").to_string().contains("version 7"));
    let claim = array("'<f4'", false, "(4000000000, 3)", &[0; 30]);
    assert!(read(&claim).expect_err("a claim").to_string().contains("2 are there"));
    let limits = Limits { max_points: Some(5), max_bytes: None };
    assert!(matches!(CloudReader::open(&claim[..], limits), Err(FormatError::TooManyPoints { .. })));
    let limits = Limits { max_points: None, max_bytes: Some(500) };
    assert!(matches!(CloudReader::open(&claim[..], limits), Err(FormatError::TooLarge { .. })));
}

#[test]
fn a_structure_of_more_fields_than_a_cloud_has_is_refused() {
    let fields = |count: usize| {
        let more: String = (0..count).map(|i| format!(", ('f{i}', '|u1')")).collect();
        let kind = format!("[('x', '|u1'), ('y', '|u1'), ('z', '|u1'){more}]");
        array(&kind, false, "(1,)", &vec![7; 3 + count])
    };
    // Longer than the 64 KiB of version 1.
    assert_eq!(read(&fields(997)).expect("a cloud").attributes.len(), 997);
    let why = read(&fields(2000)).expect_err("too many").to_string();
    assert!(why.contains("2003 fields") && why.contains("1000"), "{why}");
}

#[test]
fn every_cut_is_an_error() {
    let bytes = structured();
    for end in 0..bytes.len() {
        assert!(read(&bytes[..end]).is_err(), "cut at {end}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn damage_never_panics(
        named in any::<bool>(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes =
            if named { structured() } else { array("'<f4'", true, "(5, 4)", &[7; 80]) };
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.positions.capacity() <= 8 * bytes.len());
        }
    }
}
