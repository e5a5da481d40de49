//! Clouds read and written a block at a time.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use super::*;
use densecloud_cloud::{Kind, Origin};

const LAS: Format = Format::Las { compressed: false };
const LAZ: Format = Format::Las { compressed: true };
const NPY: Format = Format::Npy { scalar: Scalar::F64, fields: true };

/// Formats whose points lie one after another.
fn streamed() -> Vec<Format> {
    let pcd = |encoding| Format::Pcd { encoding, scalar: Scalar::F32 };
    let mut formats = ENCODINGS.map(|encoding| ply(encoding, Scalar::F32)).to_vec();
    formats.extend([pcd(PcdEncoding::Ascii), pcd(PcdEncoding::Binary), Format::TEXT, NPY]);
    formats.extend([false, true].map(|binary| Format::Colmap { binary }));
    formats
}

/// A file that is not written here: the name that it is read by, what stands before its points, and one of them.
type Foreign = (&'static str, Vec<u8>, Vec<u8>);

/// Of formats that are read only and whose points lie one after another, files of this many points.
fn read_only(points: u64) -> [Foreign; 3] {
    let pose = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    let number = |v: f32| v.to_le_bytes();
    [
        ("ptx", format!("{points}\n1\n{pose}").into_bytes(), b"1 2 3 0.25 255 0 7\n".to_vec()),
        ("kitti", Vec::new(), [1.5, -2.0, 0.25, 0.5].map(number).concat()),
        ("off", format!("COFF\n{points} 0 0\n").into_bytes(), b"1 2 3 0.5 0 1\n".to_vec()),
    ]
}

fn read_as(format: &str) -> Reading {
    Reading { format: Some(format.parse().expect("a format")), ..Reading::default() }
}

/// A cloud with attributes whose type only all of their numbers tell.
fn cloud(points: usize) -> Cloud {
    let positions = (0..points).map(|i| [i as f64 * 0.25, 1.0, -(i as f64)]).collect();
    let attribute = |name: &str, values| Attribute { name: name.into(), values };
    let attributes = vec![
        attribute("red", Values::U8((0..points).map(|i| i as u8).collect())),
        attribute("green", Values::U8((0..points).map(|i| (i / 7) as u8).collect())),
        attribute("blue", Values::U8(vec![3; points])),
        attribute("error", Values::F64((0..points).map(|i| i as f64 / 16.0).collect())),
        attribute("curvature", Values::F32((0..points).map(|i| i as f32 / 8.0).collect())),
    ];
    Cloud { positions, attributes, ..Cloud::default() }
}

fn file(cloud: &Cloud, format: Format) -> Vec<u8> {
    encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

/// Reads all blocks, none of more than `rows` points, and puts them together.
fn joined(mut reader: CloudReader<'_>, rows: usize) -> Result<Cloud, FormatError> {
    let (mut block, mut all) = (Block::default(), Block::default());
    while reader.next_block(rows, &mut block)? {
        assert!(block.positions.len() <= rows);
        all.positions.append(&mut block.positions);
        all.columns.resize_with(block.columns.len(), || Values::new(Kind::F64));
        for (column, more) in all.columns.iter_mut().zip(&block.columns) {
            let numbers =
                (0..column.len()).map(|i| column.get(i)).chain((0..more.len()).map(|i| more.get(i)));
            *column = if more.is_empty() { Values::new(Kind::F64) } else { Values::F64(numbers.collect()) };
        }
    }
    let Ending { columns, dropped_properties, notes, origin } = reader.finish()?;
    let attributes = all.columns.iter().zip(columns).filter_map(|(values, column)| {
        let ColumnName { name, kind } = column?;
        Some(Attribute { name, values: Values::from_f64(kind, (0..values.len()).map(|i| values.get(i))) })
    });
    Ok(Cloud {
        attributes: attributes.collect(),
        positions: all.positions,
        dropped_properties,
        notes,
        origin,
    })
}

#[test]
fn blocks_are_what_is_read_at_once() {
    let cloud = cloud(1000);
    for format in streamed().into_iter().chain([LAS, LAZ, Format::Copc]) {
        let bytes = file(&cloud, format);
        let whole = read(&bytes).expect("a cloud");
        for rows in [1, 7, 999, 1000, 5000] {
            let reader = CloudReader::open(&bytes[..], Limits::default()).expect("a header");
            assert!(joined(reader, rows).expect("a cloud") == whole, "{format}, {rows} rows");
        }
    }
    for (format, header, row) in read_only(1000) {
        let bytes = [header, row.repeat(1000)].concat();
        let open =
            || CloudReader::open_as(&bytes[..], Limits::default(), &read_as(format)).expect("a header");
        let whole = open().read().expect("a cloud");
        for rows in [1, 7, 999, 1000, 5000] {
            assert!(joined(open(), rows).expect("a cloud") == whole, "{format}, {rows} rows");
        }
    }
}

#[test]
fn columns_of_text_change_their_type_from_one_block_to_the_next() {
    // Whole, then with a fraction; whole to the end; text in the end; three of a unit vector.
    let row = |i: i32| {
        let (fraction, word) = (if i == 50 { "0.5" } else { "7" }, if i == 90 { "word" } else { "8" });
        format!("{i} 1 2 {fraction} {i} {word}\n")
    };
    let text: String = (0..100).map(row).collect();
    let normals: String = (0..100).map(|i| format!("{i} 1 2 0 0.6 0.8 {}\n", 300 + i)).collect();
    for text in [text, normals] {
        let whole = read(text.as_bytes()).expect("a cloud");
        for rows in [1, 8, 51, 200] {
            let reader = CloudReader::open(text.as_bytes(), Limits::default()).expect("a header");
            assert_eq!(joined(reader, rows).expect("a cloud"), whole, "{rows} rows");
        }
    }
}

/// A file that is made while it is read: a header, then one row again and again. It counts the bytes that it gives.
struct Made<'a> {
    header: &'a [u8],
    row: &'a [u8],
    length: u64,
    given: &'a Cell<u64>,
}

impl Read for Made<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let at = self.given.get();
        let from = match at.checked_sub(self.header.len() as u64) {
            None => &self.header[at as usize..],
            Some(past) => &self.row[(past % self.row.len() as u64) as usize..],
        };
        let count = from.len().min(out.len()).min((self.length - at) as usize);
        out[..count].copy_from_slice(&from[..count]);
        self.given.set(at + count as u64);
        Ok(count)
    }
}

