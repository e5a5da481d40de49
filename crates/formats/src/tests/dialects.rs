//! Text as other programs write it: what the first lines decide, and what is refused.

use super::*;
use densecloud_cloud::Kind;

fn read_as(text: &str, reading: &Reading) -> Result<Cloud, FormatError> {
    CloudReader::open_as(text.as_bytes(), Limits::default(), reading)?.read()
}

fn cloud(text: &str) -> Cloud {
    read(text.as_bytes()).unwrap_or_else(|why| panic!("{text:?}: {why}"))
}

fn refusal(text: &str) -> String {
    match read(text.as_bytes()) {
        Ok(cloud) => panic!("{text:?}: {cloud:?}"),
        Err(why) => why.to_string(),
    }
}

fn column(cloud: &Cloud, name: &str) -> Vec<f64> {
    let found = cloud.attributes.iter().find(|attribute| attribute.name == name);
    let values = &found.unwrap_or_else(|| panic!("no {name}: {:?}", names(cloud))).values;
    (0..values.len()).map(|i| values.get(i)).collect()
}

fn names(cloud: &Cloud) -> Vec<&str> {
    cloud.attributes.iter().map(|attribute| attribute.name.as_str()).collect()
}

fn format(text: &str) -> Format {
    CloudReader::open(text.as_bytes(), Limits::default()).expect("a header").header().format
}

/// Written in its own format, and read again.
fn and_back(text: &str) -> (String, Cloud) {
    let read = cloud(text);
    let bytes =
        encode(Vec::new(), format(text), &read.positions, &read.attributes, &read.origin).expect("a file");
    let written = String::from_utf8(bytes).expect("UTF-8");
    let again = cloud(&written);
    assert_eq!((&again.positions, &again.attributes), (&read.positions, &read.attributes), "{written:?}");
    (written, again)
}

fn reading(options: &[(&str, &str)]) -> Reading {
    let mut reading = Reading::default();
    for (name, value) in options {
        match *name {
            "axes" => reading.axes = Some(value.parse().expect(value)),
            "separator" => reading.separator = Some(value.parse().expect(value)),
            "decimal" => reading.decimal = Some(value.parse().expect(value)),
            _ => reading.format = Some(value.parse().expect(value)),
        }
    }
    reading
}

#[test]
fn decimal_commas_are_read_where_something_else_separates() {
    let expected = [[3.129, 4.824, 21.042], [2.0, -5.5, 18.959e1]];
    for (text, separator) in [
        ("X;Y;Z\r\n3,129;4,824;21,042\r\n2;-5,5;18,959e1\r\n", Separator::Semicolon),
        ("3,129\t4,824\t21,042\n2\t-5,5\t18,959e1\n", Separator::Tab),
        ("3,129 4,824  21,042\n2 -5,5 18,959e1\n", Separator::Space),
        ("\"3,129\";\"4,824\";\"21,042\"\n\"2\";\"-5,5\";\"18,959e1\"\n", Separator::Semicolon),
        ("3,129|4,824|21,042\n2|-5,5|18,959e1\n", Separator::Bar),
        ("sep=;\nx;y;z\n3,129;4,824;21,042\n2;-5,5;18,959e1\n", Separator::Semicolon),
    ] {
        assert_eq!(cloud(text).positions, expected, "{text:?}");
        let names = text.to_lowercase().contains('x');
        assert_eq!(format(text), Format::Xyz { names, separator, decimal: Decimal::Comma }, "{text:?}");
        let (written, again) = and_back(text);
        assert!(written.contains("3,129") && !written.contains('.'), "{written:?}");
        assert_eq!(again.positions, expected);
    }
    // Decided once: a column of whole numbers does not change that.
    let mixed = cloud("1;2;3;0,5\n4;5;6;7\n");
    assert_eq!((mixed.positions[1], column(&mixed, "column 4")), ([4.0, 5.0, 6.0], vec![0.5, 7.0]));
}

