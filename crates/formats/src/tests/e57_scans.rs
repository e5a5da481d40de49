//! E57 of many scans: what each of them has, and what that costs.

use std::io::Cursor;
use std::sync::Arc;

use ::e57::{E57Writer, Extension, Record, RecordDataType, RecordName, RecordValue};

use super::*;
use densecloud_cloud::{Origin, Sensors};

fn find<'a>(cloud: &'a Cloud, name: &str) -> &'a Values {
    &cloud.attributes.iter().find(|a| a.name == name).unwrap_or_else(|| panic!("no {name}")).values
}

/// A file of scans, each of `points` points with these columns, whose numbers are all this one.
fn scans(points: usize, scans: &[Vec<(String, RecordValue)>]) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut file, "guid").expect("a writer");
    writer.register_extension(Extension::new("other", "url")).expect("an extension");
    for (i, columns) in scans.iter().enumerate() {
        let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
        let mut prototype = axes.map(|name| Record { name, data_type: RecordDataType::F32 }).to_vec();
        prototype.extend(columns.iter().map(|(name, value)| {
            let data_type = match value {
                RecordValue::Single(_) => RecordDataType::F32,
                RecordValue::Double(_) => RecordDataType::F64,
                _ => RecordDataType::Integer { min: 0, max: 255 },
            };
            Record { name: RecordName::Unknown { namespace: "other".into(), name: name.clone() }, data_type }
        }));
        let mut scan = writer.add_pointcloud(&format!("{i}"), prototype).expect("a scan");
        for _ in 0..points {
            let mut point = [i as f32, 2.0, 3.0].map(RecordValue::Single).to_vec();
            point.extend(columns.iter().map(|(_, value)| value.clone()));
            scan.add_point(point).expect("a point");
        }
        scan.finalize().expect("a scan");
    }
    writer.finalize().expect("a file");
    drop(writer);
    file.into_inner()
}

fn one(name: &str, value: RecordValue) -> Vec<(String, RecordValue)> {
    vec![(name.to_owned(), value)]
}

#[test]
fn what_is_absent_stays_so_where_whole_numbers_become_floats() {
    let columns = [one("width", RecordValue::Integer(7)), Vec::new(), one("width", RecordValue::Double(0.5))];
    let cloud = read(&scans(2, &columns)).expect("a cloud");
    let width = find(&cloud, "width");
    assert!([0, 1].iter().all(|i| width.get(*i) == 7.0) && [4, 5].iter().all(|i| width.get(*i) == 0.5));
    assert!([2, 3].iter().all(|i| width.get(*i).is_nan()), "{width:?}");
    assert!(cloud.attributes.iter().all(|a| a.name != "width_invalid"));
}

#[test]
fn columns_that_would_be_empty_nearly_everywhere_are_refused() {
    let bytes = |scan: usize, columns: usize| -> Vec<(String, RecordValue)> {
        (0..columns).map(|i| (format!("c{scan}_{i}"), RecordValue::Integer(7))).collect()
    };
    let many: Vec<_> = (0..4).map(|scan| bytes(scan, 300)).collect();
    let why = read(&scans(1, &many)).expect_err("too many").to_string();
    assert!(why.contains("1200 columns") && why.contains("1000"), "{why}");
    // Not so many columns, but of as many points.
    let far: Vec<_> = (0..90).map(|scan| bytes(scan, 10)).collect();
    let why = read(&scans(300, &far)).expect_err("too much").to_string();
    assert!(why.contains("900 columns of 27000 points"), "{why}");
    let few: Vec<_> = (0..3).map(|scan| bytes(scan, 2)).collect();
    assert_eq!(read(&scans(300, &few)).expect("a cloud").attributes.len(), 2 * 6 + 1);
}

#[test]
fn columns_of_one_name_are_told_apart_the_same_way_everywhere() {
    let value = || RecordValue::Integer(7);
    let columns: Vec<_> = ["a", "a_", "b"].map(|name| (name.to_owned(), value())).into();
    let cloud = read(&scans(1, &[columns])).expect("a cloud");
    let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(names, ["a", "a_", "b"]);
}

