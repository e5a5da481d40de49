//! Files that people will try and that hold no cloud this crate reads: their names, and what to do.

use super::text::shown;

/// What a file is, by its first bytes.
struct Known {
    /// Where these bytes stand.
    at: usize,
    magic: &'static [&'static [u8]],
    name: &'static str,
    /// What to do instead; empty where there is nothing to say.
    advice: &'static str,
    /// Whether it is text. Bytes that are letters tell of nothing else in a text, which may begin with any word.
    is_text: bool,
}

const fn binary(magic: &'static [&'static [u8]], name: &'static str, advice: &'static str) -> Known {
    Known { at: 0, magic, name, advice, is_text: false }
}

const fn text(magic: &'static [&'static [u8]], name: &'static str, advice: &'static str) -> Known {
    Known { at: 0, magic, name, advice, is_text: true }
}

const UNPACK: &str = "unpack it first";
const TO_PLY: &str = "convert it to PLY";
const TO_MESH: &str = "convert it to PLY; `sample` covers its faces with points";
const NO_POINTS: &str = "it holds no points";
const GRID: &str = "in GDAL: gdal_translate -of XYZ IN OUT.xyz";
const TABLE: &str = "save its columns as text; in pandas: table.to_csv(\"points.csv\", index=False)";
const ARRAY: &str = "save its points as .npy; in Python: numpy.save(\"points.npy\", points)";
const VTK: &str =
    "in ParaView: File, Save Data, as PLY or CSV; in Python: pyvista.read(IN).save(\"OUT.ply\")";
const SENSOR: &str = "save its points as PCD or CSV in the sensor's own viewer";

