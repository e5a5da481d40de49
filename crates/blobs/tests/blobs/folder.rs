//! Blobs in a folder.

use std::fs;
use std::io::{Read, Write};

use densecloud_blobs::{Blobs, Folder};

fn open(folder: &tempfile::TempDir) -> Folder {
    Folder::open(folder.path().join("files")).expect("a folder")
}

#[test]
fn a_folder_keeps_blobs_as_it_should() {
    for test in super::suite::TESTS {
        test(&open(&tempfile::tempdir().expect("a folder")));
    }
}

#[test]
fn an_open_blob_is_read_to_its_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let blobs = open(&folder);
    let mut sink = blobs.create("a").expect("a blob");
    sink.write_all(b"abc").expect("room");
    sink.finish().expect("a blob");
    let mut reader = blobs.open("a").expect("a blob");
    blobs.delete("a").expect("no fault");
    let mut text = String::new();
    reader.read_to_string(&mut text).expect("bytes");
    assert_eq!(text, "abc");
}

#[test]
fn what_a_killed_program_left_is_listed_and_deleted_and_in_nobodys_way() {
    let folder = tempfile::tempdir().expect("a folder");
    let blobs = open(&folder);
    fs::write(folder.path().join("files/a.part"), "half").expect("a file");
    let mut sink = blobs.create("a").expect("a blob");
    sink.write_all(b"whole").expect("room");
    sink.finish().expect("a blob");
    let mut names: Vec<String> = blobs.list("a").expect("names").into_iter().map(|one| one.name).collect();
    names.sort();
    assert_eq!(names, ["a", "a.part"]);
    assert!(blobs.create("a.part").is_err(), "no blob has such a name");
    blobs.delete("a.part").expect("no fault");
    assert_eq!(blobs.list("").expect("names").len(), 1);
}

#[cfg(unix)]
#[test]
fn files_are_moved_and_linked() {
    use std::os::unix::fs::MetadataExt;
    let folder = tempfile::tempdir().expect("a folder");
    let (blobs, file) = (open(&folder), folder.path().join("file"));
    let inode = |path: &std::path::Path| fs::metadata(path).expect("a file").ino();
    fs::write(&file, "abc").expect("a file");
    let before = inode(&file);
    blobs.keep("a", &file).expect("a blob");
    assert_eq!(inode(&folder.path().join("files/a")), before);
    blobs.fetch("a", &file).expect("a file");
    assert_eq!(inode(&file), before);
}
