//! Names that no format was made for, written and read again.

use std::collections::HashSet;

use super::*;
use densecloud_cloud::{Origin, Role};

/// Blanks, quotes, other scripts, signs that mean something in a header, names of the format's own, and none at all.
fn hostile() -> Vec<String> {
    let mut names: Vec<String> = [
        "a b",
        "a\tb",
        "a_b",
        "\"quoted\"",
        "it's",
        "größe",
        "高さ",
        "😀",
        "",
        " ",
        "x",
        "Y",
        "twice",
        "twice",
        "twice",
        "twice_",
        "a,b",
        "a;b",
        "a#b",
        "#",
        "// c",
        "9 lives",
        "9",
        "property",
        "end_header",
        "element vertex 7",
        "comment",
        "DATA",
        "DATA ascii",
        "FIELDS",
        "_",
        "__",
        "rgb",
        "line\nbreak",
        "nul\0",
        "bell\u{7}",
        "'",
        "\\",
        "a:b",
        "a/b",
        "<tag>",
        "&amp;",
        "]]>",
        "xml",
        "intensity ",
        "Intensity",
        "X",
        "z [m]",
        "scan-20-angle",
        "_--",
        "%41",
        "{'a': 1}",
        "(",
        "x y z",
        "VERSION 0.7",
        "red",
        "Red",
    ]
    .map(str::to_owned)
    .into();
    names.extend(["n".repeat(300), "n".repeat(301), "ü".repeat(40), "ü".repeat(41)]);
    names
}

fn cloud() -> Cloud {
    let attribute = |(i, name): (usize, String)| {
        // No number of one column is in another.
        let values = Values::I32((0..5).map(|row| 1000 * (i as i32 + 1) + row).collect());
        Attribute { name, values }
    };
    let attributes = hostile().into_iter().enumerate().map(attribute).collect();
    Cloud { positions: (0..5).map(|i| [f64::from(i), 0.5, 0.25]).collect(), attributes, ..Cloud::default() }
}

fn formats() -> Vec<Format> {
    let pcd = |encoding| Format::Pcd { encoding, scalar: Scalar::F32 };
    let mut all = ENCODINGS.map(|encoding| ply(encoding, Scalar::F32)).to_vec();
    all.extend([PcdEncoding::Ascii, PcdEncoding::Binary, PcdEncoding::Compressed].map(pcd));
    all.extend([
        Format::Las { compressed: false },
        Format::Las { compressed: true },
        Format::Copc,
        Format::E57,
    ]);
    all.push(Format::Npy { scalar: Scalar::F64, fields: true });
    all
}

#[test]
fn every_column_comes_back_under_a_name_that_was_told() {
    let cloud = cloud();
    for format in formats() {
        let bytes =
            encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file");
        let back = read(&bytes).expect("a cloud");
        assert_eq!(back.positions, cloud.positions, "{format}");
        let names: HashSet<&str> = back.attributes.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(names.len(), back.attributes.len(), "{format}: each name is another");
        assert!(!names.contains("") && !names.contains("x"), "{format}");
        // One of the format's own columns, by what the name means.
        let is_own = |attribute: &Attribute, found: &Attribute| {
            Role::of(&attribute.name).is_some_and(|role| role.name() == found.name)
        };
        let mut told = format.renamed(&cloud.attributes, &cloud.origin);
        for attribute in &cloud.attributes {
            let same = |a: &&Attribute| (0..5).all(|i| a.values.get(i) == attribute.values.get(i));
            let found = back.attributes.iter().find(same);
            let found = found.unwrap_or_else(|| panic!("{format}: {:?} is lost", attribute.name));
            // E57 tells the names that its columns have, of which the attributes' are made again.
            if found.name == attribute.name {
                continue;
            }
            let is_told = told.iter().position(|(from, to)| {
                *from == attribute.name && (*to == found.name || format == Format::E57)
            });
            assert!(
                is_told.is_some() || is_own(attribute, found),
                "{format}: {:?} as {:?}",
                attribute.name,
                found.name
            );
            is_told.map(|place| told.remove(place));
        }
        assert!(format == Format::E57 || told.is_empty(), "{format}: {told:?}");
        // What has a name of the format's keeps it.
        let again =
            encode(Vec::new(), format, &back.positions, &back.attributes, &back.origin).expect("a file");
        let again = read(&again).expect("a cloud");
        assert!(again.attributes == back.attributes, "{format}");
        let anew = format.renamed(&back.attributes, &back.origin);
        assert!(format == Format::E57 || anew.is_empty(), "{format}: {anew:?}");
    }
}

