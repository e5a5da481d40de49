//! LAS and LAZ, written by the `las` crate.

use std::io::Cursor;

use ::las::point::{Classification, ScanDirection};
use ::las::{Builder, Color, Point, Transform, Vector, Vlr, Writer};
use proptest::prelude::*;

use super::super::las::{LasOrigin, LasRecord};
use super::*;
use densecloud_cloud::{Crs, Extra, Origin};

const LAS: Format = Format::Las { compressed: false };
const LAZ: Format = Format::Las { compressed: true };

/// Far from the origin, to the millimetre.
fn points(count: u16) -> Vec<Point> {
    (0..count)
        .map(|i| Point {
            x: 635_000.0 + f64::from(i) / 1000.0,
            y: 4_848_000.0 - f64::from(i) / 8.0,
            z: f64::from(i % 7),
            intensity: 100 + i,
            return_number: 2,
            number_of_returns: 3,
            classification: if i % 2 == 0 { Classification::Ground } else { Classification::Building },
            scan_direction: ScanDirection::LeftToRight,
            scan_angle: -18.0,
            user_data: 9,
            point_source_id: 7000 + i,
            is_withheld: i == 3,
            ..Point::default()
        })
        .collect()
}

fn file(format: u8, compressed: bool, count: u16, extra: bool) -> Vec<u8> {
    let mut builder = Builder::from((1, if format < 6 { 2 } else { 4 }));
    builder.point_format = ::las::point::Format::new(format).expect("a format");
    builder.point_format.is_compressed = compressed;
    let millimetre = |offset| Transform { scale: 0.001, offset };
    builder.transforms = Vector { x: millimetre(635_000.0), y: millimetre(4_848_000.0), z: millimetre(0.0) };
    if extra {
        // A scaled 16-bit integer, then an array of two bytes, then one byte that nothing describes.
        builder.point_format.extra_bytes = 5;
        let mut scaled = vec![0_u8; 192];
        (scaled[2], scaled[3]) = (3, 8 | 16);
        scaled[4..9].copy_from_slice(b"range");
        scaled[112..120].copy_from_slice(&0.5_f64.to_le_bytes());
        scaled[136..144].copy_from_slice(&10.0_f64.to_le_bytes());
        let mut array = vec![0_u8; 192];
        array[2] = 11;
        array[4..8].copy_from_slice(b"pair");
        let data = [scaled, array].concat();
        let user_id = "LASF_Spec".to_owned();
        builder.vlrs.push(Vlr { user_id, record_id: 4, description: String::new(), data });
        let user_id = "LASF_Projection".to_owned();
        builder.vlrs.push(Vlr {
            user_id,
            record_id: 2112,
            description: String::new(),
            data: b"PROJCS[\"x\"]\0".to_vec(),
        });
    }
    let header = builder.into_header().expect("a header");
    let format = *header.point_format();
    let mut writer = Writer::new(Cursor::new(Vec::new()), header).expect("a writer");
    for (i, mut point) in (0_u16..).zip(points(count)) {
        point.gps_time = format.has_gps_time.then_some(1e9 + f64::from(i));
        point.color = format.has_color.then(|| Color::new(i, 2 * i, 65_535 - i));
        point.nir = format.has_nir.then_some(5 * i);
        if extra {
            let [a, b] = i.to_le_bytes();
            point.extra_bytes = vec![a, b, 1, 2, 3];
        }
        writer.write_point(point).expect("a point");
    }
    writer.close().expect("a file");
    writer.into_inner().expect("a file").into_inner()
}

fn column<'a>(cloud: &'a Cloud, name: &str) -> &'a Values {
    &cloud.attributes.iter().find(|a| a.name == name).unwrap_or_else(|| panic!("no {name}")).values
}

