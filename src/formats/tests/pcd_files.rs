//! PCD as the Point Cloud Library writes it.

use proptest::prelude::*;

use super::*;

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
        assert_eq!((header.format, header.points), (Format::Pcd { encoding }, Some(2)));
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
