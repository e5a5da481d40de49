//! Which column of a cloud fills which place of a format, and what keeps its own.

use std::io::Cursor;

use ::e57::{E57Writer, Extension, Record, RecordDataType, RecordName, RecordValue};

use super::*;
use densecloud_cloud::Origin;

const LAS: Format = Format::Las { compressed: false };

fn column(name: &str, values: Values) -> Attribute {
    Attribute { name: name.into(), values }
}

fn find<'a>(cloud: &'a Cloud, name: &str) -> &'a Values {
    &cloud.attributes.iter().find(|a| a.name == name).unwrap_or_else(|| panic!("no {name}")).values
}

fn written(cloud: &Cloud, format: Format) -> Vec<u8> {
    encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

/// A PCD file by hand, of one point.
fn pcd(fields: &str, sizes: &str, types: &str, row: &str) -> Cloud {
    let text = format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z {fields}\nSIZE 4 4 4 {sizes}\nTYPE F F F {types}\nWIDTH 1\nHEIGHT 1\n\
         POINTS 1\nDATA ascii\n1 2 3 {row}\n"
    );
    read(text.as_bytes()).expect("a cloud")
}

#[test]
fn from_a_format_to_itself_names_and_types_stay() {
    for (fields, sizes) in [("normal_x normal_y normal_z nx", "8 8 8 4"), ("nx ny nz time", "8 4 4 8")] {
        let cloud = pcd(fields, sizes, "F F F F", "0.6 0.0 0.8 7");
        for encoding in [PcdEncoding::Ascii, PcdEncoding::Binary, PcdEncoding::Compressed] {
            let format = Format::Pcd { encoding, scalar: Scalar::F32 };
            assert_eq!(
                read(&written(&cloud, format)).expect("a cloud").attributes,
                cloud.attributes,
                "{fields}"
            );
            assert!(format.renamed(&cloud.attributes, &cloud.origin).is_empty());
        }
    }
    let cloud = read(&e57_with("gps_time")).expect("a cloud");
    let names = |cloud: &Cloud| cloud.attributes.iter().map(|a| a.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&cloud), ["gps_time"]);
    assert_eq!(names(&read(&written(&cloud, Format::E57)).expect("a cloud")), ["gps_time"]);
}

/// An E57 file of one point with a column of another program's.
fn e57_with(name: &str) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut file, "guid").expect("a writer");
    writer.register_extension(Extension::new("other", "url")).expect("an extension");
    let own = RecordName::Unknown { namespace: "other".into(), name: name.into() };
    let names = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ, own];
    let prototype = names.map(|name| Record { name, data_type: RecordDataType::F64 });
    let mut scan = writer.add_pointcloud("a", prototype.to_vec()).expect("a scan");
    scan.add_point([1.0, 2.0, 3.0, 1.5e9].map(RecordValue::Double).to_vec()).expect("a point");
    scan.finalize().expect("a scan");
    writer.finalize().expect("a file");
    drop(writer);
    file.into_inner()
}

#[test]
fn what_is_added_to_a_cloud_of_a_format_has_the_formats_own_name() {
    let mut cloud = pcd("label", "4", "U", "9");
    let normal = ["nx", "ny", "nz"].map(|name| column(name, Values::F64(vec![0.5])));
    cloud.attributes.extend(normal);
    let format = Format::Pcd { encoding: PcdEncoding::Binary, scalar: Scalar::F32 };
    let back = read(&written(&cloud, format)).expect("a cloud");
    let names: Vec<&str> = back.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!(names, ["label", "normal_x", "normal_y", "normal_z"]);
    assert_eq!(find(&back, "normal_x"), &Values::F32(vec![0.5]));
}

#[test]
fn the_colour_that_is_made_whole_is_the_one_that_is_written() {
    let bytes = |from: u8| Values::U8(vec![from, from + 1]);
    let floats = |from: f64| Values::F64(vec![from, 255.0]);
    let attributes = vec![
        column("R", bytes(1)),
        column("G", bytes(2)),
        column("B", bytes(3)),
        column("red", floats(100.0)),
        column("green", floats(150.0)),
        column("blue", floats(200.0)),
        column("scalar_Intensity", Values::F64(vec![3.0, 4.0])),
        column("intensity", Values::F64(vec![7.0, 9.0])),
    ];
    let mut cloud = Cloud { positions: vec![[0.0; 3], [1.0; 3]], attributes, ..Cloud::default() };
    let npy = Format::Npy { scalar: Scalar::F64, fields: true };
    npy.adapt(&mut cloud.attributes, LAS);
    let back = read(&written(&cloud, LAS)).expect("a cloud");
    assert_eq!(find(&back, "red"), &Values::U16(vec![100 * 257, 255 * 257]));
    assert_eq!(find(&back, "blue"), &Values::U16(vec![200 * 257, 255 * 257]));
    assert_eq!((find(&back, "R"), find(&back, "intensity")), (&bytes(1), &Values::U16(vec![7, 9])));
    // What has no place of its own keeps its type.
    assert_eq!(find(&back, "scalar_Intensity"), &Values::F64(vec![3.0, 4.0]));
}

#[test]
fn a_time_of_no_gps_keeps_no_other_from_its_place() {
    let cloud = read(b"x,y,z,timestamp,GpsTime\n0,0,0,5.5,1.5e9\n1,0,0,6.5,1.6e9\n").expect("a cloud");
    for origin in [&cloud.origin, &Origin::default()] {
        let las = encode(Vec::new(), LAS, &cloud.positions, &cloud.attributes, origin).expect("a file");
        let back = read(&las).expect("a cloud");
        assert_eq!(find(&back, "gps_time"), &Values::F64(vec![1.5e9, 1.6e9]));
        assert_eq!(find(&back, "timestamp"), &Values::F64(vec![5.5, 6.5]));
    }
}

#[test]
fn more_columns_than_a_cloud_has_are_refused() {
    let cloud = |count: usize| {
        let attributes = (0..count).map(|i| column(&format!("c{i}"), Values::U8(vec![7]))).collect();
        Cloud { positions: vec![[1.0; 3]], attributes, ..Cloud::default() }
    };
    let fields = Format::Npy { scalar: Scalar::F64, fields: true };
    let text = Format::Xyz { names: true, separator: Separator::Comma, decimal: Decimal::Point };
    let pcd = Format::Pcd { encoding: PcdEncoding::Compressed, scalar: Scalar::F32 };
    for format in [ply(PlyEncoding::Ascii, Scalar::F32), pcd, fields, text, LAS, Format::E57] {
        let some = read(&written(&cloud(900), format)).expect("a cloud");
        assert!(some.attributes.len() >= 900, "{format}");
        // E57 is not written with more.
        if format != Format::E57 {
            let why = read(&written(&cloud(1001), format)).expect_err("too many").to_string();
            assert!(why.contains("more than 1000"), "{format}: {why}");
        }
    }
}

#[test]
fn a_thousand_names_that_text_writes_alike_are_told_apart() {
    let attributes =
        (1..900).map(|i| column(&format!("a{}", "\u{1}".repeat(i)), Values::U8(vec![7]))).collect();
    let cloud = Cloud { positions: vec![[1.0; 3]], attributes, ..Cloud::default() };
    let text = Format::Xyz { names: true, separator: Separator::Comma, decimal: Decimal::Point };
    let back = read(&written(&cloud, text)).expect("a cloud");
    let names: Vec<&str> = back.attributes.iter().map(|a| a.name.as_str()).collect();
    assert_eq!((names[..3].to_vec(), names[898]), (vec!["a", "a_2", "a_3"], "a_899"));
}
