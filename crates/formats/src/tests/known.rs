//! Files that are none of what is read: each is named, with what to do; and names of outputs.

use std::path::Path;

use super::*;

fn refusal(bytes: &[u8]) -> String {
    match read(bytes) {
        Err(error @ FormatError::Unrecognised { .. }) => error.to_string(),
        other => panic!("{:?}: {other:?}", String::from_utf8_lossy(&bytes[..bytes.len().min(20)])),
    }
}

/// A ZIP archive's first bytes.
fn zip(entry: &str) -> Vec<u8> {
    let mut bytes = b"PK\x03\x04\x2D\0\0\0\0\0\0\0\x21\0".to_vec();
    bytes.resize(26, 0);
    bytes.extend((entry.len() as u16).to_le_bytes());
    bytes.extend([0, 0]);
    bytes.extend(entry.as_bytes());
    bytes.extend([7; 40]);
    bytes
}

/// Binary STL, whose first 80 bytes say nothing.
fn stl(triangles: u32) -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(triangles.to_le_bytes());
    for i in 0..triangles {
        for number in [0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, i as f32] {
            bytes.extend(f32::to_le_bytes(number));
        }
        bytes.extend([0, 0]);
    }
    bytes
}

#[test]
fn binary_files_of_other_kinds_are_named() {
    let with = |magic: &[u8]| [magic, &[0, 1, 2, 3, 4, 5, 6, 7]].concat();
    let mut tar = vec![b'a'; 600];
    tar[100] = 0;
    tar[257..262].copy_from_slice(b"ustar");
    for (bytes, name, advice) in [
        (with(b"\x1F\x8B\x07"), "a gzip file", "unpack"),
        (with(b"NGSP"), "an .spz of Gaussian splats", "PLY"),
        (with(b"\x28\xB5\x2F\xFD"), "a Zstandard file", "unpack"),
        (with(b"BZh91AY"), "a bzip2 file", "unpack"),
        (with(b"\xFD7zXZ\0"), "an xz file", "unpack"),
        (tar, "a tar archive", "unpack"),
        (zip("arr_0.npy"), "an .npz archive", "numpy.save(\"a.npy\", numpy.load(\"a.npz\")[\"arr_0\"])"),
        (zip("scan.las"), "a ZIP archive that begins with `scan.las`", "unpack"),
        (zip("archive/data.pkl"), "a file of PyTorch", "numpy.save"),
        (zip("[Content_Types].xml"), "an Office document", "CSV"),
        (b"PK\x03\x04".to_vec(), "a ZIP archive", "unpack"),
        (with(b"glTF\x02"), "a glTF scene", "PLY"),
        (stl(4), "an STL mesh", "PLY"),
        (stl(1000), "an STL mesh", "PLY"),
        (with(b"CCB2"), "a CloudCompare project", "CloudCompare"),
        (with(b"\x89HDF\r\n\x1A\n"), "an HDF5 file", "numpy.save"),
        (with(b"PAR1"), "a Parquet file", "to_csv"),
        (with(b"ARROW1"), "an Arrow (Feather) file", "to_csv"),
        (with(b"FEA1"), "a Feather file", "to_csv"),
        (with(b"\x89PNG\r\n\x1A\n"), "a PNG picture", "no points"),
        (with(b"\xFF\xD8\xFF\xE0"), "a JPEG picture", "no points"),
        (with(b"II*\0"), "a TIFF picture", "gdal_translate"),
        (with(b"MM\0*"), "a TIFF picture", "gdal_translate"),
        (with(b"%PDF-1.4\n"), "a PDF document", "no points"),
        (with(b"\x80\x04\x95"), "a Python pickle", "numpy.save"),
        (with(b"#ROSBAG V2.0\n"), "a ROS bag", "PCD"),
        (with(b"\xD4\xC3\xB2\xA1"), "PCAP", "viewer"),
        (with(b"SQLite format 3\0"), "an SQLite database", "CSV"),
    ] {
        let error = refusal(&bytes).to_lowercase();
        assert!(error.contains(&name.to_lowercase()) && error.contains(&advice.to_lowercase()), "{error}");
    }
}

