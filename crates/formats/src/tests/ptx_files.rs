//! PTX as Leica's programs write it.

use proptest::prelude::*;

use super::*;

/// A scan's header: 2 columns and 2 rows at a place, turned by a quarter about z.
const HEADER: &str = "2\n2\n100 200 5\n0 1 0\n-1 0 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n100 200 5 1\n";

/// The same at the origin, not turned.
const PLAIN: &str = "2\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";

const ROWS: &str = "1 2 3 0.25 255 0 7\n0 0 0 0.5 0 0 0\n-4 0.5 0 1 1 2 3\n0.000000 0.0 -0 0.5 9 9 9\n";

fn names(cloud: &Cloud) -> Vec<&str> {
    cloud.attributes.iter().map(|a| a.name.as_str()).collect()
}

#[test]
fn a_scan_is_where_its_pose_puts_it() {
    let text = format!("{HEADER}{ROWS}");
    let reader = CloudReader::open(Drip(text.as_bytes()), Limits::default()).expect("a header");
    assert_eq!((reader.header().format, reader.header().points), (Format::Ptx, None));
    let cloud = reader.read().expect("a cloud");
    // The scan's x is along y, its y against x.
    assert_eq!(cloud.positions, [[98.0, 201.0, 8.0], [99.5, 196.0, 5.0]]);
    assert_eq!(names(&cloud), ["intensity", "red", "green", "blue"]);
    assert_eq!(cloud.attributes[0].values, Values::F64(vec![0.25, 1.0]));
    assert_eq!(cloud.attributes[1].values, Values::U8(vec![255, 1]));
    assert_eq!(cloud.attributes[3].values, Values::U8(vec![7, 3]));
    assert_eq!((cloud.origin.sensor, cloud.origin.sensors), (Some([100.0, 200.0, 5.0]), None));
    assert_eq!(cloud.notes, ["2 of 4 points are 0 0 0, where nothing came back: left out"]);
    assert!(cloud.dropped_properties.is_empty());
}

#[test]
fn published_numbers_come_out_as_published() {
    // The matrix and points of rapidlasso's page on PTX, and the coordinates that LAStools and CloudCompare make of them.
    let text = "2\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n-0.955179 0.296021 -0.002106 0.0\n-0.296023 -0.955180 0.001152 0.0\n\
                -0.001670 0.001724 0.999997 0.0\n3.847211 12.235314 -0.425777 1.0\n1.111111 2.111111 3.111 0.111\n\
                1.666666 2.666666 3.666 0.678\n";
    let cloud = read(text.as_bytes()).expect("a cloud");
    for (position, published) in cloud.positions.iter().zip([[2.156, 10.553, 2.685], [1.460, 10.188, 3.240]])
    {
        for (ours, theirs) in position.iter().zip(published) {
            assert!((ours - theirs).abs() < 0.0006, "{ours} and {theirs}");
        }
    }
}

#[test]
fn scans_are_numbered_and_each_has_a_sensor() {
    let blank_lines_and_returns =
        format!("{HEADER}{ROWS}\n{PLAIN}7 8 9 0.5\n\n1 1 1 0.25\n\x1A\n").replace('\n', "\r\n");
    for text in [format!("{HEADER}{ROWS}{PLAIN}7 8 9 0.5\n1 1 1 0.25\n"), blank_lines_and_returns] {
        let cloud = read(text.as_bytes()).expect("a cloud");
        assert_eq!(cloud.positions[2..], [[7.0, 8.0, 9.0], [1.0, 1.0, 1.0]]);
        assert_eq!(names(&cloud), ["intensity", "red", "green", "blue", "color_invalid", "scan"]);
        assert_eq!(cloud.attributes[0].values, Values::F64(vec![0.25, 1.0, 0.5, 0.25]));
        assert_eq!(cloud.attributes[5].values, Values::U8(vec![0, 0, 1, 1]));
        assert_eq!(cloud.origin.sensor, None);
        let sensors = cloud.origin.sensors.as_deref().expect("sensors");
        assert_eq!(sensors.attribute, "scan");
        assert_eq!(sensors.places, [Some([100.0, 200.0, 5.0]), Some([0.0; 3])]);
        assert_eq!((sensors.of(0.0), sensors.of(2.0), sensors.of(0.5)), (sensors.places[0], None, None));
        let lost = |name: &str| {
            let format = Format::from_extension(name.as_ref()).expect(name);
            format.cannot_hold(&cloud.attributes, &cloud.origin)
        };
        assert_eq!(
            (lost("a.ply"), lost("a.pcd")),
            (vec!["the sensor's place".into()], vec!["the sensors' places".into()])
        );
        assert!(lost("a.e57").is_empty());
    }
}