#[test]
fn a_long_file_is_not_read_further_than_its_points_are_given() {
    const POINTS: u64 = 300_000;
    const ROWS: usize = 1000;
    // More than the reader's buffer.
    const AHEAD: u64 = 1 << 20;
    let one = cloud(1);
    let written = streamed().into_iter().map(|format| {
        let begun = |points: &[Position]| {
            let mut plan = CloudPlan::new(format, &one.attributes, &Origin::default());
            (0..POINTS).for_each(|_| plan.see(&one.positions, &one.attributes, 0).expect("a place"));
            let mut bytes = Vec::new();
            let writer = plan.begin(&mut bytes);
            writer.and_then(|mut writer| writer.write_rows(points, &one.attributes, 0)).expect("a row");
            bytes
        };
        let (header, with_row) = (begun(&[]), begun(&one.positions));
        let row = with_row[header.len()..].to_vec();
        (format.to_string(), Reading::default(), header, row)
    });
    let foreign = read_only(POINTS).map(|(name, header, row)| (name.to_owned(), read_as(name), header, row));
    for (format, reading, header, row) in written.chain(foreign) {
        let length = header.len() as u64 + POINTS * row.len() as u64;
        let given = Cell::new(0);
        let made = Made { header: &header, row: &row, length, given: &given };
        let mut reader = CloudReader::open_as(made, Limits::default(), &reading).expect("a header");
        let (mut block, mut points) = (Block::default(), 0);
        while reader.next_block(ROWS, &mut block).expect("a block") {
            points += block.positions.len() as u64;
            let needed = header.len() as u64 + points * row.len() as u64;
            assert!(given.get() <= needed + AHEAD, "{format}: {} bytes for {points} points", given.get());
            assert!(block.positions.capacity() <= 4 * ROWS && block.columns.iter().all(|c| c.len() <= ROWS));
        }
        reader.finish().expect("the end");
        assert_eq!((points, given.get()), (POINTS, length), "{format}");
    }
}

