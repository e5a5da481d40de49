//! Text clouds and text PLY: every spelling that is taken.

use super::*;

fn xyz(text: &str) -> (Header, Vec<Position>) {
    let reader = CloudReader::open(text.as_bytes(), Limits::default()).expect("a header");
    let header = reader.header().clone();
    (header, reader.read().expect("a cloud").positions)
}

#[test]
fn columns_may_be_separated_in_many_ways() {
    for text in [
        "1 2 3\n4 5 6\n",
        "1,2,3\r\n4,5,6\r\n",
        "1; 2; 3\n4 ;5 ;6",
        "\u{FEFF}  1\t2\t3\n\n\n4 5 6\n\n",
        "# a comment\n1 2 3 # one\n// another\n4 5 6 // two\n",
        "1 2 3\r4 5 6\r",
        "2\n1 2 3\n4 5 6\n",
        "x y z\n1 2 3\n4 5 6\n",
        "X,Y,Z\n1,2,3\n4,5,6\n",
        "1e0 .2e1 3.\n+4 5 6\n",
    ] {
        let (header, positions) = xyz(text);
        assert_eq!(positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{text:?}");
        let names = text.starts_with(['x', 'X']);
        let separator = match text {
            _ if text.contains(',') => Separator::Comma,
            _ if text.contains(';') => Separator::Semicolon,
            _ => Separator::Space,
        };
        assert_eq!(header.format, Format::Xyz { names, separator, decimal: Decimal::Point });
        assert!(header.dropped_properties.is_empty());
        assert_eq!(header.points, text.starts_with('2').then_some(2));
    }
}

#[test]
fn other_columns_are_attributes() {
    let (header, positions) = xyz("1 2 3 0.5 wall\n4 5 6 0.5 roof\n");
    assert_eq!(header.attributes, ["column 4", "column 5"]);
    assert_eq!(positions.len(), 2);
    let (header, positions) = xyz("easting,northing,height,class\n1,2,3,4\n");
    assert_eq!(header.attributes, ["class"]);
    assert_eq!(positions, [[1.0, 2.0, 3.0]]);
    let text =
        "id;\"X\";\"Y\";\"Z\";class;time\n-7;1;2;3;wall;9007199254740993\n2.5;4;5;6;roof;1\n;7;8;9;;\n";
    let cloud = read(text.as_bytes()).expect("a cloud");
    assert_eq!(cloud.positions[2], [7.0, 8.0, 9.0]);
    assert_eq!(cloud.dropped_properties, ["class (text)"]);
    let [id, time] = &cloud.attributes[..] else { panic!("{:?}", cloud.attributes) };
    assert_eq!((id.name.as_str(), time.name.as_str()), ("id", "time"));
    // Nothing stands where the third row's values should.
    for (column, first) in [(id, -7.0), (time, 9_007_199_254_740_992.0)] {
        assert_eq!(column.values.get(0), first);
        assert!(column.values.get(2).is_nan());
    }
    assert_eq!(
        cloud.notes,
        [
            "`time` has whole numbers beyond 2^53, and not all of it are 64-bit integers: it is read as floats, and the last \
          digits of these are rounded"
        ]
    );
    let whole = read(b"1 2 3 9007199254740993\n4 5 6 -1\n").expect("a cloud");
    assert_eq!(whole.attributes[0].values, Values::I64(vec![9_007_199_254_740_993, -1]));
}

#[test]
fn whole_numbers_of_64_bits_are_kept_to_the_last_digit() {
    let rows = |column: &[&str]| -> Cloud {
        let text: String = column.iter().map(|field| format!("1;2;3;{field}\n")).collect();
        read(("x;y;z;id\n".to_owned() + &text).as_bytes()).expect("a cloud")
    };
    let kept = |column: &[&str]| {
        let cloud = rows(column);
        assert!(cloud.notes.is_empty(), "{:?}", cloud.notes);
        cloud.attributes[0].values.clone()
    };
    assert_eq!(kept(&["18446744073709551615", "0"]), Values::U64(vec![u64::MAX, 0]));
    assert_eq!(kept(&["7", "9223372036854775808"]), Values::U64(vec![7, 1 << 63]));
    assert_eq!(kept(&["9223372036854775807", "-3"]), Values::I64(vec![i64::MAX, -3]));
    assert_eq!(kept(&["9007199254740992", "0.5"]), Values::F64(vec![9_007_199_254_740_992.0, 0.5]));
    assert_eq!(kept(&["0.5", "1e300"]), Values::F64(vec![0.5, 1e300]));
    for column in [
        &["9223372036854775808", "-3"][..],
        &["-3", "9223372036854775808"],
        &["9007199254740993", ""],
        &["", "9007199254740993"],
        &["7", "18446744073709551616"],
        &["18446744073709551615", "0.5"],
        &["-9007199254740993", "0.5"],
    ] {
        let cloud = rows(column);
        assert!(matches!(cloud.attributes[0].values, Values::F64(_)));
        assert!(cloud.notes.len() == 1 && cloud.notes[0].starts_with("`id` has whole"), "{:?}", cloud.notes);
    }
    // In blocks, too, and back.
    let text = b"1 2 3 7\n4 5 6 18446744073709551615\n7 8 9 8\n";
    let mut reader = CloudReader::open(&text[..], Limits::default()).expect("a header");
    let mut block = Block::default();
    for expected in [Values::I64(vec![7]), Values::U64(vec![u64::MAX]), Values::U64(vec![8])] {
        assert!(reader.next_block(1, &mut block).expect("a block"));
        assert_eq!(block.columns, [expected]);
    }
    let ids = read(text).expect("a cloud");
    for format in [Format::TEXT, ply(PlyEncoding::Ascii, Scalar::F32), Format::Las { compressed: false }] {
        let bytes = encode(Vec::new(), format, &ids.positions, &ids.attributes, &ids.origin).expect("a file");
        let back = read(&bytes).expect("a cloud");
        assert_eq!(back.attributes.last().map(|a| &a.values), Some(&Values::U64(vec![7, u64::MAX, 8])));
    }
}

#[test]
fn columns_without_names_are_told_by_their_values() {
    let names = |text: &str| -> Vec<String> {
        read(text.as_bytes()).expect("a cloud").attributes.into_iter().map(|a| a.name).collect()
    };
    assert_eq!(names("1 2 3 255 0 7\n4 5 6 1 2 3\n"), ["red", "green", "blue"]);
    assert_eq!(names("1 2 3 -1200 255 0 7\n4 5 6 5 1 2 3\n"), ["intensity", "red", "green", "blue"]);
    assert_eq!(names("1 2 3 0.6 0.8 0\n4 5 6 0 0 -1\n"), ["nx", "ny", "nz"]);
    assert_eq!(
        names("1 2 3 9 8 7 0.6 0.8 0\n4 5 6 1 2 3 0 0 -1\n"),
        ["red", "green", "blue", "nx", "ny", "nz"]
    );
    assert_eq!(names("1 2 3 0.5 300\n4 5 6 0.5 2\n"), ["column 4", "column 5"]);
}

#[test]
fn values_that_are_no_numbers_are_read_as_such() {
    let (_, positions) = xyz("nan 0 -inf\n1 2 3\n");
    assert!(positions[0][0].is_nan());
    assert_eq!(positions[0][2], f64::NEG_INFINITY);
}

#[test]
fn columns_that_begin_empty_or_have_no_name_are_columns() {
    let attributes = |text: &str| -> Vec<(String, Vec<f64>)> {
        let cloud = read(text.as_bytes()).expect("a cloud");
        let values = |a: &Attribute| (0..a.values.len()).map(|i| a.values.get(i)).collect();
        cloud.attributes.iter().map(|a| (a.name.clone(), values(a))).collect()
    };
    let found = attributes("x,y,z,label,w\n1,2,3,7,\n4,5,6,8,0.5\n");
    assert_eq!(found[0], ("label".to_owned(), vec![7.0, 8.0]));
    assert_eq!((found[1].0.as_str(), found[1].1[1], found[1].1[0].is_nan()), ("w", 0.5, true));
    assert_eq!(
        attributes(",x,y,,z\n1,2,3,7,4\n"),
        [("index".to_owned(), vec![1.0]), ("column 4".to_owned(), vec![7.0])]
    );
    // Every line ends like this in some programs' files.
    assert_eq!(attributes("x,y,z,\n1,2,3,\n"), []);
    assert_eq!(attributes("1,2,3,\n4,5,6,\n"), []);
    assert_eq!(attributes("a survey of mine\n1 2 3\n"), []);
}

#[test]
fn broken_lines_are_named() {
    for (text, what) in [
        ("1 2 3\n1 two 3\n", "line 2: column 2: `two` is not a number"),
        ("1 two 3\n1 2 3\n", "line 1: column 2: `two` is not a number"),
        ("x,y,z\n1,two,3\n1,2,3\n", "line 2: column 2: `two` is not a number"),
        ("x,y,z\n1,2,3\n1,2,three\n", "line 3: column 3 (z): `three` is not a number"),
        ("1 2 3\n\n1 2\n", "line 3: 2 columns where the first points have 3, separated by white space"),
        ("1,2,3\n1 2 3\n", "line 2: 1 column where the first points have 3, separated by a comma"),
        ("1 2 3\n1,2,3\n", "line 2: 1 column where the first points have 3, separated by white space"),
        ("1,2,3\n1;2;3\n", "line 2: 1 column where the first points have 3, separated by a comma"),
        ("x,y,z,w\n1,2,3,4\n1,2,3\n", "line 3: 3 columns where the first points have 4"),
        ("1 2 3\nx y z\n", "line 2: column 1: `x` is not a number"),
        ("x y z\nx y z\n1 2 3\nx y z\n", "line 4: column 1 (x): `x` is not a number"),
        ("5\n6\n1 2 3\n", "line 2: 1 column where"),
        (
            "a,x,b,y,z\n1,2,3,4\n",
            "line 2: line 1 has 5 names (a, x, b, y, z), and the points have 4 columns: a name for each is needed",
        ),
        ("x,y,z,label\n1,2,3,7,0.5\n", "line 1 has 4 names (x, y, z, label), and the points have 5 columns"),
        ("1 2 3\n1 2 3\n\"4 5 6\n", "line 3: quotes are opened and not closed"),
        ("{\n \"a\": 1\n}\n", "unknown format: JSON"),
        ("a {\n b 1\n}\n", "text without a line of numbers, which begins with `a {`"),
        ("hello\n", "text without a line of numbers, which begins with `hello`; convert it to PLY"),
        ("x;y;z\n", "text without a line of numbers, which begins with `x;y;z`"),
        ("1 2\n3 4\n", "line 1: 2 columns where a point needs 3"),
    ] {
        let error = read(text.as_bytes()).expect_err(text).to_string();
        assert!(error.contains(what), "{text:?}: {error}");
    }
    let wide = "1 ".repeat(1001);
    assert!(read(wide.as_bytes()).expect_err("an error").to_string().contains("1000 columns"));
    let long = "1".repeat(3 << 20);
    assert!(read(long.as_bytes()).expect_err("an error").to_string().contains("longer than"));
}

#[test]
fn text_ply_is_a_row_a_line() {
    let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty uchar red\nproperty double z\n\
                  property list uchar int friends\nproperty int y\nproperty float x\nend_header\n";
    let read_body = |body: &str| {
        let text = format!("{header}{body}").replace('\n', "\r\n");
        let reader = CloudReader::open(text.as_bytes(), Limits::default()).expect("a header");
        assert_eq!(reader.header().attributes, ["red"]);
        assert_eq!(reader.header().dropped_properties, ["friends"]);
        assert_eq!(reader.header().format, ply(PlyEncoding::Ascii, Scalar::F64));
        reader.read()
    };
    let cloud = read_body("255 3 2 7 8 2 1\n\n0 6 0 5 nan\n").expect("a cloud");
    assert_eq!(cloud.positions[0], [1.0, 2.0, 3.0]);
    assert!(cloud.positions[1][0].is_nan());
    for (body, what) in [
        ("255 3 0 2 1 9\n0 6 0 5 4\n", "line 10: `9` is more than a `vertex` row has"),
        ("255 3 0 2\n1\n", "line 10: the line is too short"),
        ("255 3 -1 2 1\n", "line 10: -1 is not the length of a list"),
        ("255 three 0 2 1\n", "line 10: `three` is not a number"),
        ("255 3 0 2 1\n", "the header counts 2 `vertex` elements, and 1 are there"),
        ("1 3 0 2 1\n1 3 0 2 1\n1 3 0 2 1\n", "data go on after"),
    ] {
        let error = read_body(body).expect_err("an error").to_string();
        assert!(error.contains(what), "{body:?}: {error}");
    }
}
