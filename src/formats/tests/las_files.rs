//! LAS and LAZ, written by the `las` crate.

use std::io::Cursor;

use ::las::point::{Classification, ScanDirection};
use ::las::{Builder, Color, Point, Transform, Vector, Vlr, Writer};
use proptest::prelude::*;

use super::*;

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
            data: b"WKT".to_vec(),
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
        assert_eq!(
            cloud.dropped_properties,
            ["the coordinate system", "pair", "1 bytes a point without a description"]
        );
    }
}

#[test]
fn las_is_refused_where_it_cannot_be_read_or_written() {
    let error = CloudWriter::new(Vec::new(), Format::Las { compressed: false }, 1)
        .expect_err("not written")
        .to_string();
    assert!(error.contains(".ply"), "{error}");
    let bytes = file(1, false, 100, false);
    let limits = Limits { max_points: Some(99), ..Limits::default() };
    let error = CloudReader::open(&bytes[..], limits).err().expect("too many");
    assert!(matches!(error, FormatError::TooManyPoints { points: 100, limit: 99 }));
    let error = read(&bytes[..bytes.len() - 1]).expect_err("cut off").to_string();
    assert!(error.contains("counts more than is there"), "{error}");
    assert!(read(&bytes[..100]).expect_err("cut off").to_string().contains("incomplete"));
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
        }
    }
}