#[test]
fn a_file_is_read_where_it_lies() {
    let cloud = cloud(100_000);
    let folder = tempfile::tempdir().expect("a folder");
    for format in [LAS, LAZ, Format::Copc, Format::E57, NPY] {
        let bytes = file(&cloud, format);
        let path = folder.path().join("cloud");
        std::fs::write(&path, &bytes).expect("a file");
        let whole = read(&bytes).expect("a cloud");
        let open = || CloudReader::open_file(File::open(&path).expect("a file"), Limits::default());
        assert!(open().and_then(CloudReader::read).expect("a cloud") == whole, "{format}");
        if format != Format::E57 {
            assert!(joined(open().expect("a header"), 10_000).expect("a cloud") == whole, "{format}");
        }
        let limits = Limits { max_bytes: Some(bytes.len() as u64 - 1), max_points: None };
        let limited = CloudReader::open_file(File::open(&path).expect("a file"), limits);
        let error = limited.and_then(CloudReader::read).expect_err("too large");
        assert!(matches!(error, FormatError::TooLarge { .. }), "{format}: {error}");
        // From the middle on, the file is another.
        let mut file = File::open(&path).expect("a file");
        io::copy(&mut Read::by_ref(&mut file).take(100), &mut io::sink()).expect("a hundred bytes");
        assert!(CloudReader::open_file(file, Limits::default()).and_then(CloudReader::read).is_err());
    }
}

/// Keeps the length of what is written and of its longest part.
#[derive(Default)]
struct Longest {
    part: usize,
    all: usize,
}