const KNOWN: &[Known] = &[
    binary(&[b"\x1F\x8B"], "a gzip file within another, or a damaged one", UNPACK),
    binary(&[b"\x28\xB5\x2F\xFD"], "a Zstandard file", UNPACK),
    binary(&[b"BZh"], "a bzip2 file", UNPACK),
    binary(&[b"\xFD7zXZ\0"], "an xz file", UNPACK),
    binary(&[b"7z\xBC\xAF\x27\x1C"], "a 7-Zip file", UNPACK),
    binary(&[b"Rar!\x1A\x07"], "a RAR file", UNPACK),
    binary(&[b"\x04\x22\x4D\x18"], "an LZ4 file", UNPACK),
    Known { at: 257, magic: &[b"ustar"], name: "a tar archive", advice: UNPACK, is_text: false },
    binary(&[b"glTF"], "a glTF scene", TO_MESH),
    binary(&[b"DRACO"], "a Draco file", TO_PLY),
    binary(&[b"Kaydara FBX"], "an FBX scene", TO_MESH),
    binary(&[b"PXR-USDC"], "a USD scene", TO_MESH),
    binary(&[b"BLENDER"], "a Blender file", TO_MESH),
    binary(&[b"NGSP"], "an .spz of Gaussian splats", TO_PLY),
    binary(&[b"CCB"], "a CloudCompare project", "save the cloud as PLY, LAS or E57 in CloudCompare"),
    binary(&[b"DSBB", b"DSRB"], "a Surfer grid", GRID),
    binary(&[b"AC10"], "an AutoCAD drawing", "save its points as text"),
    binary(&[b"\x89HDF"], "an HDF5 file", ARRAY),
    binary(&[b"CDF\x01", b"CDF\x02", b"CDF\x05"], "a NetCDF file", ARRAY),
    binary(&[b"MATLAB 5.0 MAT-file"], "a MATLAB file", "in MATLAB: pcwrite(cloud, \"OUT.ply\")"),
    binary(&[b"PAR1"], "a Parquet file", TABLE),
    binary(&[b"ARROW1"], "an Arrow (Feather) file", TABLE),
    binary(&[b"FEA1"], "a Feather file", TABLE),
    binary(&[b"SQLite format 3\0"], "an SQLite database", TABLE),
    binary(&[b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"], "a Python pickle", ARRAY),
    binary(&[b"#ROSBAG"], "a ROS bag", "save one of its clouds as PCD; with ROS: bag_to_pcd of pcl_ros"),
    binary(&[b"\x89MCAP0\r\n"], "an MCAP recording", "save one of its clouds as PCD"),
    binary(
        &[b"\xD4\xC3\xB2\xA1", b"\xA1\xB2\xC3\xD4", b"\x4D\x3C\xB2\xA1", b"\x0A\x0D\x0D\x0A"],
        "a recording of network packets (PCAP)",
        SENSOR,
    ),
    binary(&[b"\x89PNG\r\n"], "a PNG picture", NO_POINTS),
    binary(&[b"\xFF\xD8\xFF"], "a JPEG picture", NO_POINTS),
    binary(&[b"GIF8"], "a GIF picture", NO_POINTS),
    binary(&[b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"], "a TIFF picture; if it is a GeoTIFF of heights", GRID),
    binary(&[b"%PDF-"], "a PDF document", NO_POINTS),
    binary(&[b"\xD0\xCF\x11\xE0"], "a document of Microsoft Office", "save its table as CSV"),
    text(&[b"# vtk DataFile"], "a legacy VTK file", VTK),
    text(&[b"<VTKFile"], "a VTK XML file", VTK),
    text(&[b"#usda"], "a USD scene", TO_MESH),
    text(&[b"#VRML"], "a VRML scene", TO_MESH),
    text(&[b"DSAA"], "a Surfer grid", GRID),
];

/// Whether there are bytes that no text has.
pub(super) fn is_binary(head: &[u8]) -> bool {
    head.iter().any(|b| *b < 0x20 && !b.is_ascii_whitespace() && !matches!(*b, 0x0B | 0x1A))
}

/// What a file that begins with `head` is, if it is none of what is read here, and what to do.
pub(super) fn name(head: &[u8]) -> Option<String> {
    let begins = |known: &Known| {
        let rest = head.get(known.at..).unwrap_or_default();
        let is_sure =
            |magic: &[u8]| known.is_text || !magic.is_ascii() || is_binary(magic) || is_binary(head);
        known.magic.iter().any(|magic| rest.starts_with(magic) && is_sure(magic))
    };
    if let Some(known) = KNOWN.iter().find(|known| begins(known)) {
        return Some(said(known.name, known.advice));
    }
    if head.starts_with(b"PK\x03\x04") {
        return Some(archive(head));
    }
    if is_solid(head) {
        return Some(said("an STL mesh", TO_MESH));
    }
    by_word(head)
}

/// What a text is by its first word, in any case.
fn by_word(head: &[u8]) -> Option<String> {
    let text = head.trim_ascii_start();
    let begins =
        |word: &str| text.get(..word.len()).is_some_and(|begin| begin.eq_ignore_ascii_case(word.as_bytes()));
    let is_next = |word: &str| begins(word) && text.get(word.len()).is_some_and(u8::is_ascii_whitespace);
    let (name, advice) = match text {
        _ if is_next("ncols") || is_next("nrows") => ("an ESRI ASCII grid", GRID),
        _ if begins("<!doctype html") || begins("<html") => {
            ("a web page", "most likely a download that did not succeed")
        }
        _ if begins("<?xml") && contains(text, b"<VTKFile") => ("a VTK XML file", VTK),
        _ if begins("<?xml") => ("an XML document", ""),
        [b'{' | b'[', ..] => ("JSON", "save its points as text, a point a line"),
        _ => return None,
    };
    Some(said(name, advice))
}

fn said(name: &str, advice: &str) -> String {
    if advice.is_empty() { name.to_owned() } else { format!("{name} ({advice})") }
}

/// A ZIP archive, by its first entry.
fn archive(head: &[u8]) -> String {
    let length = head.get(26..28).map_or(0, |bytes| usize::from(u16::from_le_bytes([bytes[0], bytes[1]])));
    let entry = head.get(30..).map(|rest| &rest[..rest.len().min(length)]).unwrap_or_default();
    let ends = |suffix: &[u8]| entry.to_ascii_lowercase().ends_with(suffix);
    if ends(b".npy") {
        let key = String::from_utf8_lossy(&entry[..entry.len() - 4]).replace(char::is_control, "");
        let key: String = key.chars().filter(|c| *c != '"').take(40).collect();
        return format!(
            "an .npz archive (in Python: numpy.save(\"a.npy\", numpy.load(\"a.npz\")[\"{key}\"]))"
        );
    }
    match entry {
        b"[Content_Types].xml" => "an Office document (save its table as CSV)".to_owned(),
        b"" => "a ZIP archive (unpack it first)".to_owned(),
        entry if ends(b"/data.pkl") => {
            format!("a file of PyTorch, {} (numpy.save the points as .npy)", shown(entry))
        }
        entry => format!("a ZIP archive that begins with {} (unpack it first)", shown(entry)),
    }
}

/// Whether it is STL: text, or, since the binary form begins with 80 bytes of anything, triangles whose normals have the
/// length 1 or 0.
fn is_solid(head: &[u8]) -> bool {
    /// Bytes of a triangle.
    const TRIANGLE: usize = 50;
    if head.starts_with(b"solid") && contains(head, b"facet") {
        return true;
    }
    let triangles = head.get(84..).unwrap_or_default().chunks_exact(TRIANGLE);
    let count = head.get(80..84).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])) as usize;
    let whole = triangles.len();
    // Cut off at the end of what is seen, or whole.
    let is_long = head.len() >= super::first_bytes::ENOUGH && count >= whole;
    let is_all = count > 0 && head.len() == 84 + TRIANGLE * count;
    let is_facet = |bytes: &[u8]| {
        let numbers = bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let numbers: Vec<f32> = numbers.take(12).collect();
        let length = numbers.iter().take(3).map(|c| c * c).sum::<f32>().sqrt();
        numbers.iter().all(|c| c.is_finite()) && (length == 0.0 || (length - 1.0).abs() < 1e-3)
    };
    (is_long || is_all) && head.contains(&0) && triangles.into_iter().all(is_facet)
}

fn contains(head: &[u8], word: &[u8]) -> bool {
    head.windows(word.len()).any(|window| window == word)
}