#[test]
fn text_of_other_kinds_is_named() {
    for (text, name) in [
        (
            "# vtk DataFile Version 3.0\nvtk output\nASCII\nDATASET POLYDATA\nPOINTS 2 float\n0 0 0\n1 1 1\n",
            "a legacy VTK file",
        ),
        ("<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\">\n", "a VTK XML file"),
        ("<VTKFile type=\"PolyData\">\n", "a VTK XML file"),
        ("<?xml version=\"1.0\"?>\n<kml>\n", "an XML document"),
        ("NCOLS 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n4 5 6\n", "an ESRI ASCII grid"),
        ("nrows 2\r\nncols 3\r\n1 2 3\r\n", "an ESRI ASCII grid"),
        ("solid cube\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "an STL mesh"),
        ("<!DOCTYPE html>\n<html>\n", "a web page"),
        ("\n  <HTML>\n", "a web page"),
        ("{\"type\": \"FeatureCollection\"}", "JSON"),
        ("[[1, 2, 3], [4, 5, 6]]\n", "JSON"),
        ("#VRML V2.0 utf8\n", "a VRML scene"),
        ("DSAA\n2 2\n0 1\n0 1\n0 1\n", "a Surfer grid"),
    ] {
        let error = refusal(text.as_bytes());
        assert!(error.contains(name), "{error}");
    }
}

#[test]
fn words_that_others_begin_with_are_no_more_than_words_in_text() {
    // As a title, or as the name of a column.
    for text in
        ["BLENDER export\n1 2 3\n4 5 6\n", "CCB points\n1 2 3\n4 5 6\n", "solid block\n1 2 3\n4 5 6\n"]
    {
        assert_eq!(read(text.as_bytes()).expect(text).positions.len(), 2, "{text}");
    }
}

#[test]
fn an_output_is_named_as_what_it_is() {
    let of = |name: &str| Format::of_output(Path::new(name));
    for name in [
        "a.ply",
        "a.las",
        "a.LAZ",
        "a.e57",
        "a.pcd",
        "a.npy",
        "a.xyz",
        "a.txt",
        "a.asc",
        "a.pts",
        "a.csv",
        "points3D.bin",
    ] {
        let format = of(name).expect(name).expect(name);
        assert!(format.is_written(), "{name}");
    }
    for name in ["-", "dense", "/dev/stdout", "a.b/dense", ".ply"] {
        assert_eq!(of(name).expect(name), None, "{name}");
    }
    for name in [
        "a.ptx", "a.stl", "a.bin", "a.vtk", "a.xyz.gz", "a.glb", "a.npz", "a.splat", "a.off", "a.obj",
        "a.xyzn", "a.xyzrgb", "a.dat", "a.", "a.plyy",
    ] {
        let error = of(name).expect_err(name).to_string();
        let last = name.rsplit('.').next().expect("an extension");
        assert!(error.contains(&format!("nothing is written as `.{last}`")), "{error}");
        for ending in [".ply, ", ".las", ".laz", ".csv", " or "] {
            assert!(error.contains(ending), "{error}");
        }
    }
    // But that of an input of text.
    let folder = tempfile::tempdir().expect("a folder");
    let from = |input: &str, bytes: &[u8], output: &str| {
        let input = folder.path().join(input);
        std::fs::write(&input, bytes).expect("a file");
        Format::of_output_from(Path::new(output), &input, &Reading::default())
    };
    let text = &b"1 2 3 4\n5 6 7 8\n"[..];
    for (input, output) in [("a.dat", "b.dat"), ("a.XYZN", "b.xyzn"), ("a.b.Dat", "-")] {
        assert_eq!(from(input, text, output).expect(output), None, "{input}");
    }
    assert_eq!(from("a.dat", text, "b.csv").expect("a format"), Some(Format::text(Separator::Comma)));
    let ply = write(&[[1.0, 2.0, 3.0]], ply(PlyEncoding::Ascii, Scalar::F64));
    for (input, bytes, output) in [
        ("a.dat", text, "b.date"),
        ("a", text, "b.dat"),
        ("a.xyz.gz", text, "b.xyz.gz"),
        ("a.dat", &ply, "b.dat"),
        ("a.dat", b"no points\n", "b.dat\0"),
    ] {
        let error = from(input, bytes, output).expect_err(input).to_string();
        assert!(error.contains("nothing is written as"), "{error}");
    }
    let none = Format::of_output_from(Path::new("b.dat"), Path::new("no/a.dat"), &Reading::default());
    assert!(matches!(none, Err(FormatError::NotWritten(_))));
    // The list is what there is.
    for ending in registry::endings() {
        let name = if ending.starts_with('.') { format!("a{ending}") } else { ending };
        assert!(matches!(of(&name), Ok(Some(_))), "{name}");
    }
}
