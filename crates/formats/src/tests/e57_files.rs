//! E57, written by us and by the `e57` crate.

use std::io::Cursor;
use std::sync::Arc;

use ::e57::{
    E57Writer, Extension, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform, Translation,
};
use proptest::prelude::*;

use super::*;
use densecloud_cloud::{Crs, Origin, Sensors};

fn column(name: &str, values: Values) -> Attribute {
    Attribute { name: name.into(), values }
}

fn find<'a>(cloud: &'a Cloud, name: &str) -> &'a Values {
    &cloud.attributes.iter().find(|a| a.name == name).unwrap_or_else(|| panic!("no {name}")).values
}

fn made(cloud: &Cloud) -> Vec<u8> {
    encode(Vec::new(), Format::E57, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

/// Everything that an attribute can be.
fn rich(count: u16) -> Cloud {
    let all = || 0..count;
    let floats = |scale: f32| Values::F32(all().map(|i| f32::from(i) * scale).collect());
    let attributes = vec![
        column("red", Values::U16(all().collect())),
        column("green", Values::U16(all().map(|i| 2 * i).collect())),
        column("blue", Values::U16(all().map(|i| 65_535 - i).collect())),
        column("intensity", floats(0.25)),
        column("return_number", Values::U8(all().map(|i| 1 + (i % 255) as u8).collect())),
        column("number_of_returns", Values::U8(all().map(|i| i as u8).collect())),
        column("row_index", Values::U32(all().map(u32::from).collect())),
        column("timestamp", Values::F64(all().map(|i| 0.1 * f64::from(i)).collect())),
        column("color_invalid", Values::U8(all().map(|i| (1 - i % 2) as u8).collect())),
        column("nx", floats(0.001)),
        column("ny", floats(0.002)),
        column("nz", floats(0.003)),
        column("timeStamp", Values::I8(all().map(|i| i as i8).collect())),
        column("scan angle", Values::I16(all().map(|i| i as i16 - 90).collect())),
        column("gps_time", Values::F64(all().map(|i| 1e9 + f64::from(i)).collect())),
        column("id", Values::I64(all().map(|i| i64::MIN / 2 - i64::from(i)).collect())),
        column("key", Values::U64(all().map(u64::from).collect())),
        column("", Values::I32(all().map(i32::from).collect())),
    ];
    let positions = all().map(|i| [5e5 + f64::from(i) / 3.0, -0.1, f64::from(i)]).collect();
    let crs = Some(Crs::Wkt("PROJCS[\"a ]]> b\"]".replace("]]>", "]] >")));
    let comments = vec!["made by hand".into(), "a < b & \"c\"".into()];
    Cloud { positions, attributes, origin: Origin { crs, comments, ..Origin::default() }, ..Cloud::default() }
}

#[test]
fn what_is_written_reads_back_in_its_types() {
    for count in [1, 5000] {
        let cloud = rich(count);
        assert!(Format::E57.cannot_hold(&cloud.attributes, &cloud.origin).is_empty());
        let bytes = made(&cloud);
        assert_eq!(
            CloudReader::open(&bytes[..], Limits::default()).expect("a header").header().format,
            Format::E57
        );
        let mut back = read_content(&bytes).expect("a cloud");
        let last = back.attributes.last_mut().expect("the last");
        assert_eq!(std::mem::take(&mut last.name), format!("column {}", 3 + cloud.attributes.len()));
        for (a, b) in back.attributes.iter().zip(&cloud.attributes) {
            assert!(a == b, "{} {:?} {:?}", b.name, a.name, a.values.kind());
        }
        assert!(back == cloud);
        assert!(made(&cloud) == bytes, "the same cloud, the same bytes");
    }
}

#[test]
fn what_does_not_fit_the_formats_own_columns_is_kept_beside_them() {
    let attributes = vec![
        column("red", Values::U8(vec![1, 2])),
        column("return_number", Values::U8(vec![0, 1])),
        column("number_of_returns", Values::U8(vec![1, 1])),
        column("row_index", Values::F32(vec![0.5, f32::NAN])),
        column("color_invalid", Values::U8(vec![0, 1])),
    ];
    let mut cloud = Cloud { positions: vec![[0.0; 3], [1.0; 3]], attributes, ..Cloud::default() };
    let back = read_content(&made(&cloud)).expect("a cloud");
    assert_eq!(back.attributes[..3], cloud.attributes[..3]);
    assert!(find(&back, "row_index").get(1).is_nan());
    cloud.attributes =
        vec![column("wide", Values::U64(vec![0, u64::MAX])), column("far", Values::I64(vec![i64::MIN, 1]))];
    assert_eq!(Format::E57.cannot_hold(&cloud.attributes, &cloud.origin), ["wide", "far"]);
    assert!(read_content(&made(&cloud)).expect("a cloud").attributes.is_empty());
}

#[test]
fn scans_are_one_cloud_and_scans_again() {
    let scan = column("scan", Values::U8(vec![1, 0, 1, 2]));
    let positions = vec![[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3]];
    let cloud = Cloud { positions, attributes: vec![scan], ..Cloud::default() };
    let bytes = made(&cloud);
    let scans = ::e57::E57Reader::new(Cursor::new(&bytes)).expect("a file").pointclouds();
    assert_eq!(scans.iter().map(|scan| scan.records).collect::<Vec<_>>(), [1, 2, 1]);
    let back = read_content(&bytes).expect("a cloud");
    assert_eq!(back.positions, [[1.0; 3], [0.0; 3], [2.0; 3], [3.0; 3]]);
    assert_eq!(back.attributes, [column("scan", Values::U8(vec![0, 1, 1, 2]))]);
    for values in
        [Values::U8(vec![0; 4]), Values::I32(vec![0, 2, 2, 2]), Values::F32(vec![0.0, 1.0, 0.0, 1.0])]
    {
        let cloud = Cloud { attributes: vec![column("scan", values)], ..cloud.clone() };
        assert_eq!(read_content(&made(&cloud)).expect("a cloud"), cloud, "one scan with an attribute");
    }
}

#[test]
fn a_single_scan_keeps_where_its_sensor_stood() {
    let mut cloud = rich(10);
    cloud.origin.sensor = Some([500_000.0, -2.0, 1.5]);
    let back = read_content(&made(&cloud)).expect("a cloud");
    assert_eq!(back.origin.sensor, cloud.origin.sensor);
    for (a, b) in back.positions.as_flattened().iter().zip(cloud.positions.as_flattened()) {
        assert!((a - b).abs() < 1e-9);
    }
}

#[test]
fn each_of_several_scans_keeps_where_its_sensor_stood() {
    let mut cloud = rich(10);
    let scan = Values::U8((0..10).map(|i| u8::from(i > 3)).collect());
    cloud.attributes.retain(|a| a.name != "scan");
    cloud.attributes.push(Attribute { name: "scan".into(), values: scan });
    let places = vec![Some([500_000.0, -2.0, 1.5]), None];
    cloud.origin.sensors = Some(Arc::new(Sensors { attribute: "scan".into(), places }));
    let back = read_content(&made(&cloud)).expect("a cloud");
    assert_eq!((&back.origin.sensors, back.origin.sensor), (&cloud.origin.sensors, None));
    for (a, b) in back.positions.as_flattened().iter().zip(cloud.positions.as_flattened()) {
        assert!((a - b).abs() < 1e-9);
    }
}

const TURN: Transform = Transform {
    // A quarter about z.
    rotation: Quaternion {
        w: std::f64::consts::FRAC_1_SQRT_2,
        x: 0.0,
        y: 0.0,
        z: std::f64::consts::FRAC_1_SQRT_2,
    },
    translation: Translation { x: 100.0, y: 200.0, z: 300.0 },
};

fn record(name: RecordName, data_type: RecordDataType) -> Record {
    Record { name, data_type }
}

/// Two scans: one in scaled integers with a pose, normals and an invalid point, one spherical with an
/// intensity, a constant, and another program's column.
fn two_scans() -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut file, "guid").expect("a writer");
    writer.register_extension(Extension::new("nor", "url")).expect("an extension");
    writer.register_extension(Extension::new("other", "url2")).expect("an extension");
    writer.set_coordinate_metadata(Some("EPSG:2992".into()));
    let millimetre = RecordDataType::ScaledInteger { min: -100_000, max: 100_000, scale: 0.001, offset: 1.0 };
    let nor = |name: &str| RecordName::Unknown { namespace: "nor".into(), name: name.into() };
    let prototype = vec![
        record(nor("normalX"), RecordDataType::F32),
        record(nor("normalY"), RecordDataType::F32),
        record(nor("normalZ"), RecordDataType::F32),
        record(RecordName::CartesianX, millimetre.clone()),
        record(RecordName::CartesianY, millimetre.clone()),
        record(RecordName::CartesianZ, millimetre),
        record(RecordName::CartesianInvalidState, RecordDataType::Integer { min: 0, max: 2 }),
    ];
    let mut scan = writer.add_pointcloud("a", prototype).expect("a scan");
    scan.set_transform(Some(TURN));
    scan.set_description(Some("scanned by A\nat noon".into()));
    for (x, state) in [(0, 0), (1000, 2), (2000, 0)] {
        let mut point = [1.0, 0.0, 0.0].map(RecordValue::Single).to_vec();
        point.extend([x, -1000, -1000].map(RecordValue::ScaledInteger));
        point.push(RecordValue::Integer(state));
        scan.add_point(point).expect("a point");
    }
    scan.finalize().expect("a scan");
    let prototype = vec![
        record(RecordName::SphericalRange, RecordDataType::F64),
        record(RecordName::SphericalAzimuth, RecordDataType::F64),
        record(RecordName::SphericalElevation, RecordDataType::F64),
        record(RecordName::Intensity, RecordDataType::Integer { min: 0, max: 2047 }),
        record(RecordName::RowIndex, RecordDataType::Integer { min: 7, max: 7 }),
        record(
            RecordName::Unknown { namespace: "other".into(), name: "echo-width".into() },
            RecordDataType::Integer { min: -5, max: 5 },
        ),
    ];
    let mut scan = writer.add_pointcloud("b", prototype).expect("a scan");
    scan.set_description(Some("scanned by A".into()));
    for i in 0..2 {
        let mut point =
            [2.0, 0.0, std::f64::consts::FRAC_PI_2 * f64::from(i)].map(RecordValue::Double).to_vec();
        point.extend([2000 + i64::from(i), 7, -4].map(RecordValue::Integer));
        scan.add_point(point).expect("a point");
    }
    scan.finalize().expect("a scan");
    writer.finalize().expect("a file");
    drop(writer);
    file.into_inner()
}

