//! Meshes read as clouds: OFF and OBJ.

use proptest::prelude::*;

use super::*;

fn names(cloud: &Cloud) -> Vec<&str> {
    cloud.attributes.iter().map(|a| a.name.as_str()).collect()
}

fn format_of(bytes: &[u8]) -> Format {
    CloudReader::open(bytes, Limits::default()).expect("a header").header().format
}

const OFF: &str = "# a mesh\nSTCNOFF 2 1 0\n1 2 3 0 0 1 255 128 0 0.5 0.5\n4 5 6 0 1 0 1 2 3 0 0\n3 0 1 0\n";

const OBJ: &str = "# a mesh\nmtllib a.mtl\no thing\nv 1 2 3 0.5 0.25 1\r\nv 4 5 6 1 1 1\nvt 0 0\nvn 0 0 1\n\
                   vn 0 1 0\nf 1//1 2//2 \\\n 1//1\nl 1 2\n";

#[test]
fn vertices_of_off_are_points() {
    let cloud = read(OFF.as_bytes()).expect("a cloud");
    assert_eq!(cloud.positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!(names(&cloud), ["nx", "ny", "nz", "red", "green", "blue"]);
    assert_eq!(cloud.attributes[3].values, Values::U8(vec![255, 1]));
    assert_eq!(cloud.dropped_properties, ["face", "texture coordinates"]);
    assert_eq!(format_of(OFF.as_bytes()), Format::Off);
    let plain = read(b"OFF 1 0 0\n1 2 3 9 9 9\n").expect("a cloud");
    assert!(plain.attributes.is_empty());
    assert_eq!(plain.dropped_properties, ["numbers behind 1 vertices that `OFF` does not tell of"]);
    let shaded = read(b"COFF\n2 0 0\n1 2 3 0.5 0 1 0.5\n1 2 3 0.5 0 1\n").expect("a cloud");
    assert_eq!(shaded.dropped_properties, ["numbers behind 1 vertices that `COFF` does not tell of"]);
    let short = read(b"COFF\n2 0 0\n1 2 3 0.5 0 1\n1 2 3\n").expect("a cloud");
    assert!(short.attributes[0].values.get(1).is_nan(), "no colour");
    let limits = Limits { max_points: Some(1), ..Limits::default() };
    assert!(matches!(CloudReader::open(OFF.as_bytes(), limits), Err(FormatError::TooManyPoints { .. })));
}

#[test]
fn vertices_of_obj_are_points() {
    let cloud = read(OBJ.as_bytes()).expect("a cloud");
    assert_eq!(cloud.positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!(names(&cloud), ["red", "green", "blue", "nx", "ny", "nz"]);
    assert_eq!(cloud.attributes[0].values, Values::F64(vec![0.5, 1.0]));
    assert_eq!(cloud.attributes[5].values, Values::F64(vec![1.0, 0.0]));
    assert_eq!(cloud.dropped_properties, ["texture coordinates", "face", "line"]);
    assert_eq!(format_of(OBJ.as_bytes()), Format::Obj);
    let cloud = read(b"v 1 2 3 1\nv 4 5 6\nvn 0 0 1\n").expect("a cloud");
    assert!(cloud.attributes.is_empty(), "a weight is no colour");
    assert_eq!(cloud.dropped_properties, ["normals (not one a vertex)"]);
    let limits = Limits { max_points: Some(1), ..Limits::default() };
    let error = CloudReader::open(OBJ.as_bytes(), limits).expect("a header").read();
    assert!(matches!(error, Err(FormatError::TooManyPoints { .. })));
}

#[test]
fn text_is_not_taken_for_a_mesh() {
    for text in ["v x y z\n1 2 3 4\n", "g r x y z\n1 2 3 4 5\n", "s x y z\n9 1 2 3\n", "vx x y z\n1 2 3 4\n"]
    {
        assert!(matches!(format_of(text.as_bytes()), Format::Xyz { .. }), "{text}");
    }
    for (text, why) in [
        ("v 1 2 3\n4 5 6\n", "line 2: `4`"),
        ("v 1 2 3\nv 4 x 6\n", "line 2: `x`"),
        ("v 1 2 3\nvn 4\n", "line 2"),
        ("OFF\n2 0 0\n1 2 3\n", "vertex 1 of 2"),
        ("OFF\n1 2 0\n1 2 3\n3 0 0 0\n", "face 1 of 2"),
    ] {
        let error = read(text.as_bytes()).expect_err(why).to_string();
        assert!(error.contains(why), "{error}");
    }
}

#[test]
fn results_are_ply_since_meshes_are_only_read() {
    let folder = tempfile::tempdir().expect("a folder");
    for (format, name, text) in [(Format::Off, "a.off", OFF), (Format::Obj, "a.obj", OBJ)] {
        assert_eq!(Format::from_extension(name.as_ref()), Some(format));
        assert_eq!(format.written(), ply(PlyEncoding::BinaryLittleEndian, Scalar::F64));
        assert!(CloudWriter::new(Vec::new(), format, 1).is_err());
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("a file");
        assert_eq!(read_cloud_file(&path).expect("a cloud").1.format, format);
        std::fs::write(&path, "1 2 3\n").expect("a file");
        assert!(matches!(read_cloud_file(&path), Err(FormatError::Unrecognised { .. })));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn damage_never_panics(
        obj in any::<bool>(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = if obj { OBJ } else { OFF }.as_bytes().to_vec();
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        bytes.truncate(cut.index(2 * bytes.len()));
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.positions.capacity() <= 8 * bytes.len());
        }
    }
}
