//! From each format to each other: what is kept of a cloud that has everything, under the names that three programs give.
//!
//! The table that this makes stands in `docs/formats.md`, which is held against it. To renew it:
//!
//! ```sh
//! DENSECLOUD_RENEW_DOCS=1 cargo test -p densecloud-formats conversions
//! ```

use std::fmt::Write as _;
use std::path::Path;

use super::*;
use densecloud_cloud::{Kind, Named, Origin, Role};

const POINTS: usize = 64;
const LAS: Format = Format::Las { compressed: false };
const COLMAP: Format = Format::Colmap { binary: false };

/// The formats that are written, and what the table calls them.
fn targets() -> [(&'static str, Format); 7] {
    [
        ("PLY", ply(PlyEncoding::BinaryLittleEndian, Scalar::F64)),
        ("LAS, LAZ", LAS),
        ("E57", Format::E57),
        ("PCD", Format::Pcd { encoding: PcdEncoding::Binary, scalar: Scalar::F64 }),
        ("NumPy", Format::Npy { scalar: Scalar::F64, fields: true }),
        ("COLMAP", COLMAP),
        ("text", Format::Xyz { names: true, separator: Separator::Comma, decimal: Decimal::Point }),
    ]
}

/// Whose names the columns have.
#[derive(Clone, Copy, PartialEq)]
enum Style {
    Pdal,
    /// It has floats for all but colours.
    CloudCompare,
    /// LAS's fields, where it has some.
    Ours,
}

/// A column: its name in each style, and its number in row `i`.
type Part = ([&'static str; 3], Kind, fn(usize) -> f64);

#[rustfmt::skip]
const PARTS: [Part; 33] = [
    (["Red", "R", "red"], Kind::U8, |i| (3 * i) as f64),
    (["Green", "G", "green"], Kind::U8, |i| (4 * i) as f64 + 1.0),
    (["Blue", "B", "blue"], Kind::U8, |i| 255.0 - i as f64),
    (["Infrared", "scalar_Near_Infrared", "nir"], Kind::U16, |i| 30_000.0 + i as f64),
    (["NormalX", "Nx", "nx"], Kind::F32, |i| normal(i)[0]),
    (["NormalY", "Ny", "ny"], Kind::F32, |i| normal(i)[1]),
    (["NormalZ", "Nz", "nz"], Kind::F32, |i| normal(i)[2]),
    (["Intensity", "scalar_Intensity", "intensity"], Kind::U16, |i| 40_000.0 + 7.0 * i as f64),
    (["ReturnNumber", "scalar_Return_Number", "return_number"], Kind::U8, |i| (i % 5) as f64 + 1.0),
    (["NumberOfReturns", "scalar_Number_Of_Returns", "number_of_returns"], Kind::U8, |i| (i % 3) as f64 + 5.0),
    (["Classification", "scalar_Classification", "classification"], Kind::U8, |i| (i % 19) as f64),
    (["UserData", "scalar_User_Data", "user_data"], Kind::U8, |i| i as f64 + 100.0),
    (["ScanAngleRank", "scalar_Scan_Angle_Rank", "scan_angle"], Kind::F32, |i| i as f64 - 30.0),
    (["PointSourceId", "scalar_Point_Source_ID", "point_source_id"], Kind::U16, |i| (i / 8) as f64 + 7001.0),
    (["GpsTime", "scalar_Gps_Time", "gps_time"], Kind::F64, |i| 4096.0 + i as f64 / 8.0),
    (["ScanDirectionFlag", "scalar_Scan_Direction", "scan_direction_flag"], Kind::U8, |i| (i & 1) as f64),
    (["EdgeOfFlightLine", "scalar_EdgeOfFlightLine", "edge_of_flight_line"], Kind::U8, |i| (i >> 1 & 1) as f64),
    (["Synthetic", "scalar_Synthetic_Flag", "synthetic"], Kind::U8, |i| (i >> 2 & 1) as f64),
    (["KeyPoint", "scalar_Key_Point_Flag", "key_point"], Kind::U8, |i| (i >> 3 & 1) as f64),
    (["Withheld", "scalar_Withheld_Flag", "withheld"], Kind::U8, |i| (i >> 4 & 1) as f64),
    (["Overlap", "scalar_Overlap_Flag", "overlap"], Kind::U8, |i| (i >> 5) as f64),
    (["ScanChannel", "scalar_Scanner_Channel", "scanner_channel"], Kind::U8, |i| (i / 16) as f64),
    (["Reflectance", "scalar_Reflectance", "reflectance"], Kind::F32, |i| -20.0 + i as f64 / 4.0),
    (["Amplitude", "scalar_Amplitude", "amplitude"], Kind::F32, |i| 20.0 + i as f64 / 4.0),
    (["Range", "scalar_Range", "range"], Kind::F64, |i| 10.0 + i as f64 / 16.0),
    (["Ring", "scalar_Ring", "ring"], Kind::U8, |i| (i % 16) as f64),
    (["PointId", "scalar_Point_ID", "id"], Kind::U32, |i| 1e6 + i as f64),
    (["SegmentId", "scalar_Label", "label"], Kind::I32, |i| (i / 9) as f64 - 1.0),
    (["Confidence", "scalar_Confidence", "confidence"], Kind::F32, |i| 1.0 / (2.0 + i as f64)),
    (["Error", "scalar_error", "error"], Kind::F64, |i| 0.5 + i as f64 / 128.0),
    (["Row", "scalar_Row", "row_index"], Kind::I32, |i| (i / 7) as f64 + 300.0),
    (["Column", "scalar_Column", "column_index"], Kind::I32, |i| (i % 7) as f64 + 300.0),
    (["Deviation", "scalar_Deviation", "deviation"], Kind::U16, |i| (i % 11) as f64 + 400.0),
];

fn normal(i: usize) -> [f64; 3] {
    let (sin, cos) = (0.1 * i as f64).sin_cos();
    [0.6 * sin, 0.6 * cos, 0.8]
}

fn cloud(style: Style) -> Cloud {
    let attributes = PARTS.iter().map(|(names, kind, number)| {
        let is_scalar = names[1].starts_with("scalar_");
        let kind = if style == Style::CloudCompare && is_scalar { Kind::F32 } else { *kind };
        Attribute {
            name: names[style as usize].to_owned(),
            values: Values::from_f64(kind, (0..POINTS).map(number)),
        }
    });
    let positions = (0..POINTS).map(|i| [i as f64 / 4.0, (i * i % 17) as f64, 0.25]).collect();
    Cloud { positions, attributes: attributes.collect(), ..Cloud::default() }
}

fn written(cloud: &Cloud, format: Format) -> Vec<u8> {
    encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

/// A cloud as a file of this format has it that was written by the program whose names these are.
fn source(style: Style, format: Format) -> Cloud {
    let mut cloud = cloud(style);
    // Where the format has names of its own, all programs write these.
    if matches!(format, Format::Las { .. } | Format::E57 | Format::Colmap { .. }) {
        return read(&written(&cloud, format)).expect("a cloud");
    }
    let names = cloud.attributes.iter().map(|attribute| attribute.name.clone()).collect();
    cloud.origin.named_in = Some(Named { kind: format.kind(), names });
    read(&written(&cloud, format)).expect("a cloud")
}

/// Whether a number has become another.
type Same<'a> = &'a dyn Fn(f64, f64) -> bool;

/// What a file tells of the whole: its name, a word of the warning where it is lost, and whether it is kept.
type Fact = (&'static str, &'static str, fn(&Origin) -> bool);

/// What has become of an attribute.
fn fate(
    attribute: &Attribute,
    result: &Cloud,
    told: &[(String, String)],
    lost: &[String],
    to: Format,
) -> String {
    let wanted: Vec<f64> = (0..POINTS).map(|i| attribute.values.get(i)).collect();
    let of = |found: &Attribute, same: &dyn Fn(f64, f64) -> bool| {
        wanted.iter().enumerate().all(|(i, wanted)| same(*wanted, found.values.get(i)))
    };
    // No two columns have the same numbers, nor nearly.
    let exactly = |a: f64, b: f64| a == b || attribute.values.kind() == Kind::F32 && a as f32 == b as f32;
    let ways: [(&str, Same); 4] = [
        ("", &exactly),
        ("× 257", &|a, b| 257.0 * a == b),
        ("÷ 257", &|a, b| a == 257.0 * b),
        ("rounded", &|a, b| (a - b).abs() <= 0.003),
    ];
    let found = ways
        .iter()
        .find_map(|(how, same)| Some((*how, result.attributes.iter().find(|found| of(found, same))?)));
    let Some((how, found)) = found else {
        assert!(lost.contains(&attribute.name), "{to}: nobody is told that {} is lost", attribute.name);
        return "lost".to_owned();
    };
    let mut fate = Vec::new();
    if found.name != attribute.name {
        let is_own = Role::of(&attribute.name).or_else(|| colour(&attribute.name)) == Role::of(&found.name);
        let is_told = told.iter().any(|(from, to)| (from, to) == (&attribute.name, &found.name));
        assert!(is_own || is_told, "{to}: nobody is told that {} is {}", attribute.name, found.name);
        fate.push(format!("`{}`", found.name));
    }
    // Text has no types.
    let is_text = matches!(to, Format::Xyz { .. });
    if found.values.kind() != attribute.values.kind() && !is_text {
        fate.push(format!("{:?}", found.values.kind()).to_lowercase());
    }
    fate.extend((!how.is_empty()).then(|| how.to_owned()));
    if fate.is_empty() { "=".to_owned() } else { fate.join(", ") }
}

/// Names that mean something only together.
fn colour(name: &str) -> Option<Role> {
    [("R", Role::Red), ("G", Role::Green), ("B", Role::Blue)]
        .iter()
        .find(|(short, _)| *short == name)
        .map(|c| c.1)
}

/// What becomes of each attribute of a cloud from a file of one format in one of another.
fn fates(cloud: &Cloud, from: Format, to: Format) -> Vec<String> {
    let mut adapted = cloud.clone();
    from.adapt(&mut adapted.attributes, to);
    let result = read(&written(&adapted, to)).expect("a cloud");
    assert_eq!(result.positions, cloud.positions, "{to}");
    let told = to.renamed(&adapted.attributes, &adapted.origin);
    let lost = to.cannot_hold(&adapted.attributes, &adapted.origin);
    cloud.attributes.iter().map(|attribute| fate(attribute, &result, &told, &lost, to)).collect()
}

/// A table's row: what becomes of a column from these sources in each format.
fn table(title: &str, sources: &[(&'static str, Format, Cloud)]) -> String {
    let mut text = format!("| {title} |");
    for (name, _) in targets() {
        write!(text, " {name} |").expect("text");
    }
    text += "\n|---|---|---|---|---|---|---|---|\n";
    let of = |to: Format| -> Vec<(&str, Vec<String>)> {
        let others = sources.iter().filter(|(_, from, _)| from.kind() != to.kind());
        others.map(|(name, from, cloud)| (*name, fates(cloud, *from, to))).collect()
    };
    let columns = targets().map(|(_, to)| of(to));
    // Columns that fare alike share a row.
    let mut rows: Vec<(String, Vec<String>)> = Vec::new();
    for (row, attribute) in sources[0].2.attributes.iter().enumerate() {
        let cells = columns.iter().map(|fates| cell(row, fates)).collect::<Vec<_>>().join(" | ");
        let name = format!("`{}`", attribute.name);
        match rows.iter_mut().find(|(there, _)| *there == cells) {
            Some((_, names)) => names.push(name),
            None => rows.push((cells, vec![name])),
        }
    }
    for (cells, names) in rows {
        writeln!(text, "| {} | {cells} |", names.join(", ")).expect("text");
    }
    text
}

/// What becomes of a column in one format, and from which sources if not the same from all.
fn cell(row: usize, fates: &[(&str, Vec<String>)]) -> String {
    let mut kinds: Vec<(&str, Vec<&str>)> = Vec::new();
    for (source, fates) in fates {
        match kinds.iter_mut().find(|(fate, _)| *fate == fates[row]) {
            Some((_, sources)) => sources.push(source),
            None => kinds.push((&fates[row], vec![source])),
        }
    }
    match kinds.as_slice() {
        [] => "=".to_owned(),
        [(fate, _)] => (*fate).to_owned(),
        several => {
            let words = several.iter().map(|(fate, sources)| format!("{fate} ({})", sources.join(", ")));
            words.collect::<Vec<_>>().join("; ")
        }
    }
}

/// What becomes of what a file tells of the whole.
fn whole() -> String {
    let mut text =
        "| of the whole | PLY | LAS, LAZ | E57 | PCD | NumPy | COLMAP | text |\n|---|---|---|---|---|---|---|---|\n"
            .to_owned();
    let origin = Origin {
        crs: "EPSG:25832".parse().ok(),
        comments: vec!["made by hand".into()],
        sensor: Some([1.0, 2.0, 3.0]),
        orientation: Some([0.0, 0.6, 0.8, 0.0]),
        ..Origin::default()
    };
    let facts: [Fact; 4] = [
        ("coordinate system", "coordinate system", |origin| origin.crs.is_some()),
        ("comments", "", |origin| origin.comments == ["made by hand"]),
        ("sensor's place", "sensor's place", |origin| origin.sensor == Some([1.0, 2.0, 3.0])),
        ("how the sensor was turned", "turned", |origin| origin.orientation.is_some()),
    ];
    let cloud = Cloud { positions: cloud(Style::Ours).positions, origin, ..Cloud::default() };
    for (name, word, is_kept) in facts {
        write!(text, "| {name} |").expect("text");
        for (_, to) in targets() {
            let kept = is_kept(&read(&written(&cloud, to)).expect("a cloud").origin);
            let lost = to.cannot_hold(&[], &cloud.origin);
            let is_told =
                if word.is_empty() { !to.holds_comments() } else { lost.iter().any(|l| l.contains(word)) };
            assert!(kept != is_told, "{to}: {name} {lost:?}");
            write!(text, " {} |", if kept { "=" } else { "lost" }).expect("text");
        }
        text.push('\n');
    }
    text
}

#[test]
fn the_table_of_round_trips_is_true() {
    let free = |style| -> Vec<(&'static str, Format, Cloud)> {
        let free = targets().into_iter().filter(|(name, _)| !matches!(*name, "LAS, LAZ" | "E57" | "COLMAP"));
        free.map(|(name, format)| (name, format, source(style, format))).collect()
    };
    let one = |name, format| vec![(name, format, source(Style::Ours, format))];
    let mut text = String::new();
    for (title, sources) in [
        ("names as PDAL's", free(Style::Pdal)),
        ("names as CloudCompare's", free(Style::CloudCompare)),
        ("this program's names", free(Style::Ours)),
        ("from LAS, LAZ", one("LAS", LAS)),
        ("from E57", one("E57", Format::E57)),
        ("from COLMAP", one("COLMAP", COLMAP)),
    ] {
        text += &table(title, &sources);
        text.push('\n');
        for (name, format, cloud) in &sources {
            // From a format to itself.
            let fates = fates(cloud, *format, *format);
            assert!(fates.iter().all(|fate| fate == "="), "{title}, {name}: {fates:?}");
        }
    }
    text += &whole();
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/formats.md");
    let document = std::fs::read_to_string(&page).expect("a document");
    let (begin, end) = ("<!-- round trips: begin -->\n", "<!-- round trips: end -->");
    let (before, rest) = document.split_once(begin).expect("where the table begins");
    let (committed, after) = rest.split_once(end).expect("where the table ends");
    if std::env::var_os("DENSECLOUD_RENEW_DOCS").is_some() {
        std::fs::write(&page, [before, begin, &text, end, after].concat()).expect("it can be written");
        return;
    }
    assert!(
        committed == text,
        "{} has another table; to renew it: DENSECLOUD_RENEW_DOCS=1 cargo test -p densecloud-formats conversions",
        page.display()
    );
}

#[test]
fn records_of_colmap_keep_what_its_text_keeps() {
    let cloud = source(Style::Pdal, ply(PlyEncoding::Ascii, Scalar::F64));
    let read_as = |binary| read_content(&written(&cloud, Format::Colmap { binary })).expect("a cloud");
    assert_eq!(read_as(true), read_as(false));
}

#[test]
fn laz_keeps_what_las_keeps() {
    let cloud = source(Style::Pdal, ply(PlyEncoding::Ascii, Scalar::F64));
    let read_as = |compressed| read_content(&written(&cloud, Format::Las { compressed })).expect("a cloud");
    assert_eq!(read_as(true), read_as(false));
}

/// A table as PDAL writes it: all numbers with three decimals.
const PDAL: &str = "X,Y,Z,Intensity,ReturnNumber,NumberOfReturns,Classification,ScanAngleRank,PointSourceId,GpsTime,Red,Green,Blue\n\
    1.25,0.5,0.0,100.000,1.000,2.000,2.000,-3.000,7.000,300000000.125,17476.000,200.000,65278.000\n\
    2.25,1.5,0.0,300.000,2.000,2.000,6.000,4.000,7.000,300000000.250,257.000,100.000,514.000\n";

fn adapted(text: &str, to: Format) -> (Cloud, Option<String>) {
    let mut cloud = read(text.as_bytes()).expect("a cloud");
    let told = Format::TEXT.adapt(&mut cloud.attributes, to);
    (read(&written(&cloud, to)).expect("a cloud"), told)
}

fn column<'a>(cloud: &'a Cloud, name: &str) -> &'a Values {
    &cloud.attributes.iter().find(|a| a.name == name).unwrap_or_else(|| panic!("no {name}")).values
}

#[test]
fn a_table_of_pdals_fills_the_fields_of_las() {
    for compressed in [false, true] {
        let (las, told) = adapted(PDAL, Format::Las { compressed });
        assert_eq!(told, None);
        assert_eq!(column(&las, "red"), &Values::U16(vec![17_476, 257]));
        // Not of 8 bits, since the colour is not.
        assert_eq!(column(&las, "green"), &Values::U16(vec![200, 100]));
        assert_eq!(column(&las, "blue"), &Values::U16(vec![65_278, 514]));
        assert_eq!(column(&las, "intensity"), &Values::U16(vec![100, 300]));
        assert_eq!(column(&las, "return_number"), &Values::U8(vec![1, 2]));
        assert_eq!(column(&las, "number_of_returns"), &Values::U8(vec![2, 2]));
        assert_eq!(column(&las, "classification"), &Values::U8(vec![2, 6]));
        assert_eq!(column(&las, "point_source_id"), &Values::U16(vec![7, 7]));
        assert_eq!(column(&las, "gps_time"), &Values::F64(vec![300_000_000.125, 300_000_000.25]));
        assert!((column(&las, "scan_angle").get(0) + 3.0).abs() < 1e-6);
        let names: Vec<&str> = las.attributes.iter().map(|a| a.name.as_str()).collect();
        assert!(names.iter().all(|name| !name.contains(char::is_uppercase)), "extra bytes: {names:?}");
    }
    let (ply, _) = adapted(PDAL, ply(PlyEncoding::BinaryLittleEndian, Scalar::F64));
    assert_eq!(column(&ply, "red"), &Values::U16(vec![17_476, 257]));
    let (e57, _) = adapted(PDAL, Format::E57);
    assert_eq!(column(&e57, "blue"), &Values::U16(vec![65_278, 514]));
    assert_eq!(column(&e57, "timestamp"), &Values::F64(vec![300_000_000.125, 300_000_000.25]));
}

#[test]
fn only_the_time_of_gps_is_the_time_of_las() {
    for (name, field) in
        [("GpsTime", "gps_time"), ("scalar_Gps_Time", "gps_time"), ("timestamp", "timestamp")]
    {
        let (las, _) = adapted(&format!("x,y,z,{name}\n0,0,0,1.5e9\n1,0,0,1.6e9\n"), LAS);
        assert_eq!(column(&las, field), &Values::F64(vec![1.5e9, 1.6e9]), "{name}");
    }
}

#[test]
fn colours_of_8_bits_are_colours_everywhere() {
    for names in ["R,G,B", "Red,Green,Blue", "diffuse_red,diffuse_green,diffuse_blue"] {
        let text = format!("X,Y,Z,{names},Intensity\n0,0,0,68,58,254,0\n1,0,0,255,0,1,50\n");
        let ply = ply(PlyEncoding::BinaryLittleEndian, Scalar::F64);
        let (cloud, _) = adapted(&text, ply);
        assert_eq!(column(&cloud, "red"), &Values::U8(vec![68, 255]), "{names}");
        let (cloud, _) = adapted(&text, LAS);
        assert_eq!(column(&cloud, "green"), &Values::U16(vec![58 * 257, 0]), "{names}");
        assert_eq!(column(&cloud, "intensity"), &Values::U16(vec![0, 50]));
        let pcd = Format::Pcd { encoding: PcdEncoding::Ascii, scalar: Scalar::F32 };
        let (cloud, _) = adapted(&text, pcd);
        assert_eq!(column(&cloud, "blue"), &Values::U8(vec![254, 1]), "{names}");
        let bytes = written(&read(text.as_bytes()).expect("a cloud"), pcd);
        assert!(String::from_utf8_lossy(&bytes).contains("FIELDS x y z rgb "), "{names}");
        let (cloud, _) = adapted(&text, Format::E57);
        assert_eq!(column(&cloud, "red"), &Values::U8(vec![68, 255]), "{names}");
    }
}

#[test]
fn colours_from_0_to_1_become_such_from_0_to_255() {
    let text = "x,y,z,R,G,B\n0,0,0,0.5,1.0,0.0\n1,0,0,0.2,0.001,0.998\n";
    for format in [ply(PlyEncoding::Ascii, Scalar::F64), Format::E57] {
        let (cloud, told) = adapted(text, format);
        assert_eq!(column(&cloud, "red"), &Values::U8(vec![128, 51]));
        assert_eq!(column(&cloud, "green"), &Values::U8(vec![255, 0]));
        assert_eq!(column(&cloud, "blue"), &Values::U8(vec![0, 254]));
        assert!(told.is_some_and(|told| told.contains("from 0 to 255")));
    }
    let (cloud, _) = adapted(text, LAS);
    assert_eq!(column(&cloud, "red"), &Values::U16(vec![128 * 257, 51 * 257]));
    // Not where they stay as they are, nor where one is beyond.
    let text_again = Format::Xyz { names: true, separator: Separator::Comma, decimal: Decimal::Point };
    let (cloud, told) = adapted(text, text_again);
    assert_eq!((column(&cloud, "R"), told), (&Values::F64(vec![0.5, 0.2]), None));
    let (cloud, told) = adapted(&text.replace("0.998", "1.5"), ply(PlyEncoding::Ascii, Scalar::F64));
    assert_eq!((column(&cloud, "blue"), told), (&Values::F64(vec![0.0, 1.5]), None));
}