#[test]
fn every_point_format_is_read_compressed_or_not() {
    for (format, compressed) in
        [0, 1, 2, 3, 6, 7, 8].into_iter().flat_map(|format| [(format, false), (format, true)])
    {
        let bytes = file(format, compressed, 500, false);
        let reader = CloudReader::open(&bytes[..], Limits::default()).expect("a header");
        assert_eq!((reader.header().format, reader.header().points), (Format::Las { compressed }, Some(500)));
        let cloud = reader.read().expect("a cloud");
        for (p, wanted) in cloud.positions.iter().zip(points(500)) {
            for (a, b) in p.iter().zip([wanted.x, wanted.y, wanted.z]) {
                assert!((a - b).abs() < 1e-8, "{a} and {b} in format {format}");
            }
        }
        assert_eq!(column(&cloud, "intensity"), &Values::U16((100..600).collect()));
        assert_eq!(column(&cloud, "point_source_id"), &Values::U16((7000..7500).collect()));
        assert_eq!(column(&cloud, "classification").get(0), 2.0);
        assert_eq!(column(&cloud, "classification").get(1), 6.0);
        assert_eq!(column(&cloud, "withheld").get(3), 1.0);
        assert!((column(&cloud, "scan_angle").get(9) + 18.0).abs() < 0.01);
        let has = |name: &str| cloud.attributes.iter().any(|a| a.name == name);
        assert!(!has("synthetic"), "a flag that is never set");
        assert_eq!(has("gps_time"), !matches!(format, 0 | 2));
        assert_eq!(has("nir"), format == 8);
        assert_eq!(has("red"), matches!(format, 2 | 3 | 7 | 8));
        if has("red") {
            assert_eq!(column(&cloud, "blue"), &Values::U16((0..500).map(|i| 65_535 - i).collect()));
        }
        assert!(cloud.dropped_properties.is_empty(), "{:?}", cloud.dropped_properties);
    }
}

#[test]
fn extra_bytes_are_read_and_what_is_not_kept_is_named() {
    for (format, compressed) in [(1, false), (1, true), (6, false), (6, true)] {
        let cloud = read(&file(format, compressed, 300, true)).expect("a cloud");
        let range = Values::F64((0..300).map(|i| f64::from(i) * 0.5 + 10.0).collect());
        assert_eq!(column(&cloud, "range"), &range);
        assert_eq!(cloud.dropped_properties, ["pair", "1 bytes a point without a description"]);
        assert_eq!(cloud.origin.crs, Some(Crs::Wkt("PROJCS[\"x\"]".into())));
    }
}

#[test]
fn las_is_refused_where_it_cannot_be_read_or_written() {
    let error = CloudWriter::new(Vec::new(), LAS, 1).expect_err("nothing seen").to_string();
    assert!(error.contains("depends on all points"), "{error}");
    let write = |positions: &[Position]| encode(Vec::new(), LAS, positions, &[], &Origin::default());
    for bad in [f64::NAN, f64::INFINITY] {
        let error = write(&[[0.0; 3], [0.0, bad, 0.0]]).expect_err("no coordinate").to_string();
        assert!(error.contains("no coordinate"), "{error}");
    }
    let error = write(&[[f64::MIN, 0.0, 0.0], [f64::MAX, 0.0, 0.0]]).expect_err("too large").to_string();
    assert!(error.contains("too large"), "{error}");
    let wide = Attribute { name: "wide".into(), values: Values::F64(vec![1.0]) };
    let error = encode(Vec::new(), LAS, &[[0.0; 3]], &vec![wide; 9000], &Origin::default());
    assert!(error.expect_err("too many").to_string().contains("72000 bytes"));
    let bytes = file(1, false, 100, false);
    let limits = Limits { max_points: Some(99), ..Limits::default() };
    let error = CloudReader::open(&bytes[..], limits).err().expect("too many");
    assert!(matches!(error, FormatError::TooManyPoints { points: 100, limit: 99 }));
    let error = read(&bytes[..bytes.len() - 1]).expect_err("cut off").to_string();
    assert!(error.contains("counts more than is there"), "{error}");
    assert!(read(&bytes[..100]).expect_err("cut off").to_string().contains("incomplete"));
}

