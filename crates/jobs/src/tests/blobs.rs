//! What every keeper of blobs has to do, as functions over the trait.

use std::io::{Read, Seek, SeekFrom};

use super::*;

#[test]
fn a_folder_keeps_blobs_as_it_should() {
    let tests: [fn(&dyn Blobs); 3] =
        [a_blob_is_there_whole_or_not_at_all, blobs_are_read_from_anywhere, deleted];
    for test in tests {
        let folder = tempfile::tempdir().expect("a folder");
        test(&Folder::open(folder.path().join("files")).expect("a folder"));
    }
}

fn names(blobs: &dyn Blobs) -> Vec<String> {
    let mut names = blobs.list().expect("names");
    names.sort();
    names
}

fn keep(blobs: &dyn Blobs, name: &str, bytes: &[u8]) {
    let mut sink = blobs.create(name).expect("a blob");
    sink.write_all(bytes).expect("room");
    sink.finish().expect("a blob");
}

fn read(blobs: &dyn Blobs, name: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    blobs.open(name).expect("a blob").read_to_end(&mut bytes).expect("bytes");
    bytes
}

fn missing(blobs: &dyn Blobs, name: &str) -> bool {
    blobs.open(name).err().is_some_and(|error| error.kind() == io::ErrorKind::NotFound)
}

fn a_blob_is_there_whole_or_not_at_all(blobs: &dyn Blobs) {
    let mut half = blobs.create("a.out").expect("a blob");
    half.write_all(b"half").expect("room");
    half.flush().expect("room");
    assert!(missing(blobs, "a.out"), "not before it is finished");
    drop(half);
    assert!(missing(blobs, "a.out"));
    assert_eq!(names(blobs), [""; 0], "and nothing is left of it");
    keep(blobs, "a.out", b"whole");
    keep(blobs, "b.in", b"");
    assert_eq!(names(blobs), ["a.out", "b.in"]);
    let mut other = blobs.create("a.out").expect("a blob");
    other.write_all(b"other").expect("room");
    assert_eq!(read(blobs, "a.out"), b"whole", "until the other is finished");
    other.finish().expect("a blob");
    assert_eq!(read(blobs, "a.out"), b"other");
}

fn blobs_are_read_from_anywhere(blobs: &dyn Blobs) {
    let bytes: Vec<u8> = (0..3_000_000_u32).map(|i| (i % 251) as u8).collect();
    keep(blobs, "a", &bytes);
    let mut reader = blobs.open("a").expect("a blob");
    assert_eq!(reader.length().expect("a length"), bytes.len() as u64);
    for start in [2_999_990, 0, 1_500_000] {
        let mut part = [0; 10];
        reader.seek(SeekFrom::Start(start as u64)).expect("a place");
        reader.read_exact(&mut part).expect("bytes");
        assert_eq!(part, bytes[start..start + 10]);
    }
}

fn deleted(blobs: &dyn Blobs) {
    keep(blobs, "a", b"abc");
    let mut reader = blobs.open("a").expect("a blob");
    blobs.delete("a").expect("no fault");
    blobs.delete("a").expect("gone already");
    assert!(missing(blobs, "a"));
    let mut text = String::new();
    reader.read_to_string(&mut text).expect("an open one is read to its end");
    assert_eq!(text, "abc");
}