#[test]
fn scans_are_read_where_they_stand_with_what_any_of_them_tells() {
    let cloud = read(&two_scans()).expect("a cloud");
    let expected = [[100.0, 201.0, 300.0], [100.0, 203.0, 300.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0]];
    assert_eq!(cloud.positions.len(), 4);
    for (a, b) in cloud.positions.as_flattened().iter().zip(expected.as_flattened()) {
        assert!((a - b).abs() < 1e-12, "{a} {b}");
    }
    let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    let flags = ["intensity_invalid", "row_index_invalid", "echo-width_invalid"];
    assert_eq!(names[..6], ["nx", "ny", "nz", "intensity", "row_index", "echo-width"]);
    assert_eq!((&names[6..9], names[9]), (&flags[..], "scan"));
    for flag in flags {
        assert_eq!(find(&cloud, flag), &Values::U8(vec![1, 1, 0, 0]), "{flag}");
    }
    let ny = find(&cloud, "ny");
    assert!((ny.get(0) - 1.0).abs() < 1e-6 && (ny.get(1) - 1.0).abs() < 1e-6 && ny.get(2).is_nan());
    assert!(find(&cloud, "nx").get(1).abs() < 1e-6);
    assert_eq!(find(&cloud, "intensity"), &Values::U16(vec![0, 0, 2000, 2001]));
    assert_eq!(find(&cloud, "row_index"), &Values::U8(vec![0, 0, 7, 7]));
    assert_eq!(find(&cloud, "echo-width"), &Values::I8(vec![0, 0, -4, -4]));
    assert_eq!(find(&cloud, "scan"), &Values::U8(vec![0, 0, 1, 1]));
    assert_eq!(cloud.origin.crs, Some(Crs::Epsg { horizontal: 2992, vertical: None }));
    assert_eq!(cloud.origin.sensor, None);
    assert_eq!(cloud.origin.comments[..2], ["scanned by A", "at noon"]);
    assert!(cloud.origin.comments.contains(&"nx: told by 1 of 2 scans, nan in the others".to_owned()));
    assert_eq!(cloud.dropped_properties, ["1 points that the file calls invalid"]);
}

