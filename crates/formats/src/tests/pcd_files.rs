//! PCD as the Point Cloud Library writes it.

use proptest::prelude::*;

use super::*;
use densecloud_cloud::Origin;

const HEADER: &str = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n\
    FIELDS x y z rgb label _ normal_x hist\nSIZE 4 4 4 4 4 1 4 4\nTYPE F F F F U U F F\nCOUNT 1 1 1 1 1 3 1 2\n\
    WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\n";

/// Two points; the second is a hole of a depth camera.
fn columns() -> Vec<Vec<u8>> {
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    vec![
        floats(&[1.5, f32::NAN]),
        floats(&[-2.0, f32::NAN]),
        floats(&[3.25, f32::NAN]),
        [0x00FF_8001_u32, 0x0000_0002].iter().flat_map(|v| v.to_le_bytes()).collect(),
        [7_u32, u32::MAX].iter().flat_map(|v| v.to_le_bytes()).collect(),
        vec![0; 6],
        floats(&[0.6, 0.8]),
        floats(&[1.0, 2.0, 3.0, 4.0]),
    ]
}

fn binary() -> Vec<u8> {
    let mut bytes = format!("{HEADER}DATA binary\n").into_bytes();
    for row in 0..2 {
        for column in columns() {
            let half = column.len() / 2;
            bytes.extend_from_slice(&column[row * half..(row + 1) * half]);
        }
    }
    bytes
}