/// A cloud, written and read again; and the bytes between.
fn again(cloud: &Cloud, format: Format) -> (Cloud, Vec<u8>) {
    let bytes =
        encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file");
    (read_content(&bytes).expect("a cloud"), bytes)
}

fn las(cloud: &Cloud) -> &LasOrigin {
    LasOrigin::of(&cloud.origin).expect("from LAS")
}

/// The first three numbers of each point, as they are stored.
fn steps(bytes: Vec<u8>) -> Vec<[i32; 3]> {
    let mut reader = ::las::Reader::new(Cursor::new(bytes)).expect("a file");
    let points = reader.read_all().expect("points");
    points.x_raw().zip(points.y_raw()).zip(points.z_raw()).map(|((x, y), z)| [x, y, z]).collect()
}

#[test]
fn las_comes_back_as_it_was() {
    for format in [0, 1, 2, 3, 6, 7, 8] {
        for (from, to) in [(false, LAS), (true, LAS), (false, LAZ), (true, LAZ)] {
            let bytes = file(format, from, 500, false);
            let mut cloud = read_content(&bytes).expect("a cloud");
            cloud.origin.comments = vec!["made of a".into(), "made of b".into()];
            let (back, written) = again(&cloud, to);
            assert_eq!(back, cloud, "format {format}, {from} to {to:?}");
            assert_eq!(steps(written.clone()), steps(bytes));
            let header = ::las::Reader::new(Cursor::new(written)).expect("a file").header().clone();
            assert_eq!(header.number_of_points_by_return(2), Some(500));
            assert_eq!(header.generating_software(), concat!("densecloud ", env!("CARGO_PKG_VERSION")));
            assert_eq!(header.date(), None, "the output tells no date of its own");
            assert_eq!(header.version().minor, if format < 6 { 2 } else { 4 });
        }
    }
}

#[test]
fn the_header_and_the_records_are_kept() {
    for format in [3, 7] {
        let mut bytes = file(format, false, 100, true);
        let cloud = {
            // A flight line, standard time, a project, a system, a day.
            bytes[4..8].copy_from_slice(&[7, 0, if format == 7 { 17 } else { 1 }, 0]);
            bytes[8..24].copy_from_slice(&[9; 16]);
            bytes[26..32].copy_from_slice(b"Sensor");
            bytes[90..94].copy_from_slice(&[100, 0, 0xE0, 0x07]);
            read_content(&bytes).expect("a cloud")
        };
        let (back, written) = again(&cloud, LAZ);
        assert_eq!(written[4..8], bytes[4..8]);
        assert_eq!(written[8..24], [9; 16]);
        assert_eq!(&written[26..32], b"Sensor");
        assert_eq!(written[90..94], [100, 0, 0xE0, 0x07]);
        assert_eq!(back, Cloud { dropped_properties: Vec::new(), ..cloud.clone() });
        assert_eq!(las(&cloud).records.len(), 1);
        // The scaled integer is still one.
        let header = ::las::Reader::new(Cursor::new(written)).expect("a file").header().clone();
        assert_eq!(header.point_format().extra_bytes, 2);
        let entry = &header.vlrs().iter().find(|v| v.record_id == 4).expect("a record").data;
        assert_eq!((entry.len(), entry[2], entry[3]), (192, 3, 24));
        // Between two steps, and beyond the integers' range.
        for (number, kept) in [(10.3, 10.5), (10.2, 10.0), (1e9, 1e9), (-1.0, -1.0)] {
            let mut cloud = cloud.clone();
            let range = cloud.attributes.iter_mut().find(|a| a.name == "range").expect("the attribute");
            range.values = Values::F64(vec![number; 100]);
            assert_eq!(column(&again(&cloud, LAS).0, "range").get(0), kept);
        }
    }
}

