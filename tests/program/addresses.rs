//! Clouds and plans at addresses of an S3 that is not ours. `scripts/with-services.sh` starts it.

use std::io::{Read, Write};
use std::process::{Command, Output};
use std::sync::Arc;

use densecloud_blobs::{Blobs, Patience, Settings, open};

use crate::support::{densecloud, run, sphere, within};

/// Points of a tile here, the fewest that are allowed.
const TILE: [&str; 2] = ["--tile-points", "1000"];
const SECRET: &str = "hunter2hunter2";

/// What the environment says of the store.
fn variables() -> [(&'static str, String); 5] {
    let endpoint = std::env::var("DENSECLOUD_TEST_S3").expect(
        "DENSECLOUD_TEST_S3 is not set: run this by `sh scripts/with-services.sh cargo test … -- --include-ignored`",
    );
    [
        ("AWS_ENDPOINT_URL", endpoint),
        ("AWS_ALLOW_HTTP", "true".into()),
        ("AWS_ACCESS_KEY_ID", "test".into()),
        ("AWS_SECRET_ACCESS_KEY", SECRET.into()),
        ("AWS_REGION", "us-east-1".into()),
    ]
}

fn command(arguments: &[&str]) -> Command {
    let mut command = densecloud();
    command.args(arguments).envs(variables());
    command
}

fn stored(arguments: &[&str]) -> Output {
    command(arguments).output().expect("the program starts")
}

fn address(name: &str) -> String {
    format!("s3://densecloud-test/{name}")
}

fn at(prefix: &str) -> Arc<dyn Blobs> {
    let variables = variables().map(|(name, value)| (name.to_owned(), value));
    open(&address(prefix), &Settings::new(variables, Patience::default())).expect("an address")
}

fn put(prefix: &str, name: &str, bytes: &[u8]) {
    let mut sink = at(prefix).create(name).expect("an object");
    sink.write_all(bytes).expect("room");
    sink.finish().expect("an object");
}

fn get(prefix: &str, name: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    at(prefix).open(name).expect("an object").read_to_end(&mut bytes).expect("bytes");
    bytes
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn steps_at_an_address_give_what_the_command_gives() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(2500)).expect("a file");
    put("steps", "in.xyz", sphere(2500).as_bytes());
    let temp = path("temp");
    let plain = ["upsample", &path("in.xyz"), &path("plain.laz"), "--ratio", "2", "--temp-dir", &temp];
    assert!(run(&[&plain[..], &TILE].concat()).status.success());
    let (input, work, output) = (address("steps/in.xyz"), address("steps/work"), address("steps/dense.laz"));
    let away = ["--temp-dir", &temp];
    let plan =
        [&["tiles", "plan", &input, &work, "--for", "x.laz", "--ratio", "2"][..], &away, &TILE].concat();
    let planned = stored(&plan);
    assert_eq!(planned.stdout, b"3\n", "{planned:?}");
    let again = stored(&plan);
    assert_eq!(again.status.code(), Some(1));
    assert!(told(&again).contains(&format!("{work}: tiles are planned there already")), "{again:?}");
    let join = [&["tiles", "join", &work, &output][..], &away].concat();
    let early = stored(&join);
    assert_eq!(early.status.code(), Some(1));
    assert!(told(&early).contains("tiles are not done: 0, 1, 2"), "{early:?}");
    assert!(at("steps").open("dense.laz").is_err(), "nothing is there before it is whole");
    for tiles in [&["2", "0"][..], &["2"], &[]] {
        let done = stored(&[&["tiles", "run", &work][..], &away, tiles].concat());
        assert!(done.status.success(), "{done:?}");
    }
    let none = stored(&[&["tiles", "run", &work, "3"][..], &away].concat());
    assert_eq!(none.status.code(), Some(64), "{none:?}");
    let joined = stored(&join);
    assert!(joined.status.success(), "{joined:?}");
    assert!(get("steps", "dense.laz") == std::fs::read(path("plain.laz")).expect("a file"));
    assert_eq!(std::fs::read_dir(&temp).expect("a folder").count(), 0, "what was fetched is gone");
    put("steps/work", "mine", b"another's");
    let remove = ["tiles", "remove", &work];
    assert!(stored(&remove).status.success());
    let left: Vec<_> = at("steps/work").list("").expect("names").into_iter().map(|one| one.name).collect();
    assert_eq!(left, ["mine"]);
    assert!(told(&stored(&remove)).contains("no tiles are planned there"));
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn two_machines_at_one_tile_and_one_that_is_killed_do_no_harm() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    put("twice", "in.xyz", sphere(2500).as_bytes());
    let (input, work) = (address("twice/in.xyz"), address("twice/work"));
    let planned = stored(&[&["tiles", "plan", &input, &work, "--ratio", "2"][..], &TILE].concat());
    assert_eq!(planned.stdout, b"3\n", "{planned:?}");
    let mut killed = command(&["tiles", "run", &work]).spawn().expect("the program starts");
    killed.kill().expect("killed");
    killed.wait().expect("the program ends");
    let both = [(); 2].map(|()| command(&["tiles", "run", &work, "0", "1", "2"]).spawn().expect("starts"));
    for mut one in both {
        assert!(one.wait().expect("the program ends").success());
    }
    let joined = stored(&["tiles", "join", &work, &path("joined.xyz")]);
    assert!(joined.status.success(), "{joined:?}");
    let whole =
        stored(&[&["upsample", &input, &address("twice/whole.xyz"), "--ratio", "2"][..], &TILE].concat());
    assert!(whole.status.success(), "{whole:?}");
    assert!(get("twice", "whole.xyz") == std::fs::read(path("joined.xyz")).expect("a file"));
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn objects_are_clouds_like_files_whatever_their_format() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(600)).expect("a file");
    for name in ["in.laz", "in.npy"] {
        assert!(run(&["upsample", &path("in.xyz"), &path(name), "--ratio", "1"]).status.success());
        put("formats", name, &std::fs::read(path(name)).expect("a file"));
        let made = stored(&["upsample", &address(&format!("formats/{name}")), &address("formats/out.npy")]);
        assert!(made.status.success(), "{made:?}");
        assert!(run(&["upsample", &path(name), &path("out.npy")]).status.success());
        for out in ["out.npy", "out.npy.provenance.txt"] {
            assert!(get("formats", out) == std::fs::read(path(out)).expect("a file"), "{name} {out}");
        }
    }
    put("formats", "text.ply", sphere(600).as_bytes());
    let named = stored(&["inspect", &address("formats/text.ply")]);
    assert!(told(&named).contains("text that does not begin with"), "its name counts: {named:?}");
    let seen = stored(&["inspect", &address("formats/in.laz")]);
    assert!(seen.status.success() && String::from_utf8_lossy(&seen.stdout).contains("600"), "{seen:?}");
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn what_is_not_there_is_named_and_no_secret_is() {
    let none = |arguments: &[&str], names: &str| {
        let output = stored(arguments);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let told = told(&output);
        assert!(told.contains(names) && !told.contains(SECRET), "{told}");
        assert_eq!(told.matches("s3://").count(), 1, "{told}");
    };
    none(&["upsample", &address("none.ply"), "-"], "s3://densecloud-test/none.ply: ");
    none(&["tiles", "run", &address("none")], "s3://densecloud-test/none: no tiles are planned there");
    none(&["inspect", "s3://densecloud-none/a.ply"], "s3://densecloud-none/a.ply: ");
}

