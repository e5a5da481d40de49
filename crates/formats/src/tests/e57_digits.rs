//! Whole numbers of E57 with more digits than floats have.

use std::io::Cursor;

use ::e57::{E57Writer, Record, RecordDataType, RecordName, RecordValue};

use super::*;

/// 2^53 and one more.
const ODD: i64 = 9_007_199_254_740_993;

/// A file of scans of one point each, with an intensity of these types and values.
fn file(scans: &[(RecordDataType, RecordValue)]) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut file, "guid").expect("a writer");
    for (number, (data_type, value)) in scans.iter().enumerate() {
        let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
        let mut prototype = axes.map(|name| Record { name, data_type: RecordDataType::F64 }).to_vec();
        prototype.push(Record { name: RecordName::Intensity, data_type: data_type.clone() });
        let mut scan = writer.add_pointcloud(&number.to_string(), prototype).expect("a scan");
        let mut point = [0.0, 1.0, number as f64].map(RecordValue::Double).to_vec();
        point.push(value.clone());
        scan.add_point(point).expect("a point");
        scan.finalize().expect("a scan");
    }
    writer.finalize().expect("a file");
    drop(writer);
    file.into_inner()
}

#[test]
fn whole_numbers_are_exact_and_what_floats_round_is_told() {
    let whole = |value| (RecordDataType::Integer { min: 0, max: i64::MAX }, RecordValue::Integer(value));
    let float = (RecordDataType::F64, RecordValue::Double(0.5));
    let scaled = |value| {
        let data_type = RecordDataType::ScaledInteger { min: 0, max: i64::MAX, scale: 1.0, offset: 0.0 };
        (data_type, RecordValue::ScaledInteger(value))
    };
    for (scans, kept, is_told) in [
        (vec![whole(ODD), whole(i64::MAX)], Values::U64(vec![ODD as u64, i64::MAX as u64]), false),
        (vec![whole(ODD), float.clone()], Values::F64(vec![ODD as f64, 0.5]), true),
        (vec![float.clone(), whole(ODD)], Values::F64(vec![0.5, ODD as f64]), true),
        (vec![float, whole(ODD - 1)], Values::F64(vec![0.5, (ODD - 1) as f64]), false),
        (vec![scaled(ODD)], Values::F64(vec![ODD as f64]), true),
        (vec![scaled(ODD - 1)], Values::F64(vec![(ODD - 1) as f64]), false),
    ] {
        let cloud = read(&file(&scans)).expect("a cloud");
        let intensity = cloud.attributes.iter().find(|a| a.name == "intensity").expect("an intensity");
        assert_eq!(intensity.values, kept);
        let told = [
            "`intensity` has whole numbers beyond 2^53, and not all of it are 64-bit integers: it is read as \
                     floats, and the last digits of these are rounded",
        ];
        assert_eq!(cloud.notes, if is_told { &told[..] } else { &[] }, "{scans:?}");
    }
}