#[test]
fn extended_records_and_a_long_system_are_kept() {
    let mut cloud = read_content(&file(6, false, 50, false)).expect("a cloud");
    let mut las = las(&cloud).clone();
    for id in 0..3 {
        let data = vec![id as u8; 70_000];
        las.records.push(LasRecord {
            user_id: "someone".into(),
            id,
            is_extended: true,
            data,
            ..Default::default()
        });
    }
    cloud.origin.extra = Some(Extra::new(las));
    for format in [LAS, LAZ] {
        let (back, bytes) = again(&cloud, format);
        assert_eq!(back, cloud);
        assert!(bytes[6] & 16 != 0, "the standard wants it in this point format");
    }
    cloud.origin.crs = Some(Crs::Wkt(format!("PROJCS[\"{}\"]", "x".repeat(100_000))));
    let (back, bytes) = again(&cloud, LAZ);
    assert_eq!((back.origin.crs, bytes[6] & 16), (cloud.origin.crs, 16));
}

#[test]
fn another_system_replaces_the_files_own() {
    let cloud = read_content(&file(3, false, 50, true)).expect("a cloud");
    for (crs, count) in
        [(None, 0), (Some("EPSG:25832+5783"), 1), (Some("my own"), 2), (Some("GEOGCS[\"y\"]"), 1)]
    {
        let mut cloud = cloud.clone();
        cloud.origin.crs = crs.map(|text| text.parse().expect("any text"));
        let back = again(&cloud, LAS).0;
        assert_eq!(back.origin.crs, cloud.origin.crs);
        assert_eq!(las(&back).records.len(), count);
        // From elsewhere: keys of GeoTIFF only where the standard has them.
        cloud.origin.extra = None;
        let (back, bytes) = again(&cloud, LAS);
        assert_eq!(back.origin.crs, cloud.origin.crs);
        let is_keys = crs.is_some_and(|text| !text.contains('['));
        assert_eq!((las(&back).point_format, bytes[6] & 16), if is_keys { (3, 0) } else { (7, 16) });
    }
}

#[test]
fn what_comes_from_elsewhere_finds_its_place() {
    let count = 300_u16;
    let positions: Vec<Position> =
        (0..count).map(|i| [f64::from(i) * 0.01, -3e6, 1e-5 * f64::from(i)]).collect();
    let bytes = |scale: u16| Values::U8((0..count).map(|i| (i * scale) as u8).collect());
    let attribute = |name: &str, values| Attribute { name: name.into(), values };
    let attributes = vec![
        attribute("red", bytes(1)),
        attribute("green", bytes(2)),
        attribute("blue", bytes(3)),
        attribute("intensity", Values::F32((0..count).map(|i| f32::from(i) + 0.5).collect())),
        attribute("classification", Values::I32(vec![200; count.into()])),
        attribute("gps_time", Values::F64((0..count).map(|i| 3e8 + f64::from(i) / 7.0).collect())),
        attribute("nx", Values::F32(vec![0.25; count.into()])),
        attribute("id", Values::U64((0..count).map(|i| u64::MAX - u64::from(i)).collect())),
        attribute("a name that is longer than what is there for it", Values::I8(vec![-5; count.into()])),
        attribute(
            "a name that is longer than what is there for them",
            Values::I64(vec![i64::MIN; count.into()]),
        ),
    ];
    let cloud = Cloud { positions, attributes, ..Cloud::default() };
    for format in [LAS, LAZ] {
        let (back, file) = again(&cloud, format);
        assert_eq!((las(&back).version, las(&back).point_format, file[6]), ((1, 4), 7, 17));
        assert_eq!(las(&back).scale, [1e-5, 1e-5, 1e-8]);
        for (a, b) in back.positions.as_flattened().iter().zip(cloud.positions.as_flattened()) {
            assert!((a - b).abs() <= 5.1e-6, "{a} and {b}");
        }
        assert_eq!(column(&back, "green").get(100), 200.0 * 257.0);
        assert_eq!(column(&back, "return_number").get(9), 1.0);
        assert_eq!(column(&back, "classification").get(0), 200.0);
        for (name, from) in [
            ("intensity_", 3),
            ("gps_time", 5),
            ("nx", 6),
            ("id", 7),
            ("a name that is longer than what", 8),
            ("a name that is longer than what_", 9),
        ] {
            assert_eq!(column(&back, name), &cloud.attributes[from].values, "{name}");
        }
    }
    assert_eq!(LAS.cannot_hold(&cloud.attributes, &cloud.origin), [""; 0]);
}