#[test]
fn where_columns_have_no_names_each_that_is_lost_is_told() {
    let mut cloud = cloud();
    // As comments they would end a line, or count other points.
    cloud.origin.comments = hostile();
    cloud.origin.comments.push("Number of points: 99, mean track length: 1".to_owned());
    for binary in [false, true] {
        let format = Format::Colmap { binary };
        let bytes =
            encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file");
        let back = read(&bytes).expect("a cloud");
        assert_eq!(back.positions, cloud.positions, "{format}");
        let names: Vec<&str> = back.attributes.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(names, ["point3d_id", "red", "green", "blue", "error"]);
        // One red makes no colour.
        assert_eq!(format.cannot_hold(&cloud.attributes, &cloud.origin), hostile());
        assert!(format.renamed(&cloud.attributes, &cloud.origin).is_empty());
    }
}

#[test]
fn names_are_those_of_the_format() {
    let cloud = cloud();
    let text = |format| {
        let bytes = encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &Origin::default())
            .expect("a file");
        String::from_utf8(bytes).expect("ascii")
    };
    let header = text(ply(PlyEncoding::Ascii, Scalar::F32));
    assert!(header.is_ascii());
    for line in header.lines().take_while(|line| *line != "end_header").skip(3) {
        let words: Vec<&str> = line.split(' ').collect();
        assert!(words.len() == 3 && words[2].len() <= 255, "{line}");
    }
    let header = text(Format::Pcd { encoding: PcdEncoding::Ascii, scalar: Scalar::F32 });
    let fields = header.lines().find(|line| line.starts_with("FIELDS ")).expect("fields");
    assert!(fields.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | ' ')), "{fields}");
    assert_eq!(fields.split(' ').count(), 1 + 3 + cloud.attributes.len());
}

#[test]
fn what_is_named_twice_is_written_under_two_names() {
    let attribute =
        |from: u8| Attribute { name: "intensity".into(), values: Values::U8(vec![from, from + 1]) };
    let attributes = vec![attribute(4), attribute(5)];
    let cloud = Cloud { positions: vec![[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]], attributes, ..Cloud::default() };
    for format in formats() {
        let told = [("intensity".to_owned(), "intensity_".to_owned())];
        assert_eq!(format.renamed(&cloud.attributes, &cloud.origin), told, "{format}");
        let bytes =
            encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file");
        let back = read(&bytes).expect("a cloud");
        let column = |name: &str| back.attributes.iter().find(|a| a.name == name).map(|a| a.values.get(1));
        assert_eq!((column("intensity"), column("intensity_")), (Some(5.0), Some(6.0)), "{format}");
    }
}

#[test]
fn extra_bytes_of_hostile_names_become_valid_ones() {
    // As a careless program writes them: twice the same, a field's name, half a character, nothing, 32 bytes without an end.
    let names: [&[u8]; 7] =
        [b"range", b"range", b"intensity", b"gr\xC3", b"", &[b'n'; 32], "größe".as_bytes()];
    let las = Format::Las { compressed: false };
    let plain: Vec<Attribute> = (0..7)
        .map(|i| Attribute { name: format!("column{i}"), values: Values::U16(vec![300 + i, 7]) })
        .collect();
    let mut bytes =
        encode(Vec::new(), las, &[[0.0; 3], [1.0; 3]], &plain, &Origin::default()).expect("a file");
    for (i, name) in names.iter().enumerate() {
        let own = format!("column{i}");
        let place = bytes.windows(own.len()).position(|w| w == own.as_bytes()).expect("an entry");
        bytes[place..place + 32].fill(0);
        bytes[place..place + name.len()].copy_from_slice(name);
    }
    let cloud = read(&bytes).expect("a cloud");
    for format in formats() {
        let written =
            encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file");
        let back = read(&written).expect("a cloud");
        for i in 0..7 {
            let has = |a: &&Attribute| (a.values.get(0), a.values.get(1)) == (f64::from(300 + i), 7.0);
            assert!(back.attributes.iter().any(|a| has(&a)), "{format}: {i}");
        }
    }
    let written =
        encode(Vec::new(), las, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file");
    let entries = written.windows(9).position(|w| w == b"LASF_Spec").expect("a record") + 52;
    let found: Vec<&str> = written[entries..]
        .chunks(192)
        .take(7)
        .map(|entry| {
            let name = &entry[4..36];
            let end = name.iter().position(|b| *b == 0).unwrap_or(32);
            std::str::from_utf8(&name[..end]).expect("text")
        })
        .collect();
    assert_eq!(found, ["range", "range_", "intensity_", "gr_", "extra 5", &"n".repeat(32), "größe"]);
}