/// Two scans of two points: one with colours, of which the second is flagged, and one without any.
fn half_coloured() -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut file, "guid").expect("a writer");
    let axes = || {
        [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ]
            .map(|name| record(name, RecordDataType::F64))
    };
    let byte = RecordDataType::Integer { min: 0, max: 255 };
    let mut prototype = axes().to_vec();
    prototype.extend([
        record(RecordName::ColorRed, byte.clone()),
        record(RecordName::ColorGreen, byte.clone()),
        record(RecordName::ColorBlue, byte),
        record(RecordName::IsColorInvalid, RecordDataType::Integer { min: 0, max: 1 }),
        record(RecordName::Intensity, RecordDataType::F32),
    ]);
    let mut scan = writer.add_pointcloud("a", prototype).expect("a scan");
    for (x, colour, flag) in [(1.0, 200, 0), (2.0, 0, 1)] {
        let mut point = [x, 0.0, 0.0].map(RecordValue::Double).to_vec();
        point.extend([colour, colour, colour, flag].map(RecordValue::Integer));
        point.push(RecordValue::Single(0.5));
        scan.add_point(point).expect("a point");
    }
    scan.finalize().expect("a scan");
    let mut scan = writer.add_pointcloud("b", axes().to_vec()).expect("a scan");
    for x in [3.0, 4.0] {
        scan.add_point([x, 0.0, 0.0].map(RecordValue::Double).to_vec()).expect("a point");
    }
    scan.finalize().expect("a scan");
    writer.finalize().expect("a file");
    drop(writer);
    file.into_inner()
}