#[test]
fn what_commas_mean_is_not_guessed() {
    for text in [
        "3,128,4,824,21,042\n2,754,5,221,18,959\n",
        "3,12,4,82,21,04\n2,75,5,22,18,95\n",
        "-3,128,-4,824\n2,754,5,221\n",
        "3,128,4,824\n",
        "3,1,4,8,21,04\n2,7,5,2,18,9\n",
        "400,003.128,5,600,004.824,21.041\n400,002.754,5,600,005.221,18.959\n",
        "400 003.128 5 600 004.824 21.041\n",
    ] {
        let why = refusal(text);
        assert!(why.starts_with("line 1: ") && why.contains("--separator"), "{text:?}: {why}");
    }
    // Said, it is read; and whole numbers of several lengths are no fractions.
    let separated = reading(&[("separator", "comma")]);
    let said = read_as("3,128,4,824,21,042\n", &separated).expect("a cloud");
    assert_eq!(said.positions, [[3.0, 128.0, 4.0]]);
    assert_eq!(cloud("1,2,3,255,0,7\n4,5,6,1,200,33\n").positions[1], [4.0, 5.0, 6.0]);
    assert_eq!(cloud("400003,560012,123\n400004,560013,124\n").positions[0], [400_003.0, 560_012.0, 123.0]);
    // Names say it.
    assert_eq!(cloud("x,y,z,a,b,c\n3,128,4,824,21,042\n").positions, [[3.0, 128.0, 4.0]]);
    let why = refusal("x,y,z\n3,128,4,824,21,042\n");
    assert!(why.contains("has 3 names (x, y, z), and the points have 6 columns"), "{why}");
    assert!(read_as("1,2,3\n", &reading(&[("separator", "comma"), ("decimal", "comma")])).is_err());
}

#[test]
fn separators_of_thousands_are_refused_by_name() {
    for text in [
        "1,234.5 2,345.6 3,456.7\n",
        "x;y;z\n1.234,5;2.345,6;3.456,7\n",
        "x\ty\tz\n1 234,5\t2 345,6\t3 456,7\n",
        "\"1,234.5\",\"2,345.6\",\"3,456.7\"\n",
        "x,y,z\n1.5,2.5,3.5\n\"1,234.5\",2,3\n",
        "1'234.5;2'345.6;3'456.7\n",
        "1,5;2,5;3,5\n1.234,5;2;3\n",
    ] {
        let why = refusal(text);
        assert!(why.contains("separators of thousands") && why.contains("column 1"), "{text:?}: {why}");
    }
}

#[test]
fn numbers_that_may_be_a_thousand_times_as_large_are_refused() {
    let points = |rows: std::ops::Range<u32>| -> String {
        let row = |i: u32| format!("{i};7;{}\n", i % 400);
        rows.map(row).collect()
    };
    for (text, place) in [
        (
            "999 1 2\n1.000 3 4\n".to_owned(),
            "line 2: column 1: `1.000` beside `999` in line 1: does its point",
        ),
        (
            "1.000 1 2\n-999 3 4\n".to_owned(),
            "line 1: column 1: `1.000` beside `-999` in line 2: does its point",
        ),
        ("x\ty\tz\n7\t8\t1,250\n7\t8\t3\n".to_owned(), "line 2: column 3 (z): `1,250` beside `3` in line 3"),
        ("1,2.000,3\n4,5,6\n".to_owned(), "line 1: column 2: `2.000` beside `5` in line 2"),
        ("x;y;z;n\n1500;2000;1700;12\n1500;2000;1700;1.012\n".to_owned(), "line 3: column 4 (n): `1.012`"),
        // Long after the first thousand lines.
        (
            points(1..1000) + &points(1..1000) + "1.000;7;1.400\n",
            "line 1999: column 1: `1.000` beside `1` in line 1",
        ),
    ] {
        let why = refusal(&text);
        assert!(why.starts_with(place) && why.contains("say --decimal "), "{why}");
        assert!(why.contains("separators of thousands are not read"), "{why}");
        let decimal = if place.contains(',') { "comma" } else { "point" };
        let said = read_as(&text, &reading(&[("decimal", decimal)])).expect(&text);
        assert!(said.notes.is_empty(), "{:?}", said.notes);
    }
    let quoted = refusal("x,y,z\n\"1,000\",\"2,000\",\"3,000\"\n5,6,7\n");
    assert!(quoted.starts_with("line 2: column 1: `1,000` is no number"), "{quoted}");
    let said = read_as("999 1 2\n1.000 3 4\n", &reading(&[("decimal", "comma")])).expect_err("a point");
    assert!(said.to_string().contains("if points part thousands, write numbers without them"), "{said}");
}

