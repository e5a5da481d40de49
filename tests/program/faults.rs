//! The machine or its files at fault: a full disk, no memory, a damaged model.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::support::{PATIENCE, PROGRAM, Serving, agent, run, sphere, wide_sphere};

/// What is done with jobs here.
impl Serving {
    /// Leaves a job; the status, and the document or problem.
    fn submit(&self, query: &str, body: &[u8]) -> (u16, Value) {
        let mut answer = self.post(&format!("/jobs?{query}"), body);
        let text = answer.body_mut().read_to_string().expect("text");
        (answer.status().as_u16(), serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text}")))
    }

    fn job(&self, id: &str) -> Value {
        serde_json::from_str(&self.page(&format!("/jobs/{id}"))).expect("JSON")
    }

    /// Waits until a job is over.
    fn end_of(&self, job: &Value) -> Value {
        let id = job["id"].as_str().unwrap_or_else(|| panic!("no job: {job}"));
        let start = Instant::now();
        loop {
            let job = self.job(id);
            if !["queued", "running"].contains(&job["state"].as_str().expect("a state")) {
                return job;
            }
            assert!(start.elapsed() < PATIENCE, "{job}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Bytes of the result of a job that is done.
    fn result(&self, job: &Value) -> Vec<u8> {
        let place = format!("/jobs/{}/result", job["id"].as_str().expect("an id"));
        let mut answer = agent().get(self.url(&place)).call().expect("an answer");
        assert_eq!(answer.status().as_u16(), 200);
        answer.body_mut().read_to_vec().expect("a body")
    }
}

/// The command of a launcher, which ends in becoming the program and its arguments.
fn by(launcher: &[&str]) -> Command {
    let mut command = Command::new(launcher[0]);
    command.args(&launcher[1..]).arg(PROGRAM);
    command
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

#[test]
fn a_file_that_finds_no_room_costs_its_own_job_and_room_that_is_made_is_used() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("jobs");
    // No file may grow past a megabyte: writes fail half way, as on a full disk. The shell's units are 512 bytes, or
    // 1024, and the signal that goes with the failure is ignored.
    let launcher = ["sh", "-c", "trap '' XFSZ; ulimit -S -f 2048; exec \"$@\"", "sh"];
    let serving = Serving::start_from(by(&launcher), &["--data-dir", text(&data)]);
    let limit = (1 << 20) * if cfg!(target_os = "linux") { 1 } else { 2 };
    let small = wide_sphere(400, 100);
    let (status, accepted) = serving.submit("ratio=2", &small);
    assert_eq!(status, 202, "{accepted}");
    let done = serving.end_of(&accepted);
    assert_eq!(done["state"], "done", "{done}");
    let kept = serving.result(&done);

    // Its cloud finds no room: refused at once.
    let large = wide_sphere(3000, 100);
    assert!(large.len() > limit);
    let (status, problem) = serving.submit("ratio=2", &large);
    assert_eq!((status, &problem["type"]), (507, &json!("urn:densecloud:problem:disk-full")), "{problem}");
    assert_eq!(problem["setting"], "--data-dir");
    // Its result finds no room: the job fails, and says so.
    let middle = wide_sphere(800, 100);
    assert!(middle.len() < limit && 4 * middle.len() > limit);
    let (status, accepted) = serving.submit("ratio=4", &middle);
    assert_eq!(status, 202, "{accepted}");
    let failed = serving.end_of(&accepted);
    assert_eq!(failed["problem"]["type"], "urn:densecloud:problem:disk-full", "{failed}");
    assert_eq!(failed["problem"]["status"], 507);
    // Nothing is left of either, and what was there is as it was.
    let files = || std::fs::read_dir(data.join("files")).expect("a folder").count();
    assert_eq!(files(), 1);
    assert_eq!(serving.job(done["id"].as_str().expect("an id")), done);
    assert!(serving.result(&done) == kept);

    let lifted = Command::new("prlimit").args(["--pid", &serving.id(), "--fsize=unlimited:"]).status();
    assert!(lifted.expect("prlimit is there").success());
    for (query, body) in [("ratio=2", &large), ("ratio=4", &middle)] {
        let (status, accepted) = serving.submit(query, body);
        assert_eq!(status, 202, "{accepted}");
        assert_eq!(serving.end_of(&accepted)["state"], "done");
    }
    assert_eq!(files(), 3);
}

/// A disk of its own, 2 MB large, where the system lets a program have one.
#[test]
fn a_disk_that_is_full_refuses_jobs_keeps_those_it_has_and_takes_more_when_there_is_room() {
    let folder = tempfile::tempdir().expect("a folder");
    let mount = "mount -t tmpfs -o size=2m none \"$0\" && exec \"$@\"";
    let launcher =
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount, text(folder.path())];
    let allowed = Command::new(launcher[0]).args(&launcher[1..]).arg("true").output();
    if !allowed.is_ok_and(|output| output.status.success()) {
        println!("no disk of one's own is to be had here; the test beside this one limits files instead");
        return;
    }
    let data = folder.path().join("jobs");
    let serving = Serving::start_from(by(&launcher), &["--data-dir", text(&data)]);
    // The disk as the program sees it.
    let disk = PathBuf::from(format!("/proc/{}/root{}", serving.id(), text(folder.path())));
    let small = wide_sphere(400, 10);
    let done = serving.end_of(&serving.submit("ratio=2", &small).1);
    assert_eq!(done["state"], "done", "{done}");
    let kept = serving.result(&done);

    let mut filler = std::fs::File::create(disk.join("filler")).expect("a file");
    while filler.write_all(&[0; 512]).is_ok() {}
    for _ in 0..3 {
        let (status, problem) = serving.submit("ratio=2", &small);
        assert_eq!(
            (status, &problem["type"]),
            (507, &json!("urn:densecloud:problem:disk-full")),
            "{problem}"
        );
    }
    assert_eq!(serving.job(done["id"].as_str().expect("an id")), done);
    assert!(serving.result(&done) == kept);
    let live = serving.post("/upsample?ratio=2", &small);
    assert_eq!(live.status().as_u16(), 200, "who needs no disk is served");

    std::fs::remove_file(disk.join("filler")).expect("room");
    drop(filler);
    let again = serving.end_of(&serving.submit("ratio=2", &small).1);
    assert_eq!(again["state"], "done", "{again}");
    assert!(serving.result(&again) == kept);
}

#[test]
#[cfg(target_os = "linux")]
fn a_request_for_which_the_system_has_no_memory_gets_507_and_others_go_on() {
    // One heap for all threads, so that the size tells what is left.
    let limited = |kilobytes: &str| {
        let mut shell = Command::new("sh");
        let script = format!("ulimit -v {kilobytes} && exec \"$0\" \"$@\"");
        shell.args(["-c", &script, PROGRAM]).env("MALLOC_ARENA_MAX", "1");
        Serving::start_from(shell, &["--max-memory", "1000000000000"])
    };
    let idle = limited("unlimited").kilobytes("VmPeak:");
    // Room for 300,000 points, but not for what the first level knows of each: 158 MB.
    let serving = limited(&(idle + 140_000).to_string());
    let mut refused = serving.post("/upsample?ratio=4", sphere(300_000).as_bytes());
    let answer = refused.body_mut().read_to_string().expect("a body");
    assert_eq!(refused.status(), 507, "{answer}");
    assert!(answer.contains("out-of-memory"), "{answer}");
    assert_eq!(serving.post("/upsample?ratio=4", sphere(300).as_bytes()).status(), 200);
}

#[test]
fn a_damaged_model_is_named_before_a_port_is_bound() {
    let ours = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/default");
    let read = |name: &str| std::fs::read(ours.join(name)).expect("a file");
    let hash = |bytes: &[u8]| {
        use sha2::{Digest, Sha256};
        Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect::<String>()
    };
    let unit = read("unit2.onnx");
    let half = unit[..unit.len() / 2].to_vec();
    let mut flipped = unit.clone();
    flipped[1000] ^= 1;
    // Whole by its card, and yet no model.
    let card = String::from_utf8(read("model.toml")).expect("text");
    let other_card = card.replace(&hash(&unit), &hash(&half)).into_bytes();
    let no_card = card.replace("patch_size", "patch").into_bytes();
    // Taken, so that a program that came to bind it would name it.
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();
    let out_card = card.replace("unit2.onnx", "../unit2.onnx").into_bytes();
    type Damage<'a> = (&'a str, &'a [(&'a str, Option<&'a [u8]>)], &'a [&'a str]);
    let damages: [Damage; 6] = [
        ("a bit is flipped", &[("unit2.onnx", Some(&flipped))], &["unit2.onnx is damaged", "SHA-256"]),
        ("it is cut short", &[("unit2.onnx", Some(&half))], &["unit2.onnx is damaged"]),
        ("it is gone", &[("unit2.onnx", None)], &["unit2.onnx"]),
        ("its card says so", &[("unit2.onnx", Some(&half)), ("model.toml", Some(&other_card))], &["unit"]),
        ("its card leads elsewhere", &[("model.toml", Some(&out_card))], &["not a plain file name"]),
        ("the card is broken", &[("model.toml", Some(&no_card))], &["model.toml", "patch_size"]),
    ];
    for (what, changes, words) in damages {
        let folder = tempfile::tempdir().expect("a folder");
        for name in ["model.toml", "unit1.onnx", "unit2.onnx", "unit3.onnx", "unit4.onnx"] {
            match changes.iter().find(|(changed, _)| *changed == name) {
                Some((_, None)) => {}
                Some((_, Some(bytes))) => std::fs::write(folder.path().join(name), bytes).expect("a file"),
                None => std::fs::write(folder.path().join(name), read(name)).expect("a file"),
            }
        }
        let model = folder.path();
        let output = run(&["serve", "--port", &port, "--threads", "1", "--model", text(model)]);
        let said = String::from_utf8_lossy(&output.stderr);
        // A wrong setting, unless only the runtime can tell.
        let code = if what == "its card says so" { 1 } else { 64 };
        assert_eq!(output.status.code(), Some(code), "{what}: {said}");
        assert!(said.contains(text(model)) || said.contains("model default"), "{what}: {said}");
        for word in words {
            assert!(said.contains(word), "{what}: {said}");
        }
        assert!(!said.contains("listening") && !said.contains(&port), "{what}: {said}");
        assert!(!said.contains("panicked"), "{what}: {said}");
    }
}

#[test]
fn all_of_the_program_has_one_allocator() {
    let serving = Serving::start(&[]);
    // It has loaded and run ONNX Runtime by now. The system's allocator would have made its heap.
    let maps = std::fs::read_to_string(format!("/proc/{}/maps", serving.id())).expect("it runs");
    assert!(maps.contains("libonnxruntime"), "{maps}");
    assert!(!maps.contains("[heap]"), "{maps}");
}
