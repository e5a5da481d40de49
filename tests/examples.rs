//! The examples are built and run.

#![allow(dead_code, reason = "each example has a `main` of its own")]
#![allow(clippy::unwrap_used, reason = "in a test, a panic is how a failure is told")]

#[path = "../examples/array.rs"]
mod array;
#[path = "../examples/file.rs"]
mod file;
#[path = "../examples/progress.rs"]
mod progress;
#[path = "../examples/server.rs"]
mod server;

use std::io::{Read, Write};
use std::net::TcpStream;

use densecloud::cascade::CascadeError;
use densecloud::{Input, Options, UpsampleError, Upsampler};
use tokio::net::TcpListener;
use tokio::sync::oneshot;

#[test]
fn a_file_becomes_a_denser_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let rows: String = progress::sheet(300).iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    std::fs::write(path("in.xyz"), rows).unwrap();
    for output in ["dense.ply", "dense.laz", "dense.xyz"] {
        file::upsample(&path("in.xyz"), &path(output), "2.5").unwrap();
        let input = Input::read(&path(output)).unwrap();
        assert_eq!(input.cloud.positions.len(), 750, "{output}");
    }
    let failed = file::upsample(&path("in.xyz"), &path("dense.ply"), "65").unwrap_err().to_string();
    assert_eq!(failed, "ratio: \"65\" is not a number from 1 to 64");
    assert!(file::upsample(&path("none.xyz"), &path("dense.ply"), "2").is_err());
}

#[test]
fn an_array_becomes_a_denser_array_with_its_values() {
    let dense = array::upsample(12).unwrap();
    assert_eq!(dense.positions.len(), 3 * 12 * 12);
    let heights = &dense.attributes[0];
    assert_eq!(heights.name, "height");
    for (i, [_, _, z]) in dense.positions.iter().enumerate() {
        assert!((heights.values.get(i) - z).abs() < 0.05, "{i}");
    }
}

#[test]
fn progress_is_heard_and_work_is_stopped() {
    let upsampler = Upsampler::new().unwrap();
    let bar = progress::Bar::default();
    let dense = upsampler.upsample_watched(progress::sheet(200), Options::default(), &bar).unwrap();
    // Four stages of each of two levels.
    assert_eq!((dense.positions.len(), bar.stages()), (800, 8));
    bar.stop();
    let stopped = upsampler.upsample_watched(progress::sheet(200), Options::default(), &bar);
    assert!(matches!(stopped, Err(UpsampleError::Cascade(CascadeError::Cancelled))));
}

#[test]
fn a_server_inside_answers_until_it_is_stopped() {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let (stop, stopped) = oneshot::channel::<()>();
    let listener = runtime.block_on(TcpListener::bind(("127.0.0.1", 0))).unwrap();
    let address = listener.local_addr().unwrap();
    let client = std::thread::spawn(move || {
        let body: String = progress::sheet(100).iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
        let head = format!(
            "POST /upsample?ratio=3 HTTP/1.1\r\nhost: a\r\nconnection: close\r\ncontent-length: {}\r\n\r\n",
            body.len()
        );
        loop {
            let mut stream = TcpStream::connect(address).unwrap();
            stream.write_all(head.as_bytes()).unwrap();
            stream.write_all(body.as_bytes()).unwrap();
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            // Until it is warm.
            if !answer.starts_with("HTTP/1.1 503 ") {
                drop(stop);
                return answer;
            }
        }
    });
    let served = runtime.block_on(async {
        server::serve(listener, async { drop(stopped.await) }).await.map_err(|e| e.to_string())
    });
    served.unwrap();
    let answer = client.join().unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
    assert!(body.lines().filter(|line| line.split(' ').count() == 3).count() == 300, "{head}");
}