#[test]
fn what_a_scan_does_not_have_is_absent_and_not_zero() {
    let cloud = read(&half_coloured()).expect("a cloud");
    for colour in ["red", "green", "blue"] {
        assert_eq!(find(&cloud, colour), &Values::U8(vec![200, 0, 0, 0]));
    }
    assert_eq!(find(&cloud, "color_invalid"), &Values::U8(vec![0, 1, 1, 1]));
    assert_eq!(find(&cloud, "intensity_invalid"), &Values::U8(vec![0, 0, 1, 1]));
    let intensity = find(&cloud, "intensity");
    assert!(intensity.get(1) == 0.5 && intensity.get(2).is_nan());
    let told = "red: told by 1 of 2 scans, color_invalid is 1 in the others".to_owned();
    assert!(
        cloud.origin.comments.contains(&told) && !cloud.origin.comments.concat().contains("color_invalid:")
    );
    // E57 has the same flags in columns of its own.
    let again = made(&cloud);
    let scans = ::e57::E57Reader::new(Cursor::new(&again)).expect("a file").pointclouds();
    let has = |name: RecordName| scans.iter().all(|scan| scan.prototype.iter().any(|r| r.name == name));
    assert!(has(RecordName::IsColorInvalid) && has(RecordName::IsIntensityInvalid));
    let back = read(&again).expect("a cloud");
    assert_eq!(find(&back, "color_invalid"), find(&cloud, "color_invalid"));
}