#[test]
fn ordinary_numbers_are_no_thousands() {
    for text in [
        "1 2.5 3\n4 5 6.125\n",
        "1 2.125 3\n1500 5.125 6\n",
        "999.000 1.000 2.000\n12.345 3.000 4.125\n",
        "1.125 2.250 3.375 200\n4.125 5.250 6.375 7\n",
        "999 1 0.5\n1.000 3 4\n",
        "999 1 1000.125\n1.125 3 4\n",
        "999 1 1.0625\n1.125 3 4\n",
        // A column that has both is no thousands', and then no other is.
        "1 2 3\n1500 2 3.125\n1.125 5 6\n",
        "x;y;z\n3,129;4,824;21,042\n2,754;0,221;18\n",
        "x y z what\n1.125 2.125 3.125 12.345\n1.125 2.125 3.125 wall\n1.125 2.125 3.125 7\n",
        "x y z what\n1.125 2.125 3.125 12.345\n1.125 2.125 3.125 7\n1.125 2.125 3.125 wall\n",
    ] {
        assert!(cloud(text).notes.is_empty(), "{text:?}");
    }
    // Nothing tells that these are no thousands but what points are like.
    let commas = cloud("3,129;4,824;21,042\n2,754;5,221;18,959\n");
    assert_eq!(commas.positions[0], [3.129, 4.824, 21.042]);
    assert_eq!(
        commas.notes,
        [
            "`3,129` (line 1, column 1) is read as 3.129, since commas seem to be decimal marks here; to say so: --decimal comma"
        ]
    );
}

#[test]
fn what_was_decided_is_held_to() {
    let points = |row: &str| row.repeat(1500);
    for (first, last, part) in [
        ("1;2;3\n", "3,5;4;5\n", "column 1: `3,5` is no number with a decimal point"),
        ("1,5;2,5;3,5\n", "3.5;4;5\n", "column 1: `3.5` is no number with a decimal comma"),
        ("1;2;3;0.5\n", "3;4;5;0,5\n", "column 4: `0,5` is no number with a decimal point"),
        ("1\t2\t3\n", "1 2 3\n", "1 column where the first points have 3, separated by a tab (--separator)"),
        ("1,2,3\n", "1,2,3,4\n", "4 columns where"),
        ("1 2 3\n", "1 2\n", "2 columns where"),
    ] {
        let why = refusal(&(points(first) + last));
        assert!(why.starts_with("line 1501: ") && why.contains(part), "{why}");
        assert_eq!(cloud(&points(first)).positions.len(), 1500);
    }
    // A word takes its column out, as before.
    let words = cloud(&(points("1;2;3;7;8\n") + "1;2;3;unknown;9\n"));
    assert_eq!((words.dropped_properties, words.attributes.len()), (vec!["column 4 (text)".to_owned()], 1));
    assert_eq!(words.attributes[0].values.len(), 1501);
}

#[test]
fn coordinates_are_found_by_their_names() {
    let table =
        cloud("PointID,Easting,Northing,Elevation,Code\n1,400003.128846,5600004.824106,21.041896,2\n");
    assert_eq!(table.positions, [[400_003.128_846, 5_600_004.824_106, 21.041_896]]);
    assert_eq!(names(&table), ["PointID", "Code"]);
    assert_eq!((column(&table, "PointID"), column(&table, "Code")), (vec![1.0], vec![2.0]));
    let paraview = "\"Temp\",\"Normals:0\",\"Normals:1\",\"Normals:2\",\"Points:0\",\"Points:1\",\"Points:2\"\n\
                    0.5,0.6,0.8,0,3.1,4.8,21\n";
    let table = cloud(paraview);
    assert_eq!(table.positions, [[3.1, 4.8, 21.0]]);
    assert_eq!(names(&table), ["Temp", "Normals:0", "Normals:1", "Normals:2"]);
    for header in
        ["z_coord y_coord x_coord", "Z(m) Y(m) X(m)", "z [m] y [m] x [m]", "//Z Y X", "# z y x", "%Z;Y;X"]
    {
        let table = cloud(&format!("{header}\n1 2 3\n"));
        assert_eq!(table.positions, [[3.0, 2.0, 1.0]], "{header}");
    }
    let table = cloud("x [m];y [m];z [m];GPS time [s]\n1;2;3;4\n");
    assert_eq!((table.positions[0], names(&table)), ([1.0, 2.0, 3.0], vec!["GPS time [s]"]));
    let degrees = cloud("lat,lon,alt\n48.1,11.5,520\n");
    assert_eq!(degrees.positions, [[11.5, 48.1, 520.0]]);
    assert!(degrees.notes[0].contains("degrees are no metres"), "{:?}", degrees.notes);
}