#[test]
fn addresses_that_lead_nowhere_are_refused_and_not_repeated() {
    let secret = format!("s3://me:{SECRET}@bucket/a.ply");
    let commands = [
        &["upsample", &secret, "out.ply"][..],
        &["upsample", "in.ply", &secret],
        &["tiles", "plan", &secret, "work"],
        &["tiles", "plan", "in.ply", &secret],
        &["tiles", "plan", "in.ply", "work", "--for", &secret],
        &["tiles", "run", &secret],
        &["tiles", "join", &secret, "out.ply"],
        &["tiles", "join", "work", &secret],
        &["inspect", &secret],
    ];
    for command in commands {
        let output = run(command);
        assert_eq!(output.status.code(), Some(64), "{command:?} {output:?}");
        let told = told(&output);
        assert!(told.contains("belong in the environment") && !told.contains(SECRET), "{command:?} {told}");
    }
    let other = run(&["upsample", "ftp://host/in.ply", "out.ply"]);
    assert_eq!(other.status.code(), Some(64), "{other:?}");
    assert!(told(&other).contains("ftp:// is no address of files"), "{other:?}");
}

#[cfg(unix)]
#[test]
fn a_file_address_is_its_path() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = within(&folder);
    std::fs::write(path("in.xyz"), sphere(300)).expect("a file");
    let file = |name: &str| format!("file://{}", path(name));
    let made = run(&["upsample", &file("in.xyz"), &file("out.ply"), "--ratio", "2"]);
    assert!(made.status.success(), "{made:?}");
    let planned = run(&["tiles", "plan", &file("in.xyz"), &file("work"), "--for", "x.ply", "--ratio", "2"]);
    assert_eq!(planned.stdout, b"1\n", "{planned:?}");
    assert!(run(&["tiles", "run", &path("work")]).status.success());
    assert!(run(&["tiles", "join", &file("work"), &file("joined.ply")]).status.success());
    let read = |name: &str| std::fs::read(path(name)).expect("a file");
    assert!(read("joined.ply") == read("out.ply"));
}
