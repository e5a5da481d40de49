//! What every keeper of blobs has to do, as functions over the trait.

use std::fs;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::time::{Duration, SystemTime};

use densecloud_blobs::Blobs;

/// All of them, over a keeper that has nothing yet each.
pub(crate) const TESTS: [fn(&dyn Blobs); 8] = [
    a_blob_is_there_whole_or_not_at_all,
    of_two_at_once_the_later_stays_whole,
    blobs_are_read_from_anywhere,
    a_large_one_comes_back,
    blobs_are_deleted_once_or_twice,
    blobs_are_listed_by_prefix,
    local_files_come_and_go,
    names_lead_nowhere_else,
];

fn names(blobs: &dyn Blobs, prefix: &str) -> Vec<String> {
    let mut names: Vec<String> =
        blobs.list(prefix).expect("names").into_iter().map(|listed| listed.name).collect();
    names.sort();
    names
}

/// Bytes that differ from place to place.
fn bytes(count: u32) -> Vec<u8> {
    (0..count).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect()
}

fn write(blobs: &dyn Blobs, name: &str, bytes: &[u8]) {
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
    assert_eq!(names(blobs, ""), [""; 0], "and nothing is left of it");
    write(blobs, "a.out", b"whole");
    write(blobs, "b.in", b"");
    assert_eq!(names(blobs, ""), ["a.out", "b.in"]);
    assert_eq!(read(blobs, "b.in"), b"");
    let mut other = blobs.create("a.out").expect("a blob");
    other.write_all(b"other").expect("room");
    assert_eq!(read(blobs, "a.out"), b"whole", "until the other is finished");
    other.finish().expect("a blob");
    assert_eq!(read(blobs, "a.out"), b"other");
}

fn of_two_at_once_the_later_stays_whole(blobs: &dyn Blobs) {
    let mut first = blobs.create("a").expect("a blob");
    let mut second = blobs.create("a").expect("a blob");
    first.write_all(b"the first ").expect("room");
    second.write_all(b"second").expect("room");
    first.write_all(b"one").expect("room");
    first.finish().expect("a blob");
    assert_eq!(read(blobs, "a"), b"the first one");
    second.finish().expect("a blob");
    assert_eq!(read(blobs, "a"), b"second");
    assert_eq!(names(blobs, ""), ["a"]);
}

fn blobs_are_read_from_anywhere(blobs: &dyn Blobs) {
    let bytes = bytes(3_000_000);
    write(blobs, "a", &bytes);
    let mut reader = blobs.open("a").expect("a blob");
    assert_eq!(reader.length().expect("a length"), bytes.len() as u64);
    for start in [2_999_990, 0, 1_500_000] {
        let mut part = [0; 10];
        reader.seek(SeekFrom::Start(start as u64)).expect("a place");
        reader.read_exact(&mut part).expect("bytes");
        assert_eq!(part, bytes[start..start + 10]);
    }
    assert_eq!(reader.seek(SeekFrom::Current(-20)).expect("a place"), 1_499_990);
    assert_eq!(reader.seek(SeekFrom::End(-1)).expect("a place"), 2_999_999);
    let mut last = Vec::new();
    reader.read_to_end(&mut last).expect("bytes");
    assert_eq!(last, bytes[2_999_999..]);
    reader.seek(SeekFrom::Start(4_000_000)).expect("past its end");
    assert_eq!(reader.read(&mut [0; 10]).expect("nothing"), 0);
    assert!(reader.seek(SeekFrom::Current(-5_000_000)).is_err());
}

fn a_large_one_comes_back(blobs: &dyn Blobs) {
    let bytes = bytes(20_000_000);
    let mut sink = blobs.create("large").expect("a blob");
    for part in bytes.chunks(999_983) {
        sink.write_all(part).expect("room");
    }
    assert!(missing(blobs, "large"));
    sink.finish().expect("a blob");
    assert!(read(blobs, "large") == bytes, "it is what was written");
    let mut dropped = blobs.create("large").expect("a blob");
    dropped.write_all(&bytes[1..]).expect("room");
    drop(dropped);
    assert!(read(blobs, "large") == bytes, "it is still what was finished");
    assert_eq!(names(blobs, ""), ["large"]);
}

fn blobs_are_deleted_once_or_twice(blobs: &dyn Blobs) {
    write(blobs, "a", b"abc");
    blobs.delete("a").expect("no fault");
    blobs.delete("a").expect("gone already");
    assert!(missing(blobs, "a"));
    blobs.delete("never").expect("never there");
}

fn blobs_are_listed_by_prefix(blobs: &dyn Blobs) {
    let before = SystemTime::now() - Duration::from_secs(60);
    for name in ["job.1.out", "job.1.in", "job.12.out", "jo", "other"] {
        write(blobs, name, b"x");
    }
    assert_eq!(names(blobs, "job.1"), ["job.1.in", "job.1.out", "job.12.out"]);
    assert_eq!(names(blobs, "job.1."), ["job.1.in", "job.1.out"]);
    assert_eq!(names(blobs, "none"), [""; 0]);
    let listed = blobs.list("").expect("names");
    assert_eq!(listed.len(), 5);
    assert!(listed.iter().all(|one| one.modified >= before), "{listed:?}");
}

fn local_files_come_and_go(blobs: &dyn Blobs) {
    let folder = tempfile::tempdir().expect("a folder");
    let (from, to) = (folder.path().join("from"), folder.path().join("to"));
    fs::write(&from, "a cloud").expect("a file");
    write(blobs, "a", b"before");
    blobs.keep("a", &from).expect("a blob");
    assert!(!from.exists(), "it is taken over");
    assert_eq!(read(blobs, "a"), b"a cloud");
    fs::write(&to, "what was there, and longer").expect("a file");
    blobs.fetch("a", &to).expect("a file");
    assert_eq!(fs::read(&to).expect("a file"), b"a cloud");
    // What was fetched is kept again, under its name and under another.
    blobs.keep("a", &to).expect("a blob");
    assert!(!to.exists());
    assert_eq!(read(blobs, "a"), b"a cloud");
    let none = blobs.fetch("none", &to).expect_err("there is none");
    assert_eq!((none.kind(), to.exists()), (io::ErrorKind::NotFound, false));
    assert!(blobs.keep("b", &to).is_err());
    assert_eq!(names(blobs, ""), ["a"]);
}

fn names_lead_nowhere_else(blobs: &dyn Blobs) {
    for name in ["", ".", "..", "../a", "a/b", "/a", "a\\b", "a\n"] {
        let refused = |what: io::Result<()>| {
            assert_eq!(what.expect_err(name).kind(), io::ErrorKind::InvalidInput, "{name:?}");
        };
        refused(blobs.create(name).map(drop));
        refused(blobs.open(name).map(drop));
        refused(blobs.delete(name));
    }
}