#[test]
fn names_that_do_not_fit_are_an_error_that_lists_them() {
    let why = refusal("PC1,PC2,PC3\n1,2,3\n");
    assert_eq!(
        why,
        "line 1: none of the names PC1, PC2, PC3 says which columns are x, y and z; say it: --axes A,B,C (names, or \
         numbers from 1)"
    );
    let said = |axes: &str| read_as("PC1,PC2,PC3,PC4\n1,2,3,4\n", &reading(&[("axes", axes)]));
    assert_eq!(said("pc4,PC1,PC2").expect("a cloud").positions, [[4.0, 1.0, 2.0]]);
    assert_eq!(said("4,PC1,2").expect("a cloud").positions, [[4.0, 1.0, 2.0]]);
    assert_eq!(names(&said("2,3,4").expect("a cloud")), ["PC1"]);
    let why = said("a,b,c").expect_err("no a").to_string();
    assert_eq!(why, "line 1: --axes: there is no column `a`; there are PC1, PC2, PC3, PC4");
    let why = read_as("1 2 3\n", &reading(&[("axes", "2,3,4")])).expect_err("three").to_string();
    assert_eq!(why, "line 1: --axes: there is no column 4; there are 3");
    let unnamed = read_as("7 1 2 3\n8 4 5 6\n", &reading(&[("axes", "2,3,4")])).expect("a cloud");
    assert_eq!((unnamed.positions[1], column(&unnamed, "column 1")), ([4.0, 5.0, 6.0], vec![7.0, 8.0]));
    let why = refusal("x,y,z,X,Y,Z\n1,2,3,4,5,6\n");
    assert!(why.contains("x, X may all be the coordinate x"), "{why}");
    // Words between blanks are no names of columns unless there are as many.
    for (header, count) in [("X Y Z GPS Time", 4), ("# id x y z (m) i", 4), ("x y z", 4)] {
        let row = "1 ".repeat(count);
        let why = refusal(&format!("{header}\n{row}\n"));
        assert!(why.contains("names (") && why.contains(&format!("have {count} columns")), "{header}: {why}");
    }
    let aside = read_as("X Y Z GPS Time\n1 2 3 4\n", &reading(&[("axes", "1,2,3")])).expect("a cloud");
    assert_eq!((names(&aside), aside.notes.len()), (vec!["column 4"], 1));
}

#[test]
fn names_of_several_words_are_one_each() {
    let text = "X,Y,Z,GPS Time,Scan Angle,Class\n-1.8712,-2.1759,1.0419,1000.5,-3,2\n";
    let (written, table) = and_back(text);
    assert_eq!(names(&table), ["GPS Time", "Scan Angle", "Class"]);
    assert_eq!((column(&table, "GPS Time"), column(&table, "Class")), (vec![1000.5], vec![2.0]));
    assert_eq!(written, text);
    let cloud_compare =
        "//X;Y;Z;Rf;Gf;Bf;Illuminance (PCV);Classification\n2\n1;2;3;0.25;0.5;1;7;6\n4;5;6;0;0;0;8;6\n";
    for (text, prefix) in [(cloud_compare.to_owned(), "//"), (cloud_compare[2..].to_owned(), "")] {
        let (written, table) = and_back(&text);
        assert_eq!(names(&table), ["Rf", "Gf", "Bf", "Illuminance (PCV)", "Classification"]);
        assert_eq!(column(&table, "Classification"), [6.0, 6.0]);
        assert!(table.notes.is_empty(), "{:?}", table.notes);
        let header = format!("{prefix}X;Y;Z;Rf;Gf;Bf;Illuminance (PCV);Classification\n1.0;2.0;3.0;0.25;");
        assert!(written.starts_with(&header), "{written}");
    }
    let (written, table) = and_back("# x y z r g b label\n3.5 4 21 68 58 254 2\n");
    assert_eq!(names(&table), ["r", "g", "b", "label"]);
    assert!(written.starts_with("# x y z r g b label\n3.5 "), "{written}");
    let (written, _) = and_back("\"X\" \"Y\" \"Z\" \"GPS Time\"\n1.5 2 3 4\n");
    assert!(written.starts_with("\"X\" \"Y\" \"Z\" \"GPS Time\"\n"), "{written}");
}