fn scanned(scan: Values, attribute: &str) -> Cloud {
    let places = vec![Some([1.0, 2.0, 3.0]), Some([4.0, 5.0, 6.0]), Some([7.0, 8.0, 9.0])];
    let sensors = Sensors { attribute: attribute.into(), places };
    let origin = Origin { sensors: Some(Arc::new(sensors)), ..Origin::default() };
    let attributes = vec![Attribute { name: "scan".into(), values: scan }];
    Cloud { positions: vec![[0.0; 3], [1.0; 3], [2.0; 3]], attributes, origin, ..Cloud::default() }
}

#[test]
fn sensors_that_are_lost_are_told() {
    let is_told = |cloud: &Cloud| {
        let lost = Format::E57.cannot_hold(&cloud.attributes, &cloud.origin);
        lost.iter().any(|lost| lost.contains("sensor"))
    };
    let is_kept = |cloud: &Cloud| {
        let file = encode(Vec::new(), Format::E57, &cloud.positions, &cloud.attributes, &cloud.origin)
            .expect("a file");
        read(&file).expect("a cloud").origin.sensors.is_some()
    };
    let mut without = scanned(Values::U8(vec![0, 1, 2]), "scan");
    without.attributes.clear();
    for (cloud, kept) in [
        (scanned(Values::U8(vec![0, 1, 2]), "scan"), true),
        // A scan of which no point is left.
        (scanned(Values::U8(vec![0, 2, 2]), "scan"), false),
        (scanned(Values::F32(vec![0.0, 1.0, 2.0]), "scan"), false),
        (scanned(Values::U8(vec![0, 1, 2]), "station"), false),
        (scanned(Values::U8(vec![1, 1, 1]), "scan"), false),
        (without, false),
    ] {
        assert_eq!((is_kept(&cloud), is_told(&cloud)), (kept, !kept), "{:?}", cloud.attributes);
    }
}

#[test]
fn how_the_sensor_was_turned_is_told_where_it_is_lost() {
    let turned = Origin { orientation: Some([0.5, 0.5, 0.5, 0.5]), ..Origin::default() };
    let pcd = Format::Pcd { encoding: PcdEncoding::Binary, scalar: Scalar::F32 };
    assert!(pcd.cannot_hold(&[], &turned).is_empty());
    // Not turned, it is not lost.
    let text =
        "# .PCD\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nVIEWPOINT 7 8 9 1 0 0 0\nDATA ascii\n1 2 3\n";
    let plain = read(text.as_bytes()).expect("a cloud").origin;
    assert_eq!((plain.sensor, Format::E57.cannot_hold(&[], &plain)), (Some([7.0, 8.0, 9.0]), Vec::new()));
    let others =
        [Format::E57, Format::TEXT, Format::Las { compressed: false }, Format::Colmap { binary: true }];
    for format in others.into_iter().chain([ply(PlyEncoding::Ascii, Scalar::F32)]) {
        assert_eq!(format.cannot_hold(&[], &turned), ["how the sensor was turned"], "{format}");
        assert!(format.cannot_hold(&[], &Origin::default()).is_empty(), "{format}");
    }
}

#[test]
fn each_of_many_scans_has_its_own_points() {
    const SCANS: u16 = 3000;
    let scan: Vec<u16> = (0..2 * SCANS).map(|i| (7 * i) % SCANS).collect();
    let positions = scan.iter().zip(0..).map(|(scan, i)| [f64::from(*scan), f64::from(i), 0.0]).collect();
    let intensity = Values::U16(scan.iter().map(|scan| scan + 1).collect());
    let attributes = vec![
        Attribute { name: "intensity".into(), values: intensity },
        Attribute { name: "scan".into(), values: Values::U16(scan) },
    ];
    let cloud = Cloud { positions, attributes, ..Cloud::default() };
    let file =
        encode(Vec::new(), Format::E57, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file");
    let back = read(&file).expect("a cloud");
    assert_eq!(back.positions.len(), cloud.positions.len());
    let (scans, intensity) = (find(&back, "scan"), find(&back, "intensity"));
    for (i, [scan, row, _]) in back.positions.iter().enumerate() {
        assert_eq!((scans.get(i), intensity.get(i)), (*scan, scan + 1.0));
        assert_eq!(cloud.positions[*row as usize], back.positions[i]);
    }
}
