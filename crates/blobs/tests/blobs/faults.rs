//! Stores that refuse, stall or break off.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use densecloud_blobs::{Blobs, Patience, Settings, open};

const SECRET: &str = "SECRETKEY";

/// What is done with the head of a request, and the connection it came by.
type Answer = fn(&str, TcpStream);

/// A server on a port of its own that answers so.
fn server(answer: Answer) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let host = listener.local_addr().expect("a port").to_string();
    thread::spawn(move || {
        for socket in listener.incoming() {
            let Ok(mut socket) = socket else { return };
            thread::spawn(move || {
                let head = head(&mut socket);
                answer(&head, socket);
            });
        }
    });
    host
}

fn head(socket: &mut TcpStream) -> String {
    let mut head = Vec::new();
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") && socket.read(&mut byte).is_ok_and(|count| count == 1) {
        head.push(byte[0]);
    }
    String::from_utf8(head).expect("text")
}

fn reply(mut socket: TcpStream, head: &str, body: &str) {
    // Whoever asked may have left.
    let _ = write!(
        socket,
        "HTTP/1.1 {head}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
        body.len()
    );
    // Read on, so that what was not read does not reset the connection.
    let _ = socket.shutdown(std::net::Shutdown::Write);
    let _ = std::io::copy(&mut socket, &mut std::io::sink());
}

/// For what is not answered, or in vain.
const SHORT: Patience = Patience { request: Duration::from_millis(200), step: Duration::from_secs(1) };
/// For what has to be answered first, on a machine that is busy.
const LONG: Patience = Patience { request: Duration::from_secs(6), step: Duration::from_secs(6) };

fn store(host: &str, patience: Patience) -> Arc<dyn Blobs> {
    let variables = [
        ("AWS_ENDPOINT_URL", format!("http://{host}")),
        ("AWS_ALLOW_HTTP", "true".into()),
        ("AWS_ACCESS_KEY_ID", "SECRETID".into()),
        ("AWS_SECRET_ACCESS_KEY", SECRET.into()),
    ];
    let settings = Settings::new(variables.map(|(name, value)| (name.to_owned(), value)), patience);
    open("s3://bucket/jobs", &settings).expect("an address")
}

/// The kinds of errors of everything that can be asked; none tells a secret.
fn faults(blobs: &dyn Blobs) -> [ErrorKind; 5] {
    let write = |bytes: &[u8]| {
        let mut sink = blobs.create("a")?;
        sink.write_all(bytes)?;
        sink.finish()
    };
    let errors = [
        blobs.open("a").err(),
        blobs.delete("a").err(),
        blobs.list("a").err(),
        write(b"small").err(),
        write(&[0; 20 << 20]).err(),
    ];
    errors.map(|error| {
        let error = error.expect("a fault");
        let told = error.to_string();
        assert!(told.starts_with("s3://bucket/jobs/a: "), "{told}");
        assert!(!told.contains("SECRET") && !told.contains('?') && !told.contains('<'), "{told}");
        error.kind()
    })
}

/// Whether it is the kind of what was tried in vain, to the end of its time.
fn is_given_up(kind: &ErrorKind) -> bool {
    matches!(kind, ErrorKind::NotConnected | ErrorKind::ResourceBusy | ErrorKind::TimedOut)
}

#[test]
fn a_store_that_is_not_there_is_an_error() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let host = listener.local_addr().expect("a port").to_string();
    drop(listener);
    let kinds = faults(&*store(&host, SHORT));
    assert!(kinds.iter().all(is_given_up), "{kinds:?}");
}

#[test]
fn a_store_that_stalls_is_an_error_in_time() {
    let host = server(|_, mut socket| {
        let _ = std::io::copy(&mut socket, &mut std::io::sink());
        thread::park();
    });
    assert_eq!(faults(&*store(&host, SHORT)), [ErrorKind::TimedOut; 5]);
}

#[test]
fn a_store_that_refuses_is_an_error_without_secrets() {
    const BODY: &str = "<Error><Code>SignatureDoesNotMatch</Code><Key>SECRET</Key></Error>";
    let host = server(|_, socket| reply(socket, "403 Forbidden", BODY));
    let host = format!("me:SECRET@{host}");
    assert_eq!(faults(&*store(&host, LONG)), [ErrorKind::PermissionDenied; 5]);
}

#[test]
fn a_store_that_fails_again_and_again_is_an_error_without_secrets() {
    let host = server(|_, socket| reply(socket, "500 Fault", "SECRET: x"));
    let kinds = faults(&*store(&host, SHORT));
    assert!(kinds.iter().all(is_given_up), "{kinds:?}");
}

#[test]
fn what_breaks_off_is_an_error_and_not_the_end() {
    let host = server(|head, mut socket| {
        let about = "Content-Length: 1000\r\nETag: \"a\"\r\nLast-Modified: Tue, 01 Dec 2026 00:00:00 GMT";
        let answer = match head.split(' ').next() {
            Some("HEAD") => format!("HTTP/1.1 200 OK\r\n{about}\r\nConnection: close\r\n\r\n"),
            _ => format!("HTTP/1.1 206 Partial\r\n{about}\r\nContent-Range: bytes 0-999/1000\r\n\r\nhalf"),
        };
        let _ = socket.write_all(answer.as_bytes());
    });
    let mut reader = store(&host, LONG).open("a").expect("a blob");
    assert_eq!(reader.length().expect("a length"), 1000);
    reader.read_to_end(&mut Vec::new()).expect_err("it is not whole");
}

#[test]
fn a_part_that_is_lost_is_no_blob() {
    let host = server(|head, socket| match head.split(' ').next() {
        Some("POST") if head.contains("uploads") => {
            let begun =
                "<InitiateMultipartUploadResult><UploadId>u</UploadId></InitiateMultipartUploadResult>";
            reply(socket, "200 OK", begun);
        }
        Some("PUT") => reply(socket, "500 Fault", ""),
        _ => reply(socket, "200 OK", ""),
    });
    let blobs = store(&host, SHORT);
    let mut sink = blobs.create("a").expect("a blob");
    let mut written = (0..5).map(|_| sink.write_all(&[0; 8 << 20]));
    assert!(written.any(|part| part.is_err()));
    assert!(sink.write(b"more").is_err());
    assert!(sink.finish().is_err(), "whatever came after it");
}

#[test]
fn calls_may_be_made_where_others_run() {
    let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
    let host = server(|_, socket| reply(socket, "404 None", ""));
    runtime.block_on(async {
        let blobs = store(&host, LONG);
        assert_eq!(blobs.open("a").err().map(|error| error.kind()), Some(ErrorKind::NotFound));
        blobs.delete("a").expect("not there");
    });
}