#[test]
fn names_that_are_missing_or_come_twice_are_made_and_told() {
    let pandas = cloud(",x,y,z,label\n0,3.5,4.5,21,2\n1,2.5,5.5,18,6\n");
    assert_eq!((names(&pandas), pandas.positions[1]), (vec!["index", "label"], [2.5, 5.5, 18.0]));
    assert_eq!(pandas.notes, ["column 1 has no name; it is called `index`"]);
    let twice = cloud("x,y,z,label,label,label_2\n1,2,3,4,5,6\n");
    assert_eq!(names(&twice), ["label", "label_3", "label_2"]);
    assert_eq!(twice.notes, ["column 5 has the name `label` of an earlier one; it is called `label_3`"]);
    // pandas numbers columns without names: that is no point.
    let counted = cloud("0,1,2,3\n1.5,2.5,3.5,7\n4.5,5.5,6.5,8\n");
    assert_eq!((counted.positions.len(), column(&counted, "column 4")), (2, vec![7.0, 8.0]));
    assert!(counted.notes[0].contains("counts the columns"), "{:?}", counted.notes);
    let indexed = cloud(",0,1,2\n0,1.5,2.5,3.5\n1,4.5,5.5,6.5\n");
    assert_eq!((indexed.positions, indexed.attributes.len()), (vec![[1.5, 2.5, 3.5], [4.5, 5.5, 6.5]], 1));
    assert_eq!(cloud("0,1,2\n3,4,5\n6,7,8\n").positions.len(), 3, "whole numbers are points");
}

#[test]
fn titles_comments_and_ends_are_no_points() {
    for text in [
        "Survey of the old mill\nDate: 2020-01-02\n\nx;y;z\n1,5;2,5;3,5\n4;5;6\n",
        "My survey,,\n,,\nx,y,z\n[m],[m],[m]\n1.5,2.5,3.5\n4,5,6\n",
        "# made by hand\n# x y z in metres\n1.5 2.5 3.5\n4 5 6\n",
        "; made by hand\n; X Y Z\n1.5 2.5 3.5\n4 5 6\n",
        "1.5 2.5 3.5\n4 5 6\n\x1a",
        "1.5 2.5 3.5\n4 5 6\x1a",
        "1.5,2.5,3.5,\r\n4,5,6,\r\n\r\n",
        "x,y,z,\n1.5,2.5,3.5,\n4,5,6,\n",
        "sep=,\r\nX,Y,Z\r\n1.5,2.5,3.5\r\n4,5,6\r\n",
        "1.5 2.5 3.5 # first\n% between\n4 5 6 // second\n",
        "\"1.5\",\"2.5\",\"3.5\"\n\"4\",\"5\",\"6\"\n",
        "x,y,z\n1.5,2.5,3.5\n\"4\",5,6\n",
    ] {
        let found = cloud(text);
        assert_eq!(found.positions, [[1.5, 2.5, 3.5], [4.0, 5.0, 6.0]], "{text:?}");
        assert!(found.attributes.is_empty(), "{text:?}");
    }
    let words = cloud("x,y,z,what,n\n1,2,3,\"a, \"\"b\"\"\",7\n4,5,6,#5,8\n");
    assert_eq!((names(&words), words.dropped_properties.join(",")), (vec!["n"], "what (text)".to_owned()));
}

#[test]
fn comments_that_tell_numbers_name_no_columns() {
    let points = "1.5 2.5 3.5 7 8 9 10\n4 5 6 7 8 9 10\n";
    for mark in ["#", "%", "//"] {
        let found = cloud(&format!("{mark} min x y z: 1.5 2.5 3.5\n{mark} max x y z: 4 5 6\n{points}"));
        assert_eq!(found.positions, [[1.5, 2.5, 3.5], [4.0, 5.0, 6.0]], "{mark}");
        assert_eq!(names(&found), names(&cloud(points)), "{mark}");
    }
    let told = cloud("# y: 1 x: 2 z: 3\n1.5 2.5 3.5 4 5 6\n");
    assert_eq!(told.positions, [[1.5, 2.5, 3.5]]);
}

