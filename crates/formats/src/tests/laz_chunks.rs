//! Compressed points in many chunks: on any number of threads, of any sizes, with tables that tell the truth or not.

use std::io::{Cursor, Seek, SeekFrom, Write};

use ::laz::{LasZipCompressor, LasZipDecompressor, LazVlr, LazVlrBuilder};

use super::*;
use densecloud_cloud::{Attribute, Origin};

const LAZ: Format = Format::Las { compressed: true };

/// Points of a system with a code are in a point format without layers.
fn cloud(points: usize, layered: bool) -> Cloud {
    let positions = (0..points).map(|i| [i as f64 * 0.125, (i % 1013) as f64, (i / 7) as f64]).collect();
    let crs = (!layered).then(|| "EPSG:25832".parse().expect("a code"));
    let column = |name: &str, values| Attribute { name: name.into(), values };
    let attributes = vec![
        column("intensity", Values::U16((0..points).map(|i| i as u16).collect())),
        column("height", Values::F32((0..points).map(|i| (i % 77) as f32).collect())),
    ];
    Cloud { positions, attributes, origin: Origin { crs, ..Origin::default() }, ..Cloud::default() }
}

fn file(cloud: &Cloud) -> Vec<u8> {
    encode(Vec::new(), LAZ, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

fn on<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads").install(work)
}

/// Where the points begin, how they are compressed, and all bytes of points, as the crate has them one by one.
fn unpacked(bytes: &[u8], points: usize) -> (usize, LazVlr, Vec<u8>) {
    let header = ::las::Header::new(Cursor::new(bytes)).expect("a header");
    let how = header.laz_vlr().expect("a record");
    let data = u32::from_le_bytes(bytes[96..100].try_into().expect("four bytes")) as usize;
    let mut file = Cursor::new(bytes);
    file.seek(SeekFrom::Start(data as u64)).expect("a place");
    let mut rows = vec![0; points * how.items_size() as usize];
    LasZipDecompressor::new(file, how.clone()).expect("points").decompress_many(&mut rows).expect("points");
    (data, how, rows)
}

/// The file with its points in chunks of these sizes.
fn in_chunks(bytes: &[u8], sizes: &[usize]) -> Vec<u8> {
    let (data, how, rows) = unpacked(bytes, sizes.iter().sum());
    let varied = LazVlrBuilder::new(how.items().clone()).with_variable_chunk_size().build();
    let record = |how: &LazVlr| {
        let mut record = Vec::new();
        how.write_to(&mut record).expect("memory");
        record
    };
    let (old, new) = (record(&how), record(&varied));
    let mut head = bytes[..data].to_vec();
    let at = head.windows(old.len()).position(|window| window == old).expect("a record");
    head[at..at + new.len()].copy_from_slice(&new);
    let mut made = Cursor::new(head);
    made.seek(SeekFrom::End(0)).expect("a place");
    let mut packer = LasZipCompressor::new(made, varied).expect("a compressor");
    let (mut left, stride) = (&rows[..], how.items_size() as usize);
    for size in sizes {
        let (chunk, rest) = left.split_at(size * stride);
        packer.compress_chunks([chunk]).expect("memory");
        left = rest;
    }
    packer.done().expect("memory");
    let mut made = packer.into_inner();
    made.flush().expect("memory");
    made.into_inner()
}

#[test]
fn the_number_of_threads_changes_neither_bytes_nor_points() {
    for layered in [false, true] {
        // More than three chunks.
        let cloud = cloud(160_001, layered);
        let one = on(1, || file(&cloud));
        assert!(on(3, || file(&cloud)) == one);
        let whole = on(1, || read(&one).expect("a cloud"));
        assert!(whole.positions == cloud.positions && whole.attributes[0].name == "intensity");
        assert!(on(3, || read(&one).expect("a cloud")) == whole);
    }
}

#[test]
fn chunks_are_those_that_the_crate_makes_one_by_one() {
    for layered in [false, true] {
        let bytes = file(&cloud(120_000, layered));
        let (data, how, rows) = unpacked(&bytes, 120_000);
        let mut one_by_one = Cursor::new(bytes[..data].to_vec());
        one_by_one.seek(SeekFrom::End(0)).expect("a place");
        let mut packer = LasZipCompressor::new(one_by_one, how).expect("a compressor");
        packer.compress_many(&rows).expect("memory");
        packer.done().expect("memory");
        assert!(packer.into_inner().into_inner() == bytes);
    }
}

#[test]
fn chunks_of_any_sizes_are_read() {
    for layered in [false, true] {
        let bytes = file(&cloud(600_000, layered));
        let whole = read(&bytes).expect("a cloud");
        // The last is longer than what is decompressed at once.
        let varied = in_chunks(&bytes, &[1, 49_999, 70_000, 2, 479_998]);
        let cloud = read(&varied).expect("a cloud");
        assert!(cloud.positions == whole.positions && cloud.attributes == whole.attributes);
    }
}

#[test]
fn a_table_that_is_not_that_of_the_points_breaks_nothing() {
    for layered in [false, true] {
        let bytes = file(&cloud(120_000, layered));
        let data = u32::from_le_bytes(bytes[96..100].try_into().expect("four bytes")) as usize;
        let table = u64::from_le_bytes(bytes[data..data + 8].try_into().expect("eight bytes")) as usize;
        for at in table + 4..bytes.len() {
            let mut broken = bytes.clone();
            broken[at] ^= 0x5A;
            // Points are what they were, or the file is refused.
            if let Ok(cloud) = read(&broken) {
                assert_eq!(cloud.positions.len(), 120_000);
                assert!(cloud.positions == read(&bytes).expect("a cloud").positions, "byte {at}");
            }
        }
    }
}
