//! Blobs in an S3 that is not ours. `scripts/with-services.sh` starts it.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;

use densecloud_blobs::{Blobs, Patience, Settings, open, open_object};

/// The endpoint.
fn endpoint() -> String {
    std::env::var("DENSECLOUD_TEST_S3").expect(
        "DENSECLOUD_TEST_S3 is not set: run this by `sh scripts/with-services.sh cargo test … -- --include-ignored`",
    )
}

fn settings() -> Settings {
    let variables = [
        ("AWS_ENDPOINT_URL", endpoint()),
        ("AWS_ALLOW_HTTP", "true".into()),
        ("AWS_ACCESS_KEY_ID", "test".into()),
        ("AWS_SECRET_ACCESS_KEY", "test".into()),
        ("AWS_REGION", "us-east-1".into()),
    ];
    Settings::new(variables.map(|(name, value)| (name.to_owned(), value)), Patience::default())
}

fn at(prefix: &str) -> Arc<dyn Blobs> {
    open(&format!("s3://densecloud-test/{prefix}"), &settings()).expect("an address")
}

fn write(blobs: &dyn Blobs, name: &str, bytes: &[u8]) {
    let mut sink = blobs.create(name).expect("a blob");
    sink.write_all(bytes).expect("room");
    sink.finish().expect("a blob");
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_store_keeps_blobs_as_it_should() {
    for (number, test) in super::suite::TESTS.iter().enumerate() {
        test(&*at(&format!("suite/{number}")));
    }
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn prefixes_are_apart_and_what_lies_deeper_is_anothers() {
    let (above, below) = (at("apart"), at("apart/below"));
    write(&*above, "a", b"above");
    write(&*below, "a", b"below");
    write(&*at("apart.other"), "b", b"beside");
    let names = |blobs: &dyn Blobs| -> Vec<String> {
        blobs.list("").expect("names").into_iter().map(|one| one.name).collect()
    };
    assert_eq!(names(&*above), ["a"]);
    assert_eq!(names(&*below), ["a"]);
    above.delete("a").expect("no fault");
    assert_eq!(names(&*below), ["a"]);
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn lists_go_on_over_pages() {
    let blobs = at("pages");
    // A page has a thousand.
    for number in 0..1001 {
        write(&*blobs, &format!("{number}"), b"");
    }
    assert_eq!(blobs.list("").expect("names").len(), 1001);
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn two_blobs_are_never_mixed() {
    let blobs = at("mixed");
    write(&*blobs, "a", &vec![1; 12_000_000]);
    let mut reader = blobs.open("a").expect("a blob");
    reader.read_exact(&mut [0; 10]).expect("bytes");
    write(&*blobs, "a", &vec![2; 12_000_000]);
    let mut rest = Vec::new();
    reader.read_to_end(&mut rest).expect_err("it is another now");
    assert!(rest.iter().all(|&byte| byte == 1));
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_blob_that_is_dropped_leaves_no_parts() {
    let blobs = at("dropped");
    let mut sink = blobs.create("dropped").expect("a blob");
    sink.write_all(&vec![7; 20_000_000]).expect("room");
    assert!(uploads().contains("dropped/dropped"), "its parts are on their way");
    drop(sink);
    assert!(!uploads().contains("dropped/dropped"));
}

/// The store's list of uploads that are not complete.
fn uploads() -> String {
    let endpoint = endpoint();
    let host = endpoint.trim_start_matches("http://");
    let mut socket = TcpStream::connect(host).expect("the store");
    let ask = format!("GET /densecloud-test?uploads HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    socket.write_all(ask.as_bytes()).expect("a request");
    let mut answer = String::new();
    socket.read_to_string(&mut answer).expect("an answer");
    assert!(answer.contains("ListMultipartUploadsResult"), "{answer}");
    answer
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn objects_of_others_have_any_name() {
    let name = "scan 1~(a)%20ü+.laz";
    let (objects, named) =
        open_object(&format!("s3://densecloud-test/others/{name}"), &settings()).expect("an address");
    assert_eq!(named, name);
    write(&objects, &named, b"a cloud");
    let mut text = String::new();
    objects.open(name).expect("a blob").read_to_string(&mut text).expect("bytes");
    assert_eq!(text, "a cloud");
    assert_eq!(at("others").list("").expect("names")[0].name, name);
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_bucket_that_is_not_there_is_named() {
    let blobs = open("s3://densecloud-none/x", &settings()).expect("an address");
    let told = blobs.list("").expect_err("no bucket").to_string();
    assert!(told.starts_with("s3://densecloud-none/x/: ") && told.contains("NoSuchBucket"), "{told}");
}