#[test]
fn what_stands_before_all_names_is_none_of_them() {
    let found = cloud("# columns: y x z\n2.5 1.5 3.5\n");
    assert_eq!(found.positions, [[1.5, 2.5, 3.5]]);
    let fewer = cloud("# columns: x y z\n1.5 2.5 3.5 4.5\n");
    assert_eq!((fewer.positions[0], names(&fewer)), ([1.5, 2.5, 3.5], vec!["column 4"]));
    let why = refusal("# columns: z y x\n1.5 2.5 3.5 4.5\n");
    assert!(why.contains("3 names (z, y, x), and the points have 4 columns"), "{why}");
}

#[test]
fn names_behind_a_mark_that_name_no_coordinates_are_refused() {
    let text =
        "# frame 0\n# TIMESTAMP (ns), RANGE (mm), X1 (mm), Y1 (mm), Z1 (mm)\n170,5,1,2,3\n171,5,4,5,6\n";
    assert!(refusal(text).contains("says which columns are x, y and z; say it: --axes"), "{}", refusal(text));
    let reading = Reading { axes: Some("3,4,5".parse().expect("axes")), ..Reading::default() };
    assert_eq!(read_as(text, &reading).expect("a cloud").positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
}

#[test]
fn empty_coordinates_are_no_numbers() {
    let table = cloud("x,y,z,intensity\n,,,0\n2.5,5.5,18,1\n,1,2,3\n");
    assert!(table.positions[0].iter().all(|c| c.is_nan()));
    assert_eq!(table.positions[1], [2.5, 5.5, 18.0]);
    assert!(table.positions[2][0].is_nan() && table.positions[2][1..] == [1.0, 2.0]);
    assert_eq!(column(&table, "intensity"), [0.0, 1.0, 3.0]);
    let words = cloud("x,y,z,what,n\n,,,wall,7\n1,2,3,roof,8\n");
    assert_eq!((words.positions.len(), column(&words, "n")), (2, vec![7.0, 8.0]));
    let void = cloud("x,y,z\n,,\n1,2,3\n,,\n");
    assert_eq!((void.positions.len(), void.positions[1]), (3, [1.0, 2.0, 3.0]));
    let absent = cloud("x,y,z,w\n1,2,3,NA\nNA,NA,NA,5\n");
    assert!(absent.positions[1][0].is_nan() && column(&absent, "w")[0].is_nan());
    assert_eq!(column(&absent, "w")[1], 5.0);
}

#[test]
fn clouds_one_after_another_are_all_read() {
    let two = cloud("2\n1 2 3 -5 9 8 7\n4 5 6 -6 9 8 7\n1\n7 8 9 -7 6 5 4\n");
    assert_eq!(two.positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]);
    assert_eq!(names(&two), ["intensity", "red", "green", "blue", "scan"]);
    assert_eq!(column(&two, "scan"), [0.0, 0.0, 1.0]);
    assert_eq!(column(&two, "intensity"), [-5.0, -6.0, -7.0]);
    assert_eq!(two.notes, ["the file has 2 clouds; `scan` numbers them from 0"]);
    let one = cloud("2\n1 2 3 7\n4 5 6 8\n");
    assert_eq!((names(&one), one.notes.len()), (vec!["column 4"], 0));
    for (text, notes) in [
        ("3\n1 2 3\n4 5 6\n", &["line 1 counts 3 points, and 2 follow it; all of them are read"][..]),
        ("1\n1 2 3\n4 5 6\n", &["line 1 counts 1 points, and 2 follow it; all of them are read"]),
        (
            "1\n1 2 3\n3\n4 5 6\n",
            &[
                "the file has 2 clouds; `scan` numbers them from 0",
                "line 3 counts 3 points, and 1 follow it; all of them are read",
            ],
        ),
    ] {
        let off = cloud(text);
        assert_eq!(
            (off.positions.len(), off.notes),
            (if text.len() < 10 { 1 } else { 2 }, notes.iter().map(|note| (*note).to_owned()).collect()),
            "{text:?}"
        );
    }
    // A line of one number is no point where nothing is counted.
    assert!(refusal("1 2 3\n4 5 6\n2\n7 8 9\n7 8 9\n").starts_with("line 3: 1 column"));
    let empty_first = cloud("0\n2\n1 2 3 4\n4 5 6 4\n");
    assert_eq!((empty_first.positions.len(), empty_first.notes.len()), (2, 0));
}

