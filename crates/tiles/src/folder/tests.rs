use std::fs;
use std::path::Path;

use super::leftovers::{TEMPORARY, kept_name};
use super::lock::LOCK;
use crate::{Folder, TilesError};

fn names(parent: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(parent)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
        .collect();
    names.sort();
    names
}

#[test]
fn temporary_folders_go_and_so_do_those_of_killed_programs() {
    let parent = tempfile::tempdir().expect("a folder");
    let first = Folder::temporary(parent.path()).expect("a folder");
    fs::write(first.manifest(), "x").expect("a file");
    // As one that was killed leaves it.
    let left = parent.path().join(format!("{TEMPORARY}0-0"));
    fs::create_dir(&left).expect("a folder");
    fs::write(left.join(LOCK), "").expect("a file");
    // As one that was killed while it removed its own.
    fs::create_dir(parent.path().join(format!("{TEMPORARY}0-1"))).expect("a folder");
    fs::create_dir(parent.path().join("densecloud-tiles")).expect("another's folder");
    let second = Folder::temporary(parent.path()).expect("a folder");
    assert!(first.manifest().exists() && !left.exists() && first.path() != second.path());
    drop((first, second));
    assert_eq!(names(parent.path()), ["densecloud-tiles"]);
}

#[test]
fn a_process_that_ends_takes_its_folders_along() {
    let parent = tempfile::tempdir().expect("a folder");
    let own = Folder::temporary(parent.path()).expect("a folder");
    fs::write(own.manifest(), "x").expect("a file");
    let others = parent.path().join(format!("{TEMPORARY}{}0-0", std::process::id()));
    fs::create_dir(&others).expect("a folder");
    Folder::remove_own(parent.path());
    assert!(!own.path().exists() && others.exists());
    drop(own);
    assert_eq!(names(parent.path()).len(), 1);
    Folder::remove_own(&parent.path().join("none"));
}

#[test]
fn a_folder_that_is_gone_on_with_stays_and_is_one_programs() {
    let parent = tempfile::tempdir().expect("a folder");
    let first = Folder::kept(parent.path(), "dense.ply").expect("a folder");
    let path = first.path().to_owned();
    assert!(matches!(Folder::kept(parent.path(), "dense.ply"), Err(TilesError::Busy(_))));
    assert_ne!(Folder::kept(parent.path(), "other.ply").expect("a folder").path(), path);
    drop(first);
    Folder::temporary(parent.path()).expect("a folder");
    assert!(path.exists());
    let folder = Folder::kept(parent.path(), "dense.ply").expect("a folder");
    fs::write(folder.manifest(), "x").expect("a file");
    assert!(folder.has_plan());
    // Of two others one is worked in.
    let other = Folder::kept(parent.path(), "other.ply").expect("a folder");
    drop(Folder::kept(parent.path(), "third.ply").expect("a folder"));
    Folder::keep_only(parent.path(), ["dense.ply"].into_iter()).expect("the others are removed");
    assert_eq!(names(parent.path()).len(), 2);
    drop(other);
    Folder::keep_only(parent.path(), ["dense.ply"].into_iter()).expect("the others are removed");
    assert_eq!(names(parent.path()), [kept_name("dense.ply")]);
    folder.remove().expect("removed");
    assert!(!path.exists());
}

#[test]
#[cfg(unix)]
fn nobody_else_sees_into_a_temporary_folder() {
    use std::os::unix::fs::PermissionsExt;
    let parent = tempfile::tempdir().expect("a folder");
    let temporary = Folder::temporary(parent.path()).expect("a folder");
    let kept = Folder::kept(parent.path(), "dense.ply").expect("a folder");
    for folder in [&temporary, &kept] {
        let mode = fs::metadata(folder.path()).expect("a folder").permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
    }
}

#[test]
fn programs_that_begin_at_once_do_not_take_each_others_folders_for_leftovers() {
    let parent = tempfile::tempdir().expect("a folder");
    let begin = || {
        for _ in 0..400 {
            let folder = Folder::temporary(parent.path()).expect("a folder of its own");
            std::fs::write(folder.path().join("mine"), "mine").expect("it is there");
            assert!(folder.path().join("lock").exists());
        }
    };
    std::thread::scope(|scope| (0..4).for_each(|_| drop(scope.spawn(begin))));
    assert_eq!(std::fs::read_dir(parent.path()).expect("a folder").count(), 0, "something is left");
}