/// The checksum that ends each page, bit by bit.
fn checksum(bytes: &[u8]) -> [u8; 4] {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(
            crc ^ u32::from(*byte),
            |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0x82F6_3B78 } else { crc >> 1 },
        )
    };
    (!bytes.iter().fold(u32::MAX, step)).to_be_bytes()
}

/// Makes the checksums right again.
fn seal(bytes: &mut [u8]) {
    for page in bytes.chunks_exact_mut(1024) {
        let sum = checksum(&page[..1020]);
        page[1020..].copy_from_slice(&sum);
    }
}

/// Replaces text in the description by other text of the same length.
fn with(bytes: &[u8], old: &str, new: &str) -> Vec<u8> {
    assert_eq!(old.len(), new.len());
    let at = bytes.windows(old.len()).position(|w| w == old.as_bytes()).expect(old);
    let mut bytes = bytes.to_vec();
    bytes[at..at + new.len()].copy_from_slice(new.as_bytes());
    seal(&mut bytes);
    bytes
}

#[test]
fn what_the_description_claims_is_checked_before_it_is_believed() {
    let bytes = two_scans();
    assert!(read(&with(&bytes, "recordCount=\"3\"", "recordCount=\"4\"")).is_err());
    for (old, new, why) in [
        ("offset=\"1\"", "offset=\"x\"", "offset"),
        ("fileOffset=\"48\"", "fileOffset=\"99\"", "not a readable"),
    ] {
        let error = read(&with(&bytes, old, new)).expect_err(why).to_string();
        assert!(error.contains(why), "{error}");
    }
    let mut long = bytes.clone();
    long[32..40].copy_from_slice(&u64::MAX.to_le_bytes());
    seal(&mut long);
    assert!(matches!(read(&long), Err(FormatError::Truncated { .. })));
    let limits = Limits { max_points: Some(4), ..Limits::default() };
    let error = CloudReader::open(&bytes[..], limits).expect("a header").read().expect_err("too many");
    assert!(matches!(error, FormatError::TooManyPoints { points: 5, limit: 4 }));
    let damaged = [&bytes[..100], &[bytes[100] ^ 1], &bytes[101..]].concat();
    assert!(read(&damaged).expect_err("damaged").to_string().contains("checksum"));
}

/// A file of one page of data and this description.
fn described(description: &str) -> Vec<u8> {
    let mut logical = vec![0; 1020];
    logical.extend(description.as_bytes());
    logical.resize(logical.len().next_multiple_of(1020), 0);
    logical[..8].copy_from_slice(b"ASTM-E57");
    for (at, number) in [(8, 1), (16, 0), (24, 1024), (32, description.len() as u64), (40, 1024)] {
        logical[at..at + 8].copy_from_slice(&u64::to_le_bytes(number));
    }
    let mut bytes: Vec<u8> = logical.chunks_exact(1020).flat_map(|page| [page, &[0; 4]].concat()).collect();
    let length = bytes.len() as u64;
    bytes[16..24].copy_from_slice(&length.to_le_bytes());
    seal(&mut bytes);
    bytes
}