#[test]
fn a_table_of_colmap_is_no_other_table() {
    let head = "# 3D point list with one line of data per point:\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as \
                (IMAGE_ID, POINT2D_IDX)\n# Number of points: 2\n";
    let text = format!(
        "{head}1 -1.8 -2.1 1.0 10 20 30 0.5 0 0 1 7 2 14\n2 -2.2 -1.7 -1.0 10 20 30 0.5 0 0 1 7 2 14\n"
    );
    assert_eq!(cloud(&text).positions[0], [-1.8, -2.1, 1.0]);
    let why = read_as(&text, &reading(&[("format", "text")])).expect_err("a track").to_string();
    assert!(why.contains("POINT3D_ID"), "{why}");
}

#[test]
fn options_say_what_the_lines_do_not() {
    let text = "1;2;3\n4;5;6\n";
    assert_eq!(
        read_as(text, &reading(&[("decimal", "comma")])).expect("a cloud").positions[1],
        [4.0, 5.0, 6.0]
    );
    let why =
        read_as(text, &reading(&[("separator", "comma"), ("decimal", "point")])).expect_err("semicolons");
    assert_eq!(
        why.to_string(),
        "line 1: no line has three numbers by --separator comma and --decimal point; this one is `1;2;3`"
    );
    let why = read_as("1,5,2,5\n", &reading(&[("decimal", "comma")])).expect_err("no separator").to_string();
    assert!(why.contains("by --decimal comma"), "{why}");
    let atoms = "2\nwater\nO 1.5 2.5 3.5\nH 2.5 3.5 4.5\n";
    let why = refusal(atoms);
    assert!(
        why.starts_with("line 3: column 1: `O` is not a number; ") && why.contains("--axes A,B,C"),
        "{why}"
    );
    let said = read_as(atoms, &reading(&[("axes", "2,3,4")])).expect("a cloud");
    assert_eq!(said.positions, [[1.5, 2.5, 3.5], [2.5, 3.5, 4.5]]);
    let named = read_as(text, &reading(&[("format", "text")])).expect("a cloud");
    assert_eq!(named.positions.len(), 2);
    let why = read_as(text, &reading(&[("format", "ply")])).expect_err("no PLY").to_string();
    assert!(!why.is_empty());
    // Another format says so itself, and that is told.
    let bytes = write(&[[1.0, 2.0, 3.0]], ply(PlyEncoding::Ascii, Scalar::F64));
    let options = reading(&[("axes", "3,2,1"), ("decimal", "comma")]);
    let cloud = CloudReader::open_as(&bytes[..], Limits::default(), &options).and_then(CloudReader::read);
    let cloud = cloud.expect("a cloud");
    assert_eq!(cloud.positions, [[1.0, 2.0, 3.0]]);
    assert_eq!(cloud.notes, ["--axes, --decimal: for text; this is PLY (ascii, 64-bit), and tells its own"]);
}

#[test]
fn text_in_latin_1_keeps_its_names() {
    let table = read(b"Rechtswert;Hochwert;H\xF6he;Gr\xFCn\n1;2;3;4\n").expect("a cloud");
    assert_eq!((table.positions[0], names(&table)), ([1.0, 2.0, 3.0], vec!["Grün"]));
    let why = read(b"x\0 \0y\0 \0z\0\n\0").expect_err("UTF-16 without a mark").to_string();
    assert!(why.contains("UTF-16"), "{why}");
}

