//! What drives tiles by other schedulers, in `deploy/batch/`.

use std::path::PathBuf;
use std::process::{Command, Output};

use crate::support::{PROGRAM, run, sphere, within};

const OPTIONS: [&str; 4] = ["--ratio", "2", "--tile-points", "1000"];

fn batch(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../deploy/batch").join(name)
}

/// A cloud of three tiles, and what the program makes of it at once.
fn cloud() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let [input, whole] = ["in.xyz", "whole.laz"].map(within(&folder));
    std::fs::write(&input, sphere(2500)).expect("a file");
    assert!(run(&[&["upsample", &input, &whole][..], &OPTIONS].concat()).status.success());
    folder
}

/// Runs a script, for which the program and what lies in the folder are on the path.
fn script(name: &str, folder: &tempfile::TempDir, output: &str) -> Output {
    let path = within(folder);
    let own = PathBuf::from(PROGRAM).parent().expect("a folder").display().to_string();
    let paths = format!("{}:{own}:{}", path("bin"), std::env::var("PATH").expect("a path"));
    let done = Command::new("sh")
        .arg(batch(name))
        .args([&path("in.xyz"), &path("work"), &path(output)])
        .args(OPTIONS)
        .env("PATH", paths)
        .env("ASKED", path("asked"))
        .output()
        .expect("sh");
    assert!(done.status.success(), "{done:?}");
    let read = |name: &str| std::fs::read(path(name)).expect("a file");
    assert!(read(output) == read("whole.laz"), "{name}");
    done
}

#[cfg(unix)]
#[test]
fn the_loop_gives_what_the_command_gives() {
    script("loop.sh", &cloud(), "loop.laz");
}

/// Runs at once what Slurm would have run when its turn had come.
#[cfg(unix)]
const SBATCH: &str = r#"#!/bin/sh
echo "$@" >>"$ASKED"
last=0
while [ $# -gt 0 ]; do
    case $1 in
        --array=0-*) last=${1#--array=0-} ;;
        --cpus-per-task=*) export SLURM_CPUS_PER_TASK="${1#*=}" ;;
        --wrap) shift; wrap=$1 ;;
    esac
    shift
done
for task in $(seq 0 "$last"); do SLURM_ARRAY_TASK_ID=$task sh -c "$wrap" >&2 || exit 1; done
echo "17;here"
"#;

#[cfg(unix)]
#[test]
fn an_array_of_slurm_gives_what_the_command_gives() {
    use std::os::unix::fs::PermissionsExt;
    let folder = cloud();
    let path = within(&folder);
    std::fs::create_dir(path("bin")).expect("a folder");
    std::fs::write(path("bin/sbatch"), SBATCH).expect("a file");
    std::fs::set_permissions(path("bin/sbatch"), PermissionsExt::from_mode(0o755)).expect("a mode");
    let done = script("slurm.sh", &folder, "slurm.laz");
    assert_eq!(done.stdout, b"17;here\n");
    let asked = std::fs::read_to_string(path("asked")).expect("a file");
    let asked: Vec<&str> = asked.lines().collect();
    assert!(asked.len() == 2 && asked[0].contains("--array=0-2 "), "{asked:?}");
    assert!(asked[1].contains("--dependency=afterok:17 "), "{asked:?}");
}

#[test]
fn the_job_of_kubernetes_runs_each_tile() {
    let manifest = std::fs::read_to_string(batch("kubernetes.yaml")).expect("a file");
    let lines: Vec<&str> = manifest.lines().map(|line| line.trim().trim_start_matches("- ")).collect();
    let value = |field: &str| {
        let found = lines.iter().find_map(|line| line.strip_prefix(field)?.strip_prefix(": "));
        found.unwrap_or_else(|| panic!("no {field}"))
    };
    let expected = [
        ("apiVersion", "batch/v1"),
        ("kind", "Job"),
        ("completionMode", "Indexed"),
        // Without, there are neither tries of an index nor rules about failures.
        ("restartPolicy", "Never"),
        ("runAsNonRoot", "true"),
        ("readOnlyRootFilesystem", "true"),
    ];
    for (field, set) in expected {
        assert_eq!(value(field), set, "{field}");
    }
    let image = format!("densecloud:{}", env!("CARGO_PKG_VERSION"));
    assert_eq!(value("image"), image);
    let folder = cloud();
    let path = within(&folder);
    let arguments: Vec<String> = serde_json::from_str(value("args")).expect("a list");
    let [input, work] = ["in.xyz", "work"].map(&path);
    let plan = [&["tiles", "plan", &input, &work, "--for", "x.laz"][..], &OPTIONS].concat();
    assert_eq!(run(&plan).stdout, b"3\n");
    for index in ["0", "1", "2"] {
        let fill =
            |argument: &String| argument.replace("$(WORK)", &work).replace("$(JOB_COMPLETION_INDEX)", index);
        let filled: Vec<String> = arguments.iter().map(fill).collect();
        assert!(filled.iter().all(|argument| !argument.contains('$')), "{filled:?}");
        let done = run(&filled.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(done.status.success(), "{done:?}");
    }
    assert!(run(&["tiles", "join", &work, &path("joined.laz")]).status.success());
    let read = |name: &str| std::fs::read(path(name)).expect("a file");
    assert!(read("joined.laz") == read("whole.laz"));
}
