//! Meshes in PLY and OFF.

use super::*;
use densecloud_geometry::Mesh;

/// A square as one polygon, a triangle, and a face without area.
fn expected() -> Mesh {
    Mesh {
        vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]],
        triangles: vec![[0, 1, 2], [0, 2, 3], [4, 1, 0]],
    }
}

#[test]
fn off_is_read_in_all_its_spellings() {
    let body = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 0.5\n4 0 1 2 3\n3 4 1 0\n2 0 1\n";
    let colours = "0 0 0 255 0 0 255\n1 0 0 1 1 1\n1 1 0\n0 1 0\n0 0 0.5\n4 0 1 2 3 0.5 0.5 0.5\n\
                   3 4 1 0 7\n2 0 1\n";
    for text in [
        format!("OFF\n5 3 0\n{body}"),
        format!("OFF 5 3 0\n{body}"),
        format!("OFF5 3 0\n{body}"),
        format!("# made by hand\n\nOFF # keyword\n# counts\n5 3\n{}", body.replace('\n', " # end\n\n")),
        format!("COFF\r\n5 3 0\r\n{}", colours.replace('\n', "\r\n")),
        format!("OFF\n5 3 0\n{colours}trailing words"),
    ] {
        assert_eq!(read_mesh(text.as_bytes()).expect("a mesh"), expected(), "{text}");
    }
}

#[test]
fn broken_off_is_refused() {
    for (text, what) in [
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "line 6: a face refers to vertex 3, but there are 3"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "line 6: `-1` stands where the index"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "line 6: the line ends where the index"),
        ("OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "line 4: the line ends where a coordinate"),
        ("OFF\n3 1 0\n0 0 0\n", "the data end at line 3: vertex 1 of 3 is missing"),
        ("OFF\n4000000000 1 0\n0 0 0\n", "vertex 1 of 4000000000"),
        ("OFF\n3 -1 0\n", "line 2: `-1` stands where the number of faces"),
        ("OFF\n", "counts"),
        ("OFF BINARY\n", "binary OFF"),
        ("OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "no triangles"),
        ("OFF\n3 1 0\n0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n", "vertex 1 is not finite"),
        ("", "no triangles"),
        ("v 0 0 0\n", "`v`"),
    ] {
        let error = read_mesh(text.as_bytes()).expect_err("an error").to_string();
        assert!(error.contains(what), "{text:?}: {error}");
    }
}

const PLY_HEADER: &str = "element vertex 5\nproperty double x\nproperty double y\nproperty double z\n";

#[test]
fn ply_faces_may_have_any_types_and_come_first() {
    let ascii = format!(
        "ply\nformat ascii 1.0\nelement face 3\nproperty uchar flags\nproperty list uchar int vertex_index\n\
         property list int float texcoord\n{PLY_HEADER}end_header\n1 4 0 1 2 3 2 0.5 0.5\n2 3 4 1 0 0\n3 2 0 1 0\n\
         0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 0.5\n"
    );
    assert_eq!(read_mesh(ascii.as_bytes()).expect("a mesh"), expected());

    for big in [false, true] {
        for (length, item, sizes) in
            [("uchar", "int", (1, 4)), ("int", "ushort", (4, 2)), ("uint64", "uint8", (8, 1))]
        {
            let name = if big { "big" } else { "little" };
            let mut bytes = format!(
                "ply\nformat binary_{name}_endian 1.0\n{PLY_HEADER}element face 3\n\
                 property list {length} {item} vertex_indices\nend_header\n"
            )
            .into_bytes();
            let mut put = |mut word: Vec<u8>| {
                if big {
                    word.reverse();
                }
                bytes.extend(word);
            };
            for c in expected().vertices.as_flattened() {
                put(c.to_le_bytes().to_vec());
            }
            for face in [[0_u64, 1, 2, 3].as_slice(), &[4, 1, 0], &[0, 1]] {
                put((face.len() as u64).to_le_bytes()[..sizes.0].to_vec());
                for i in face {
                    put(i.to_le_bytes()[..sizes.1].to_vec());
                }
            }
            assert_eq!(read_mesh(bytes.as_slice()).expect("a mesh"), expected(), "{name} {length} {item}");
        }
    }
}

#[test]
fn broken_ply_meshes_are_refused() {
    let with = |faces: &str, body: &str| {
        let text = format!(
            "ply\nformat ascii 1.0\n{PLY_HEADER}{faces}end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n{body}"
        );
        read_mesh(text.as_bytes()).expect_err("an error").to_string()
    };
    let faces = "element face 1\nproperty list uchar int vertex_indices\n";
    assert!(with("", "").contains("a cloud, not a mesh"));
    assert!(
        with("element face 1\nproperty int vertex_indices\n", "1\n").contains("no list `vertex_indices`")
    );
    assert!(with(faces, "3 0 1 5\n").contains("line 15: a face refers to vertex 5, but there are 5"));
    assert!(with(faces, "3 0 1 -1\n").contains("-1 is not the index of a vertex"));
    assert!(with(faces, "3 0 1 0.5\n").contains("0.5 is not the index of a vertex"));
    assert!(with(faces, "3 0 1\n").contains("too short"));
    assert!(with(faces, "").contains("the header counts 1 `face` elements, and 0 are there"));
    assert!(with(faces, "2 0 1\n").contains("no triangles"));
}