impl Write for Longest {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.part = self.part.max(bytes.len());
        self.all += bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn no_format_but_compressed_pcd_is_written_in_one_piece() {
    let cloud = cloud(300_000);
    for format in streamed().into_iter().chain([LAS, LAZ, Format::Copc, Format::E57]) {
        let written = encode(Longest::default(), format, &cloud.positions, &cloud.attributes, &cloud.origin);
        let Longest { part, all } = written.expect("a file");
        assert!(part <= 4 << 20 && (part < all / 2 || format.is_packed()), "{format}: {part} of {all}");
    }
}

#[test]
fn a_file_of_blocks_that_were_seen_is_that_of_the_whole_cloud() {
    let cloud = cloud(10_000);
    let mut from_las = read(&file(&cloud, LAS)).expect("a cloud");
    // A sixth return, a fraction of intensity and a far point, each in the last block alone.
    for attribute in &mut from_las.attributes {
        let numbers = (0..10_000).map(|i| if i == 9_999 { 6.5 } else { attribute.values.get(i) });
        match attribute.name.as_str() {
            "return_number" => attribute.values = Values::from_f64(Kind::U8, numbers),
            "intensity" => attribute.values = Values::F64(numbers.collect()),
            _ => {}
        }
    }
    from_las.positions[9_999] = [5e6, 1.0, 1.0];
    for cloud in [&cloud, &from_las] {
        for format in streamed().into_iter().chain([LAS, LAZ, Format::Copc]) {
            let whole = file(cloud, format);
            for rows in [1, 77, 9_999, 20_000] {
                // Each block has columns of its own, as those of a reader.
                let blocks: Vec<Cloud> = (0..10_000)
                    .step_by(rows)
                    .map(|from| {
                        let rows: Vec<u32> = (from as u32..10_000.min((from + rows) as u32)).collect();
                        let part = |a: &Attribute| Attribute {
                            name: a.name.clone(),
                            values: a.values.gather(&rows),
                        };
                        let positions = rows.iter().map(|row| cloud.positions[*row as usize]).collect();
                        let attributes = cloud.attributes.iter().map(part).collect();
                        Cloud { positions, attributes, ..Cloud::default() }
                    })
                    .collect();
                let mut plan = CloudPlan::new(format, &cloud.attributes, &cloud.origin);
                for block in &blocks {
                    plan.see(&block.positions, &block.attributes, 0).expect("a place");
                }
                let mut writer = plan.begin(Vec::new()).expect("a header");
                for block in &blocks {
                    writer.write_rows(&block.positions, &block.attributes, 0).expect("points");
                }
                assert!(writer.finish().expect("a file") == whole, "{format}, {rows} rows");
            }
        }
    }
    for format in [Format::E57, Format::Pcd { encoding: PcdEncoding::Compressed, scalar: Scalar::F32 }] {
        let error = CloudPlan::new(format, &[], &Origin::default()).begin(Vec::new()).expect_err("a whole");
        assert!(error.to_string().contains("as a whole"), "{error}");
    }
}

#[test]
fn a_spooled_file_is_the_same() {
    let cloud = cloud(3000);
    let compressed = Format::Pcd { encoding: PcdEncoding::Compressed, scalar: Scalar::F32 };
    for format in streamed().into_iter().chain([LAS, LAZ, Format::Copc, Format::E57, compressed]) {
        let mut spooled = Vec::new();
        encode_spooled(format, &cloud.positions, &cloud.attributes, &cloud.origin)
            .and_then(|mut file| Ok(file.read_to_end(&mut spooled)?))
            .expect("a file");
        assert!(spooled == file(&cloud, format), "{format}");
    }
}

/// What makes a format is its folder and its entry in the registry.
#[test]
fn no_other_file_names_a_format() {
    let source = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    // The list of modules, the registry, meshes, the tests, and what others are to be converted to.
    let may_name = ["lib.rs", "registry.rs", "mesh.rs", "mesh_write.rs", "tests.rs", "known.rs"];
    let mut own = vec!["tests".to_owned()];
    for module in FORMATS {
        own.extend([module.to_owned(), format!("{module}.rs")]);
    }
    let mut found = 0;
    for entry in std::fs::read_dir(&source).expect("the source") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().and_then(|name| name.to_str()).expect("a name").to_owned();
        if may_name.contains(&name.as_str()) {
            continue;
        }
        let is_format = own.contains(&name);
        found += usize::from(is_format && name != "tests");
        assert!(is_format || path.is_file(), "{}: a folder of no format", path.display());
        if name != "tests" {
            names_none(&path, name.trim_end_matches(".rs"));
        }
    }
    assert_eq!(found, FORMATS.len());
}

/// The modules of formats.
const FORMATS: [&str; 11] =
    ["ply", "las", "pcd", "npy", "e57", "off", "obj", "ptx", "colmap", "kitti", "xyz"];

/// Asserts that no code in a file or folder, that of the format `own`, names another format's module or type.
fn names_none(path: &Path, own: &str) {
    if path.is_dir() {
        let entries = std::fs::read_dir(path).expect("a folder");
        return entries.for_each(|entry| names_none(&entry.expect("an entry").path(), own));
    }
    let text = std::fs::read_to_string(path).expect("a file");
    // Comments, messages and the tests in it may, and a file's kind may be asked for.
    let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    let is_code = |line: &&str| {
        !["//", "\""].iter().any(|begin| line.trim_start().starts_with(begin))
            && !line.contains("is_named_in")
    };
    for line in code.lines().filter(is_code) {
        let words = || line.split(|c: char| !c.is_alphanumeric() && c != '_').map(str::to_lowercase);
        let named = FORMATS.iter().find(|name| **name != own && words().any(|word| word == **name));
        assert!(named.is_none(), "{}: {line}", path.display());
    }
}