fn compressed() -> Vec<u8> {
    let whole = columns().concat();
    // Literal runs of LZF: a length less one, then the bytes.
    let packed: Vec<u8> = whole.chunks(32).flat_map(|run| [&[run.len() as u8 - 1], run].concat()).collect();
    let mut bytes = format!("{HEADER}DATA binary_compressed\n").into_bytes();
    bytes.extend_from_slice(&(packed.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&(whole.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&packed);
    bytes
}

fn ascii() -> Vec<u8> {
    let colour = f32::from_bits(0x00FF_8001);
    format!(
        "{HEADER}DATA ascii\n1.5 -2 3.25 {colour:e} 7 0 0 0 0.6 1 2\nnan nan nan 2 4294967295 0 0 0 0.8 3 4\n"
    )
    .into_bytes()
}

#[test]
fn every_encoding_reads_the_same() {
    for (encoding, bytes) in [
        (PcdEncoding::Ascii, ascii()),
        (PcdEncoding::Binary, binary()),
        (PcdEncoding::Compressed, compressed()),
    ] {
        let reader = CloudReader::open(Drip(&bytes), Limits::default()).expect("a header");
        let header = reader.header().clone();
        assert_eq!((header.format, header.points), (Format::Pcd { encoding, scalar: Scalar::F32 }, Some(2)));
        assert_eq!(header.attributes, ["rgb", "label", "normal_x"]);
        let cloud = reader.read().expect("a cloud");
        assert_eq!(cloud.positions[0], [1.5, -2.0, 3.25]);
        assert!(cloud.positions[1].iter().all(|c| c.is_nan()));
        assert_eq!(cloud.dropped_properties, ["hist"]);
        let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(names, ["red", "green", "blue", "label", "normal_x"]);
        assert_eq!(cloud.attributes[0].values, Values::U8(vec![0xFF, 0]));
        assert_eq!(cloud.attributes[1].values, Values::U8(vec![0x80, 0]));
        assert_eq!(cloud.attributes[2].values, Values::U8(vec![1, 2]));
        assert_eq!(cloud.attributes[3].values, Values::U32(vec![7, u32::MAX]));
        assert_eq!(cloud.attributes[4].values, Values::F32(vec![0.6, 0.8]));
    }
}

#[test]
fn headers_are_read_as_programs_write_them() {
    let whole = String::from_utf8_lossy(&ascii()).into_owned();
    let expected = read_content(whole.as_bytes()).expect("a cloud");
    let comment = format!("# made by a driver\n\n{whole}");
    let untitled = whole[whole.find("VERSION").expect("a version")..].to_owned();
    let lower: String = untitled
        .lines()
        .map(|line| match line.split_once(' ') {
            Some((key, rest)) if key.chars().all(|c| c.is_ascii_uppercase()) => {
                format!("{} {rest}\n", key.to_ascii_lowercase())
            }
            _ => format!("{line}\n"),
        })
        .collect();
    let others = [
        comment.replace('\n', "\r\n"),
        format!("\n#.PCD v.7\n{untitled}"),
        format!("# one\n# two\n{untitled}"),
        untitled["VERSION 0.7\n".len()..].to_owned(),
        lower,
        whole.replace("FIELDS x y z rgb", "FIELDS X Y Z RGB"),
        whole.replace("FIELDS x y z", "COLUMNS easting northing height").replace("DATA ascii", "DATA ASCII"),
    ];
    for text in [comment].into_iter().chain(others) {
        let mut cloud = read_content(text.as_bytes()).expect(&text);
        cloud.origin.comments.clear();
        assert_eq!(cloud.attributes, expected.attributes, "{text}");
        assert_eq!(cloud.positions[0], expected.positions[0], "{text}");
        assert!(matches!(
            CloudReader::open(text.as_bytes(), Limits::default()).expect("a header").header().format,
            Format::Pcd { .. }
        ));
    }
    // Lines that only look like it.
    assert!(matches!(
        CloudReader::open(&b"version x y z\n1 2 3 4\n"[..], Limits::default()).map(|r| r.header().format),
        Ok(Format::Xyz { .. })
    ));
}

#[test]
fn names_that_come_twice_are_made_different() {
    let text = "VERSION .7\nFIELDS x y z i i rgb red _ _ i\nSIZE 4 4 4 4 4 4 1 1 1 4\nTYPE F F F F F U U U U I\n\
                WIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3 4 5 65793 7 0 0 8\n";
    let cloud = read(text.as_bytes()).expect("a cloud");
    let values: Vec<(&str, f64)> =
        cloud.attributes.iter().map(|a| (a.name.as_str(), a.values.get(0))).collect();
    let expected =
        [("i", 4.0), ("i_", 5.0), ("red", 1.0), ("green", 1.0), ("blue", 1.0), ("red_", 7.0), ("i_2", 8.0)];
    assert_eq!(values, expected);
    let told: Vec<&str> =
        cloud.notes.iter().map(|note| note.split(" is the name").next().unwrap_or("")).collect();
    assert_eq!(told, ["`i`", "`red`", "`i`"]);
    let of = |word: &str| word.repeat(900);
    let many = format!(
        "VERSION .7\nFIELDS x y z{}\nSIZE 4 4 4{}\nTYPE F F F{}\nWIDTH 1\nPOINTS 1\nDATA binary\n",
        of(" i"),
        of(" 1"),
        of(" U")
    );
    let many = read(&[many.as_bytes(), &[0; 912]].concat()).expect("a cloud");
    assert_eq!((many.attributes.len(), many.notes.len()), (900, 20));
    let twice = text.replacen("x y z i i", "x x z i i", 1);
    assert!(read(twice.as_bytes()).expect_err("x twice").to_string().contains("no number `y`"));
    let twice = text.replacen("x y z i i", "x y z x i", 1);
    assert!(read(twice.as_bytes()).expect_err("x twice").to_string().contains("may all be the coordinate x"));
}

#[test]
fn what_is_wrong_is_told() {
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    for (file, told) in [
        (text(ascii()).replace("SIZE 4 4", "SIZE 4"), "same number of words"),
        (text(ascii()).replace("SIZE 4 4", "SIZE 4 3"), "1 numbers of 3 bytes"),
        (text(ascii()).replace("FIELDS x", "FIELDS w"), "no number `x`"),
        (text(ascii()).replace("DATA ascii", "DATA base64"), "`DATA base64` is not known"),
        (text(ascii()).replace("POINTS 2", "POINTS 3"), "counts 3 points, and 2 are there"),
        (text(ascii()).replace("POINTS 2", "POINTS 1"), "data go on"),
        (text(ascii()).replace(" 7 ", " seven "), "`seven` is not a number of the field `label`"),
        (HEADER.to_owned(), "no `DATA` line"),
    ] {
        let error = read(file.as_bytes()).expect_err("an error").to_string();
        assert!(error.contains(told), "{error}");
    }
    let short = binary();
    assert!(read(&short[..short.len() - 1]).expect_err("cut").to_string().contains("and 1 are there"));
    let claim = String::from_utf8_lossy(&binary()[..HEADER.len()]).replace("POINTS 2", "POINTS 99999999999");
    let claim = [claim.as_bytes(), b"DATA binary\n", &[0; 100]].concat();
    assert!(matches!(read(&claim), Err(FormatError::Truncated { .. })));
    let limits = Limits { max_points: Some(5), ..Limits::default() };
    assert!(matches!(CloudReader::open(&claim[..], limits), Err(FormatError::TooManyPoints { .. })));
    // A claim of 4 GB in a few bytes.
    let mut bomb = format!("{}DATA binary_compressed\n", HEADER.replace("POINTS 2", "POINTS 100000000"));
    bomb = bomb
        .replace("SIZE 4 4 4 4 4 1 4 4", "SIZE 4 4 4 4 4 4 4 4")
        .replace("COUNT 1 1 1 1 1 3 1 2", "COUNT 1 1 1 1 1 1 1 1");
    let bomb = [bomb.as_bytes(), &10_u32.to_le_bytes(), &3_200_000_000_u32.to_le_bytes(), &[0; 10]].concat();
    let error = read(&bomb).expect_err("a bomb").to_string();
    assert!(error.contains("more bytes than can be compressed"), "{error}");
}

const PCDS: [PcdEncoding; 3] = [PcdEncoding::Ascii, PcdEncoding::Binary, PcdEncoding::Compressed];

#[test]
fn a_line_has_as_many_numbers_as_there_are_fields() {
    let file = |row: &str| {
        format!(
            "# .PCD v0.7\nFIELDS x y z i\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 2\nDATA ascii\n{row}\n1 2 3 4\n"
        )
    };
    assert!(read(file("1 2 3 4 ").as_bytes()).is_ok());
    let why = read(file("1 2 3 4 5").as_bytes()).expect_err("one more").to_string();
    assert_eq!(why, "line 7: `5` stands behind the numbers of all fields");
}

#[test]
fn a_header_of_more_fields_than_a_cloud_has_is_refused() {
    let header = |count: usize| {
        let words = |word: &str| format!(" {word}").repeat(count);
        format!(
            "# .PCD v0.7\nFIELDS x y z{}\nSIZE 4 4 4{}\nTYPE F F F{}\nWIDTH 1\nDATA ascii\n1 2 3{}\n",
            words("a"),
            words("1"),
            words("U"),
            words("7")
        )
    };
    assert_eq!(read(header(997).as_bytes()).expect("a cloud").attributes.len(), 997);
    let why = read(header(100_000).as_bytes()).expect_err("too many").to_string();
    assert!(why.contains("100003 fields") && why.contains("1000"), "{why}");
}

fn whole(format: Format, cloud: &Cloud) -> Vec<u8> {
    encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

/// A cloud with an attribute of every type, and a header that tells something.
fn everything(alpha: bool) -> Cloud {
    let mut cloud = Cloud::from((0..300).map(|i| [f64::from(i), 0.5, -f64::from(i)]).collect::<Vec<_>>());
    let mut add = |name: &str, values| cloud.attributes.push(Attribute { name: name.into(), values });
    let bytes = |from: u8| Values::U8((0..300).map(|i| (i as u8).wrapping_mul(7) ^ from).collect());
    for (i, name) in ["red", "green", "blue", "alpha"].into_iter().take(if alpha { 4 } else { 3 }).enumerate()
    {
        add(name, bytes(i as u8));
    }
    add("k", Values::I8(vec![-1; 300]));
    add("b", bytes(9));
    add("c", Values::I16(vec![i16::MIN; 300]));
    add("d", Values::U16(vec![u16::MAX; 300]));
    add("e", Values::I32(vec![i32::MIN; 300]));
    add("f", Values::U32(vec![u32::MAX; 300]));
    add("g", Values::I64(vec![i64::MIN; 300]));
    add("h", Values::U64(vec![u64::MAX; 300]));
    add("i", Values::F32(vec![0.1; 300]));
    add("j", Values::F64(vec![0.1; 300]));
    cloud.origin = Origin {
        crs: "EPSG:25832".parse().ok(),
        comments: vec!["one # two".into(), "three".into()],
        sensor: Some([1.5, 0.0, -3.0]),
        orientation: Some([0.5, 0.5, 0.5, -0.5]),
        ..Origin::default()
    };
    cloud
}

#[test]
fn what_is_written_is_read() {
    for (alpha, encoding, scalar) in [false, true]
        .into_iter()
        .flat_map(|alpha| PCDS.map(|encoding| (alpha, encoding)))
        .flat_map(|(alpha, encoding)| [Scalar::F32, Scalar::F64].map(|scalar| (alpha, encoding, scalar)))
    {
        let cloud = everything(alpha);
        let format = Format::Pcd { encoding, scalar };
        let bytes = whole(format, &cloud);
        if let Some(length) = format.encoded_len(300, &cloud.attributes, &cloud.origin) {
            assert_eq!(length, bytes.len() as u64);
        }
        assert_eq!(
            CloudReader::open(&bytes[..], Limits::default()).expect("a header").header().format,
            format
        );
        assert_eq!(read_content(&bytes).expect("a cloud"), cloud, "{format:?}");
        if format.is_streamed() {
            let mut writer = CloudWriter::with(Vec::new(), format, 300, &cloud.attributes, &cloud.origin)
                .expect("a header");
            writer.write_rows(&cloud.positions[..130], &cloud.attributes, 0).expect("points");
            writer.write_rows(&cloud.positions[130..], &cloud.attributes, 130).expect("points");
            assert!(writer.finish().expect("all points") == bytes);
        } else {
            assert!(CloudWriter::new(Vec::new(), format, 300).is_err());
            assert!(bytes.len() < 300 * 30, "{} bytes", bytes.len());
        }
    }
}

#[test]
fn the_header_is_that_of_pcl() {
    let mut cloud = everything(false);
    cloud.attributes.truncate(3);
    for axis in ["nx", "ny", "nz"] {
        cloud.attributes.push(Attribute { name: axis.into(), values: Values::F64(vec![0.5; 300]) });
    }
    cloud.attributes.push(Attribute { name: "a b#".into(), values: Values::F32(vec![0.5; 300]) });
    let format = |encoding| Format::Pcd { encoding, scalar: Scalar::F32 };
    let expected = "# .PCD v0.7 - Point Cloud Data file format\n# crs: EPSG:25832\n# one # two\n# three\nVERSION 0.7\n\
        FIELDS x y z rgb normal_x normal_y normal_z a_b_\nSIZE 4 4 4 4 4 4 4 4\nTYPE F F F F F F F F\n\
        COUNT 1 1 1 1 1 1 1 1\nWIDTH 300\nHEIGHT 1\nVIEWPOINT 1.5 0 -3 0.5 0.5 0.5 -0.5\nPOINTS 300\nDATA binary\n";
    assert!(whole(format(PcdEncoding::Binary), &cloud).starts_with(expected.as_bytes()));
    let text = String::from_utf8(whole(format(PcdEncoding::Ascii), &cloud)).expect("text");
    assert!(text.contains("TYPE F F F U F F F F\n"), "{text}");
    let (_, rows) = text.split_once("DATA ascii\n").expect("rows");
    assert!(rows.starts_with("0.0 0.5 -0.0 258 0.5 0.5 0.5 0.5\n"), "{rows}");
    // No viewpoint of its own, no sensor.
    cloud.origin = Origin::default();
    let bytes = whole(format(PcdEncoding::Binary), &cloud);
    assert!(String::from_utf8_lossy(&bytes).contains("VIEWPOINT 0 0 0 1 0 0 0\n"));
    assert_eq!(read_content(&bytes).expect("a cloud").origin, Origin::default());
}

#[test]
fn coordinates_from_elsewhere_are_narrow_where_nothing_is_lost() {
    let wanted = Some(Format::Pcd { encoding: PcdEncoding::Binary, scalar: Scalar::F32 });
    for (input, largest, scalar) in [
        (ply(PlyEncoding::Ascii, Scalar::F64), 10.0, Scalar::F32),
        (Format::TEXT, 5e6, Scalar::F64),
        (Format::Pcd { encoding: PcdEncoding::Ascii, scalar: Scalar::F64 }, 10.0, Scalar::F64),
    ] {
        let format = Format::of_result(wanted, input, false).fine_enough([[0.0; 3], [largest; 3]], 0.01);
        assert!(matches!(format, Format::Pcd { scalar: made, .. } if made == scalar), "{input}: {format}");
    }
}
#[test]
fn what_cannot_be_compressed_is_written_plainly() {
    let mut state = 1_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        f64::from_bits(state >> 2)
    };
    let cloud = Cloud::from((0..100).map(|_| [random(), random(), random()]).collect::<Vec<_>>());
    let bytes = whole(Format::Pcd { encoding: PcdEncoding::Compressed, scalar: Scalar::F64 }, &cloud);
    assert!(String::from_utf8_lossy(&bytes[..300]).contains("DATA binary\n"));
    assert_eq!(read_content(&bytes).expect("a cloud"), cloud);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// The compressor is not ours.
    #[test]
    fn compressed_columns_come_back(
        runs in prop::collection::vec((any::<u8>(), 1_usize..300, 0_u8..4), 1..40),
    ) {
        let run = |(byte, count, step): (u8, usize, u8)| {
            (0..count).map(move |i| byte.wrapping_add((i as u8).wrapping_mul(step)))
        };
        let column: Vec<u8> = runs.into_iter().flat_map(run).collect();
        let mut cloud = Cloud::from(vec![[1.0, 2.0, 3.0]; column.len()]);
        cloud.attributes.push(Attribute { name: "a".into(), values: Values::U8(column) });
        let format = Format::Pcd { encoding: PcdEncoding::Compressed, scalar: Scalar::F32 };
        prop_assert_eq!(read_content(&whole(format, &cloud)).expect("a cloud"), cloud);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn damage_never_panics(
        kind in 0_usize..3,
        damage in prop::collection::vec((0_usize..500, any::<u8>()), 1..6),
        cut in prop_oneof![Just(usize::MAX), 0_usize..500],
    ) {
        let mut bytes = [ascii(), binary(), compressed()][kind].clone();
        bytes.truncate(cut);
        for (place, value) in damage {
            if let Some(byte) = bytes.get_mut(place) {
                *byte = value;
            }
        }
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.attributes.iter().all(|a| a.values.len() == cloud.positions.len()));
        }
    }
}
