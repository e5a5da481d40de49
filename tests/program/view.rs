//! `densecloud view` as a process.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use crate::support::{agent, densecloud, run, signal, sphere};

#[test]
fn a_view_gives_its_files_to_whoever_has_the_address_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, temp) = (folder.path().join("scan.xyz"), folder.path().join("temp"));
    std::fs::write(&file, sphere(100)).expect("a file");
    std::fs::create_dir(&temp).expect("a folder");
    let mut view = densecloud();
    let view = view.args(["view", "--no-open", "--threads", "1"]).arg(&file).env("TMPDIR", &temp);
    let mut view = view.stdout(Stdio::piped()).spawn().expect("the program starts");
    let mut address = String::new();
    BufReader::new(view.stdout.take().expect("piped")).read_line(&mut address).expect("a line");
    let (page, key) = address.trim().split_once("#key=").expect("a key");
    let get = |path: &str, key: &str| {
        let asked = agent().get(format!("{page}{path}")).header("authorization", format!("Bearer {key}"));
        let mut answer = asked.call().expect("an answer");
        (answer.status().as_u16(), answer.body_mut().read_to_string().expect("text"))
    };
    assert!(page.starts_with("http://127.0.0.1:"), "{page}");
    assert_eq!(get("files/0", key), (200, sphere(100)));
    assert_eq!(get("files/0", "no-key-of-this-run").0, 401);
    assert_eq!(get("", "").0, 200);
    signal(&view.id().to_string(), "INT");
    assert_eq!(view.wait().expect("an end").code(), Some(0));
    // ONNX Runtime may leave a file there.
    let left = std::fs::read_dir(&temp).expect("a folder").map(|entry| entry.expect("an entry").path());
    assert_eq!(left.filter(|path| path.is_dir()).count(), 0);
}

#[test]
fn a_view_of_what_is_not_there_is_an_error() {
    let gone = run(&["view", "--no-open", "/nowhere/scan.ply"]);
    assert_eq!(gone.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&gone.stderr).contains("/nowhere/scan.ply"));
}