#[test]
fn a_colour_that_is_absent_is_flagged() {
    let text = format!("{PLAIN}7 8 9 0.5\n1 1 1 0.25\n{HEADER}{ROWS}");
    let cloud = read(text.as_bytes()).expect("a cloud");
    assert_eq!(names(&cloud), ["intensity", "red", "green", "blue", "color_invalid", "scan"]);
    assert_eq!(cloud.attributes[1].values, Values::U8(vec![0, 0, 255, 1]));
    assert_eq!(cloud.attributes[4].values, Values::U8(vec![1, 1, 0, 0]));
    // Leica's programs write black where the camera saw nothing.
    let text = format!("{HEADER}{}", ROWS.replace("1 2 3\n0.0", "0 0 0\n0.0"));
    let cloud = read(text.as_bytes()).expect("a cloud");
    assert_eq!(names(&cloud), ["intensity", "red", "green", "blue", "color_invalid"]);
    assert_eq!(cloud.attributes[4].values, Values::U8(vec![0, 1]));
    // Where no scan has colours, there is none to be absent.
    let cloud = read(format!("{PLAIN}7 8 9 0.5\n1 1 1 0.25\n").as_bytes()).expect("a cloud");
    assert_eq!(names(&cloud), ["intensity"]);
}

#[test]
fn a_scan_that_is_registered_already_has_its_sensor_where_its_header_says() {
    let text = PLAIN.replacen("0 0 0\n", "10 20 30\n", 1) + "7 8 9\n1 1 1\n";
    let cloud = read(text.as_bytes()).expect("a cloud");
    assert_eq!((cloud.positions[0], cloud.origin.sensor), ([7.0, 8.0, 9.0], Some([10.0, 20.0, 30.0])));
    assert!(cloud.attributes.is_empty() && cloud.notes.is_empty());
}

#[test]
fn what_is_wrong_names_its_line() {
    let whole = format!("{HEADER}{ROWS}");
    for (text, told) in [
        (
            whole.replace("-4 0.5 0 1 1 2 3\n", ""),
            "the data end at line 13: scan 0 counts 2 x 2 points, and 3 are there",
        ),
        (
            format!("{HEADER}{}{PLAIN}", &ROWS[..ROWS.len() - 25]),
            "line 14: 1 number where the scan's other points have 7",
        ),
        (
            format!("{whole}1 2 3 0.5 1 1 1\n"),
            "line 15: `1 2 3 0.5 1 1 1` where a scan's number of columns was expected",
        ),
        (whole.replace("0.25 255", "0.25 red"), "line 11: `red` is not a number"),
        (whole.replace("1 2 3 0.25 255 0 7", "1 2 3 0.25 255"), "line 11: 5 numbers; a point has 3, 4"),
        (whole.replace("-4 0.5", "-4 a.5"), "line 13: `a.5` is not a number"),
        (whole.replacen("0 1 0 0\n", "0 1 0\n", 1), "line 7: `0 1 0` where row 1 of the scan's matrix"),
        // Columns in place of rows.
        (
            whole.replace(
                "0 1 0 0\n-1 0 0 0\n0 0 1 0\n100 200 5 1",
                "0 -1 0 100\n1 0 0 200\n0 0 1 5\n0 0 0 1",
            ),
            "must be 0 0 0 1",
        ),
        (
            whole.replacen("0 1 0 0\n-1 0 0 0\n", "0 0 0 0\n-1 0 0 0\n", 1),
            "line 10: the scan's matrix makes a plane",
        ),
        (whole.replacen("0 1 0 0\n", "0 nan 0 0\n", 1), "not finite"),
        (format!("-{whole}"), "line 1: 1 column"),
        (format!("99999999999\n999999999\n{}", &whole[4..]), "columns and 999999999 rows"),
        (
            HEADER[..HEADER.find("0 1 0 0").unwrap()].to_owned(),
            "the data end at line 6: row 1 of the scan's matrix",
        ),
    ] {
        let error = read(text.as_bytes()).expect_err(told).to_string();
        assert!(error.contains(told), "{error}");
    }
    let all_empty = format!("{PLAIN}0 0 0 0.5\n0 0 0 0.5\n");
    assert!(matches!(read(all_empty.as_bytes()), Err(FormatError::Empty("points"))));
}