#[test]
fn descriptions_that_mean_harm_are_refused() {
    let scan = |count: &str, columns: &str| {
        described(&format!(
            "<e57Root><formatName type=\"String\"/><guid type=\"String\"/><versionMajor type=\"Integer\">1</versionMajor>\
             <data3D type=\"Vector\"><vectorChild type=\"Structure\"><points type=\"CompressedVector\" fileOffset=\"48\" \
             recordCount=\"{count}\"><prototype type=\"Structure\">{columns}</prototype></points></vectorChild></data3D>\
             </e57Root>"
        ))
    };
    let axes = |kind: &str| ["X", "Y", "Z"].map(|axis| format!("<cartesian{axis} {kind}/>")).concat();
    for (bytes, why) in [
        (scan("1000000000000", &axes("type=\"Float\"")), "more than the file has room for"),
        (scan("18446744073709551615", &axes("type=\"Float\"")), "more than the file has room for"),
        (scan("1", &axes("type=\"Integer\" minimum=\"3\" maximum=\"3\"")), "next to nothing"),
        (scan("1", "<intensity type=\"Float\"/>"), "no coordinates"),
        (scan("1", &(axes("type=\"Float\"") + &"<a type=\"Float\"/>".repeat(2000))), "next to nothing"),
        (scan("1", &axes("type=\"Float\"")), "not a readable"),
        (described(&"<a>".repeat(100_000)), "not a readable"),
        (described("<!DOCTYPE a [<!ENTITY b \"b\">]><a>&b;</a>"), "not a readable"),
    ] {
        let error = read(&bytes).expect_err(why).to_string();
        assert!(error.contains(why), "{error}");
    }
    assert!(matches!(
        read(&scan("0", &axes("type=\"Float\""))),
        Err(FormatError::Empty(_)) | Err(FormatError::Malformed { .. })
    ));
}

#[test]
fn columns_that_run_far_ahead_of_others_are_refused() {
    let flag = RecordDataType::Integer { min: 0, max: 1 };
    let prototype = vec![
        record(RecordName::CartesianX, RecordDataType::F64),
        record(RecordName::CartesianY, RecordDataType::F64),
        record(RecordName::CartesianZ, RecordDataType::F64),
        record(RecordName::IsTimeStampInvalid, flag.clone()),
        record(RecordName::TimeStamp, flag),
    ];
    let mut file = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut file, "guid").expect("a writer");
    let mut scan = writer.add_pointcloud("a", prototype).expect("a scan");
    for _ in 0..100_000 {
        let mut point = [1.0, 0.0, 0.0].map(RecordValue::Double).to_vec();
        point.extend([1, 1].map(RecordValue::Integer));
        scan.add_point(point).expect("a point");
    }
    scan.finalize().expect("a scan");
    writer.finalize().expect("a file");
    drop(writer);
    let bytes = file.into_inner();
    assert!(read(&bytes).is_ok());
    // All numbers of a packet are of the first flag alone, from the second packet on.
    let mut logical: Vec<u8> = bytes.chunks_exact(1024).flat_map(|page| page[..1020].to_vec()).collect();
    let mut at = 80;
    while logical[at] == 1 {
        let size =
            |i: usize| usize::from(u16::from_le_bytes([logical[at + 6 + 2 * i], logical[at + 7 + 2 * i]]));
        let all: usize = (0..5).map(size).sum();
        if at > 80 {
            logical[at + 6..at + 16].fill(0);
            logical[at + 12..at + 14].copy_from_slice(&(all as u16).to_le_bytes());
        }
        at = (at + 16 + all).next_multiple_of(4);
    }
    let mut bytes: Vec<u8> = logical.chunks_exact(1020).flat_map(|page| [page, &[0; 4]].concat()).collect();
    seal(&mut bytes);
    let error = read(&bytes).expect_err("far ahead").to_string();
    assert!(error.contains("different lengths"), "{error}");
}

#[test]
fn every_cut_is_an_error() {
    let bytes = two_scans();
    for end in (8..100).chain((100..bytes.len()).step_by(97)).chain([bytes.len() - 1]) {
        assert!(read(&bytes[..end]).is_err(), "cut at {end}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn damage_never_panics(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        rich_file in any::<bool>(),
    ) {
        let mut bytes = if rich_file { made(&rich(20)) } else { two_scans() };
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        seal(&mut bytes);
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.positions.len() <= 8 * bytes.len());
        }
    }
}
