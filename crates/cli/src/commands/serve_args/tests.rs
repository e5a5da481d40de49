use clap::Parser;
use densecloud_jobs::Keeping;

use super::seconds::LONGEST;
use super::*;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    serve: ServeArgs,
}

fn parse(arguments: &[&str]) -> Result<ServeArgs, clap::Error> {
    Line::try_parse_from([&["serve"], arguments].concat()).map(|line| line.serve)
}

#[test]
fn without_arguments_the_settings_are_the_servers_defaults() {
    assert_eq!(parse(&[]).expect("arguments").config(Role::Server), Config::default());
}

#[test]
fn a_folder_turns_jobs_on_with_the_defaults_of_the_library() {
    let checked = |arguments: &[&str], role| parse(arguments).expect("arguments").check(role);
    let config = checked(&["--data-dir=x"], Role::Server).expect("settings").config;
    assert_eq!(config.jobs, Some(Settings::new("x".into())));
    let none = checked(&["--data-dir=x", "--jobs-running=0"], Role::Server);
    assert!(none.err().expect("none would run").to_string().contains("--jobs-running"));
}

#[test]
fn a_database_and_a_store_are_shared_and_go_together() {
    let shared = ["--database=postgres://a@b/c", "--store=s3://d"];
    let checked = |arguments: &[&str], role| parse(arguments).expect("arguments").check(role);
    let config =
        checked(&[&shared[..], &["--jobs-running=0"]].concat(), Role::Server).expect("settings").config;
    let jobs = config.jobs.expect("jobs");
    assert_eq!((jobs.folder(), jobs.running, jobs.lease.as_secs()), (None, 0, 30));
    for (arguments, role, word) in [
        (&shared[..1], Role::Server, "--store"),
        (&shared[1..], Role::Server, "--database"),
        (&[shared[0], "--data-dir=x"][..], Role::Server, "--data-dir"),
        (&["--database-password-file=x"][..], Role::Server, "--database"),
        (&["--data-dir=x"][..], Role::Worker, "--database"),
        (&[][..], Role::Worker, "--store"),
        (&[shared[0], shared[1], "--jobs-running=0"][..], Role::Worker, "--jobs-running"),
    ] {
        let refused = checked(arguments, role).err().expect("it cannot work").to_string();
        assert!(refused.contains(word), "{arguments:?}: {refused}");
    }
}

#[cfg(unix)]
#[test]
fn the_password_of_the_database_is_in_a_file_that_not_everybody_reads() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("password");
    let file = format!("--database-password-file={}", path.display());
    let shared = ["--database=postgres://a@b/c", "--store=s3://d", &file];
    let check = || parse(&shared).expect("arguments").check(Role::Server);
    let refused = || check().err().expect("no password").to_string();
    assert!(refused().starts_with(&file.replace('=', " ")), "{}", refused());
    std::fs::write(&path, "secret\n").expect("a file");
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o604)).expect("a mode");
    assert!(refused().contains("everybody") && !refused().contains("secret"), "{}", refused());
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o400)).expect("a mode");
    let keeping = check().expect("settings").config.jobs.expect("jobs").keeping;
    assert!(!format!("{keeping:?}").contains("secret"), "{keeping:?}");
    let Keeping::Shared { password, .. } = keeping else { panic!("{keeping:?}") };
    assert_eq!(password, Some("secret".to_owned().into()));
}

#[test]
fn each_flag_sets_its_own_limit() {
    let args = parse(&[
        "--max-body-bytes=1",
        "--max-points-in=2",
        "--max-points-out=3",
        "--max-held-bytes=4",
        "--max-temp-bytes=7",
        "--max-connections=5",
        "--client-connections=6",
        "--head-timeout=0.5",
        "--keep-alive-timeout=6.5",
        "--stall-timeout=7",
        "--request-timeout=8",
        "--drain-lead=9",
        "--drain-timeout=0",
    ]);
    let Config { limits, timeouts, .. } = args.expect("arguments").config(Role::Server);
    let expected = Limits {
        body_bytes: 1,
        points_in: 2,
        points_out: 3,
        held_bytes: 4,
        temp_bytes: 7,
        connections: 5,
        client_connections: 6,
    };
    assert_eq!(limits, expected);
    assert_eq!(timeouts.head, Duration::from_millis(500));
    assert_eq!(timeouts.keep_alive, Duration::from_millis(6500));
    assert_eq!(timeouts.stall, Duration::from_secs(7));
    assert_eq!(timeouts.request, Duration::from_secs(8));
    assert_eq!(timeouts.lead, Duration::from_secs(9));
    assert_eq!(timeouts.drain, Duration::ZERO);
}

#[test]
fn every_option_is_a_setting() {
    use clap::CommandFactory;
    for option in Line::command().get_arguments() {
        let name = option.get_long().expect("a name");
        let variable = option.get_env().map(|name| name.to_string_lossy().into_owned());
        let expected = format!("DENSECLOUD_{}", name.replace('-', "_").to_uppercase());
        match name {
            // Not a setting but something to do.
            "print-config" => assert_eq!(variable, None),
            _ => assert_eq!(variable, Some(expected), "--{name} needs an `env`"),
        }
        assert!(option.get_help().is_some(), "--{name} needs help");
    }
}

#[test]
fn what_is_open_and_how_much_memory_there_is_can_be_chosen() {
    let access = |arguments: &[&str]| parse(arguments).expect("arguments").config(Role::Server).access;
    assert!(!access(&["--open=health,docs"]).open_metrics);
    let none = access(&["--open=none", "--trust-forwarded"]);
    assert!(!none.open_health && !none.open_metrics && !none.open_docs && none.trust_forwarded);
    assert!(parse(&["--open=doors"]).is_err());
    for (text, expected) in [("auto", Some(Memory::Auto)), ("5", Some(Memory::Bytes(5))), ("0", None)] {
        let parsed = parse(&[&format!("--max-memory={text}")]).ok().map(|args| args.max_memory);
        assert_eq!(parsed, expected);
    }
}

#[test]
fn a_duration_must_be_one() {
    for bad in ["-1", "x", "", "nan", "inf", "1e30", "1e19", "315360001"] {
        assert!(seconds(bad).is_err(), "{bad}");
    }
    assert_eq!(seconds("315360000"), Ok(LONGEST));
}