#[test]
fn every_cut_is_an_error() {
    let text = format!("{HEADER}{ROWS}{PLAIN}7 8 9 0.5\n1 1 1 0.25\n");
    for end in 0..text.len() - 1 {
        // Between two scans a file may end, and within the last number.
        let is_whole =
            end == HEADER.len() + ROWS.len() || end + 1 == HEADER.len() + ROWS.len() || end + 4 >= text.len();
        assert!(is_whole || read(&text.as_bytes()[..end]).is_err(), "cut at {end}");
    }
}

#[test]
fn limits_hold_and_blocks_are_the_whole() {
    let rows: String = (1..=300).map(|i| format!("{i} 1 2 0.5\n")).collect();
    let scan = format!("300\n1\n{}{rows}", &PLAIN[4..]);
    let text = scan.repeat(3);
    let limits = Limits { max_points: Some(899), max_bytes: None };
    let error = CloudReader::open(text.as_bytes(), limits).expect("a header").read();
    assert!(matches!(error, Err(FormatError::TooManyPoints { points: 900, limit: 899 })));
    let whole = read(text.as_bytes()).expect("a cloud");
    let mut reader = CloudReader::open(text.as_bytes(), Limits::default()).expect("a header");
    let (mut block, mut positions): (_, Vec<Position>) = (Block::default(), Vec::new());
    while reader.next_block(250, &mut block).expect("a block") {
        assert!(block.positions.len() <= 250 && block.columns.len() == 6);
        positions.extend(&block.positions);
    }
    let ending = reader.finish().expect("an ending");
    assert!(positions == whole.positions && positions.len() == 900);
    let kept: Vec<bool> = ending.columns.iter().map(Option::is_some).collect();
    assert_eq!(kept, [true, false, false, false, false, true]);
}

#[test]
fn other_text_is_not_taken_for_it_and_results_are_ply() {
    fn format_of(text: &str) -> Result<Format, FormatError> {
        CloudReader::open(text.as_bytes(), Limits::default()).map(|r| r.header().format)
    }
    assert!(matches!(format_of("3\n1 2 3\n4 5 6\n7 8 9\n"), Ok(Format::Xyz { .. })));
    assert_eq!(Format::from_extension("a.PTX".as_ref()), Some(Format::Ptx));
    assert_eq!(Format::Ptx.written(), ply(PlyEncoding::BinaryLittleEndian, Scalar::F64));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.ptx");
    std::fs::write(&path, "1 2 3\n4 5 6\n").expect("a file");
    let error = read_cloud_file(&path).expect_err("no scan").to_string();
    assert!(error.contains("does not begin with a scan's header"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn damage_never_panics(damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let mut bytes = format!("{HEADER}{ROWS}{PLAIN}7 8 9 0.5\n1 1 1 0.25\n").into_bytes();
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.positions.len() <= 6);
        }
    }
}