#[test]
fn steps_suit_the_cloud_and_the_range_of_integers() {
    for (positions, scale) in [
        (vec![[0.0; 3]; 2], 1e-3),
        (vec![[5.0, 0.0, 7.0], [5.0, 1.0, 7.0]], 1e-5),
        (vec![[0.0; 3], [1e-20, 1e-20, 1e-20]], 1e-25),
        (vec![[-1e12, 0.0, 0.0], [1e12, 0.0, 0.0]], 1e3),
        (vec![[1e300, 0.0, 0.0], [2e300, 0.0, 0.0]], 1e291),
    ] {
        let cloud = Cloud::from(positions);
        let back = again(&cloud, LAS).0;
        assert!((las(&back).scale[0] / scale - 1.0).abs() < 1e-9, "{:?}", las(&back).scale);
        for (a, b) in back.positions.as_flattened().iter().zip(cloud.positions.as_flattened()) {
            assert!((a - b).abs() <= scale, "{a} and {b}");
        }
    }
    // Too far from the source's offset, then too far apart for its scale.
    for (far, scale, offset) in [(3e6, 0.001, 1.5e6), (1e7, 0.01, 5e6)] {
        let las = LasOrigin { version: (1, 2), scale: [0.001; 3], ..LasOrigin::default() };
        let origin = Origin { extra: Some(Extra::new(las)), ..Origin::default() };
        let cloud = Cloud { positions: vec![[0.0; 3], [far, 1.0, 1.0]], origin, ..Cloud::default() };
        let back = again(&cloud, LAS).0;
        let las = self::las(&back);
        assert_eq!((las.scale, las.offset), ([scale, 0.001, 0.001], [offset, 0.0, 0.0]));
        assert_eq!(back.positions, cloud.positions);
    }
    assert!(encode(Vec::new(), LAZ, &[], &[], &Origin::default()).is_ok(), "no point at all");
}

#[test]
fn a_sixth_return_takes_the_latest_header() {
    let mut cloud = read_content(&file(1, false, 10, false)).expect("a cloud");
    for attribute in &mut cloud.attributes {
        if attribute.name.contains("return") {
            attribute.values = Values::U8(vec![6; 10]);
        }
    }
    let back = again(&cloud, LAZ).0;
    assert_eq!((las(&back).version, las(&back).point_format), ((1, 4), 1));
    assert_eq!(back.attributes, cloud.attributes);
}

#[test]
fn old_comments_make_room_for_new_ones() {
    let origin =
        Origin { comments: (0..9).map(|i| i.to_string().repeat(10_000)).collect(), ..Origin::default() };
    let cloud = Cloud { positions: vec![[0.0; 3]], origin, ..Cloud::default() };
    assert_eq!(again(&cloud, LAS).0.origin.comments, cloud.origin.comments[3..]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn damage_never_panics(
        compressed in any::<bool>(),
        modern in any::<bool>(),
        // Most in the header and the records, where it does most.
        damage in prop::collection::vec((prop_oneof![0_usize..600, 0_usize..20_000], any::<u8>()), 1..6),
        cut in prop_oneof![Just(usize::MAX), 0_usize..20_000],
    ) {
        let mut bytes = file(if modern { 6 } else { 3 }, compressed, 300, modern);
        bytes.truncate(cut);
        for (place, value) in damage {
            if let Some(byte) = bytes.get_mut(place.max(4)) {
                *byte = value;
            }
        }
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.attributes.iter().all(|a| a.values.len() == cloud.positions.len()));
            // Whatever was read is written, or it is said why not.
            let _ = encode(Vec::new(), LAZ, &cloud.positions, &cloud.attributes, &cloud.origin);
        }
    }
}
