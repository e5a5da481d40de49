//! Clouds read and written a block at a time.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Read, Write};

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
    formats
}

/// A cloud with attributes whose type only all of their numbers tell.
fn cloud(points: usize) -> Cloud {
    let positions = (0..points).map(|i| [i as f64 * 0.25, 1.0, -(i as f64)]).collect();
    let attribute = |name: &str, values| Attribute { name: name.into(), values };
    let attributes = vec![
        attribute("red", Values::U8((0..points).map(|i| i as u8).collect())),
        attribute("green", Values::U8((0..points).map(|i| (i / 7) as u8).collect())),
        attribute("blue", Values::U8(vec![3; points])),
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
    for format in streamed().into_iter().chain([LAS, LAZ]) {
        let bytes = file(&cloud, format);
        let whole = read(&bytes).expect("a cloud");
        for rows in [1, 7, 999, 1000, 5000] {
            let reader = CloudReader::open(&bytes[..], Limits::default()).expect("a header");
            assert!(joined(reader, rows).expect("a cloud") == whole, "{format}, {rows} rows");
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
    for format in streamed() {
        let begun = |points: &[Position]| {
            let mut bytes = Vec::new();
            let origin = Origin::default();
            let writer = CloudWriter::with(&mut bytes, format, POINTS, &one.attributes, &origin);
            writer.and_then(|mut writer| writer.write_rows(points, &one.attributes, 0)).expect("a row");
            bytes
        };
        let (header, with_row) = (begun(&[]), begun(&one.positions));
        let row = &with_row[header.len()..];
        let length = header.len() as u64 + POINTS * row.len() as u64;
        let given = Cell::new(0);
        let made = Made { header: &header, row, length, given: &given };
        let mut reader = CloudReader::open(made, Limits::default()).expect("a header");
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
    for format in [LAS, LAZ, Format::E57, NPY] {
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
    for format in streamed().into_iter().chain([LAS, LAZ, Format::E57]) {
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
        for format in streamed().into_iter().chain([LAS, LAZ]) {
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
    for format in streamed().into_iter().chain([LAS, LAZ, Format::E57, compressed]) {
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
    let names = ["e57", "las", "npy", "pcd", "obj", "xyz", "ptx", "colmap", "kitti", "nuscenes"];
    for entry in std::fs::read_dir(&source).expect("the source") {
        let path = entry.expect("an entry").path();
        let stem = path.file_stem().and_then(|stem| stem.to_str()).expect("a name").to_owned();
        // The list of modules, the registry, formats of one file, and what others are to be converted to.
        let is_its_own = ["lib", "registry", "tests", "obj", "off", "known"].contains(&stem.as_str());
        if is_its_own || path.extension().is_none_or(|extension| extension != "rs") {
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("a file");
        // Comments and messages may.
        let code = |line: &&str| !["//", "\""].iter().any(|begin| line.trim_start().starts_with(begin));
        for line in text.lines().filter(code) {
            let words = || line.split(|c: char| !c.is_alphanumeric()).map(str::to_lowercase);
            let named = names.iter().find(|name| words().any(|word| word == **name));
            assert!(named.is_none(), "{}: {line}", path.display());
        }
    }
}