#[test]
fn names_are_written_so_that_they_are_read_again() {
    let attribute = |name: &str| Attribute { name: name.into(), values: Values::U8(vec![7]) };
    let attributes =
        ["a,b", "say \"h\"", "X", "GPS Time", "height", "", "a,b", "line\nend", "'c'"].map(attribute);
    for separator in
        [Separator::Comma, Separator::Semicolon, Separator::Tab, Separator::Bar, Separator::Space]
    {
        let format = Format::Xyz { names: true, separator, decimal: Decimal::Point };
        let origin = densecloud_cloud::Origin::default();
        let file = encode(Vec::new(), format, &[[1.0, 2.0, 3.0]], &attributes, &origin).expect("a file");
        let again = read(&file)
            .unwrap_or_else(|why| panic!("{separator}: {why}: {}", String::from_utf8_lossy(&file)));
        assert_eq!(again.positions, [[1.0, 2.0, 3.0]], "{separator}");
        let expected = if separator == Separator::Space {
            ["a_b", "say__h_", "X_2", "GPS_Time", "height", "column", "a_b_2", "line_end", "'c'"]
        } else {
            ["a,b", "say \"h\"", "X_2", "GPS Time", "height", "column", "a,b_2", "line end", "'c'"]
        };
        assert_eq!(names(&again), expected, "{separator}");
        assert!(again.attributes.iter().all(|a| a.values.kind() == Kind::U8 && a.values.get(0) == 7.0));
        let told = format.renamed(&attributes, &origin);
        assert!(told.contains(&("X".to_owned(), "X_2".to_owned())), "{told:?}");
    }
}

#[test]
fn results_keep_the_marks_of_their_input() {
    let comma = Format::Xyz { names: true, separator: Separator::Tab, decimal: Decimal::Comma };
    let csv = Format::from_media_type("text/csv");
    let expected = Format::Xyz { names: true, separator: Separator::Semicolon, decimal: Decimal::Comma };
    assert_eq!(Format::of_result(csv, comma, false), expected);
    assert_eq!(expected.media_type(), "text/csv; charset=utf-8");
    assert_eq!(Format::of_result(Some(Format::TEXT), comma, false), comma);
    let semicolons = Format::Xyz { names: true, separator: Separator::Semicolon, decimal: Decimal::Point };
    assert_eq!(
        Format::of_result(csv, semicolons, false),
        Format::Xyz { names: true, separator: Separator::Comma, decimal: Decimal::Point }
    );
}

#[test]
fn ten_thousand_comments_before_the_points_are_no_matter() {
    let comments: String =
        (0..10_000).map(|i| format!("# line {i} of a long story about nothing\n")).collect();
    let text = format!("{comments}# z y x\n1 2 3\n4 5 6\n");
    assert_eq!(cloud(&text).positions, [[3.0, 2.0, 1.0], [6.0, 5.0, 4.0]]);
}

#[test]
fn whole_numbers_before_three_fractions_may_be_no_coordinates() {
    let rows = |write: &dyn Fn(usize, f64) -> String| -> String {
        (1..20).map(|i| write(i, 0.25 + i as f64)).collect()
    };
    let labelled: [&dyn Fn(usize, f64) -> String; 3] = [
        &|i, at| format!("{i},{},{},{at}\n", 477_030.0 + at, 4_366_568.0 - at),
        &|_, at| format!("2 {at} {} {}\n", -at, 3.0 * at),
        &|i, at| format!("{i};{at};{at};{at};TREE\n"),
    ];
    for write in labelled {
        let text = rows(write);
        assert!(refusal(&text).contains("Say --axes 2,3,4, or --axes 1,2,3"), "{}", refusal(&text));
        for (axes, is_label) in [("2,3,4", false), ("1,2,3", true)] {
            let reading = Reading { axes: Some(axes.parse().expect("axes")), ..Reading::default() };
            let found = read_as(&text, &reading).expect("a cloud").positions[0][0];
            assert_eq!(found.fract() == 0.0, is_label, "{axes}: {found}");
        }
    }
    // Coordinates in whole metres, beside anything; three columns alone; names; and few points.
    for text in [
        rows(&|i, at| format!("{i} {} 5 {at} {at}\n", 2 * i)),
        rows(&|i, at| format!("{i} {at} {at}\n")),
        format!("x y z a\n{}", rows(&|i, at| format!("{i} {at} {at} {at}\n"))),
        "1 2.5 3.5 4.5\n".into(),
    ] {
        assert_eq!(cloud(&text).positions[0][0], 1.0, "{text}");
    }
}
