//! The folder of the jobs: made where it is missing, and known to be of use before anything is begun.

use std::fs::{self, DirBuilder, DirEntry, OpenOptions};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::CliError;

/// Makes the folder where it is missing, and finds out whether it, and what is in it, can be written to.
///
/// # Errors
/// [`CliError::Usage`] with what to do.
pub(super) fn prepare(folder: &Path) -> Result<(), CliError> {
    let refused = |place: &Path, error: &io::Error| {
        CliError::Usage(format!(
            "--data-dir {}: {error}; {}",
            folder.display(),
            advice(folder, place, error.kind(), owners(place))
        ))
    };
    make_private(folder).map_err(|error| refused(existing(folder), &error))?;
    check_entries(folder).map_err(|(place, error)| refused(&place, &error))
}

/// Makes a folder, where it is missing, that nobody else on the machine can look into.
fn make_private(folder: &Path) -> io::Result<()> {
    let mut builder = DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

/// The folder, or the nearest above it that is there.
fn existing(folder: &Path) -> &Path {
    folder.ancestors().find(|place| place.exists()).unwrap_or(folder)
}

/// Whether the folder and what an earlier server left directly in it can be written to; if not, what cannot. What else may
/// lie there, such as a file system's own folders, is nothing to us.
fn check_entries(folder: &Path) -> Result<(), (PathBuf, io::Error)> {
    let at = |place: &Path| {
        let place = place.to_owned();
        move |error| (place, error)
    };
    check_folder(folder).map_err(at(folder))?;
    for entry in fs::read_dir(folder).map_err(at(folder))? {
        let entry = entry.map_err(at(folder))?;
        check_entry(&entry).map_err(at(&entry.path()))?;
    }
    Ok(())
}

/// The database with what SQLite keeps beside it, and the folder of the files.
fn check_entry(entry: &DirEntry) -> io::Result<()> {
    match entry.file_name().to_string_lossy() {
        name if name == "files" => check_folder(&entry.path()),
        name if name.starts_with("jobs.sqlite") => {
            OpenOptions::new().read(true).write(true).open(entry.path()).map(drop)
        }
        _ => Ok(()),
    }
}

/// By a file without a name, where there are such: what ends in between leaves nothing behind.
fn check_folder(folder: &Path) -> io::Result<()> {
    tempfile::tempfile_in(folder).map(drop)
}

/// What may help where `place` cannot be used: the folder itself, what is in it, or what it would be made in.
fn advice(folder: &Path, place: &Path, kind: ErrorKind, owners: Option<(u32, u32)>) -> String {
    let (within, folder, shown) = (place.starts_with(folder), folder.display(), place.display());
    match (kind, owners) {
        (ErrorKind::PermissionDenied, Some((owner, own))) if owner == own => {
            format!("{shown} belongs to uid {own}, as whom the server runs: `chmod -R u+rwX {shown}`")
        }
        (ErrorKind::PermissionDenied, Some((owner, own))) => {
            let remedy = if within { "chown -R" } else { "install -d -o" };
            format!(
                "{shown} belongs to uid {owner}, and the server runs as uid {own}: `{remedy} {own} {folder}` where it lies, or run the \
                 server as its owner (docker run --user {owner})"
            )
        }
        _ => "give it a folder that can be written to".to_owned(),
    }
}

/// Whose it is, and who this process is.
#[cfg(unix)]
fn owners(place: &Path) -> Option<(u32, u32)> {
    use std::os::unix::fs::MetadataExt;
    // A process's own entry there belongs to its user; where there is none, what it makes does.
    let own = fs::metadata("/proc/self").or_else(|_| tempfile::tempfile()?.metadata()).ok()?;
    Some((fs::metadata(place).ok()?.uid(), own.uid()))
}

#[cfg(not(unix))]
fn owners(_place: &Path) -> Option<(u32, u32)> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_made_and_one_with_jobs_is_taken_again() {
        let root = tempfile::tempdir().expect("a folder");
        let folder = root.path().join("a/b");
        prepare(&folder).expect("made");
        fs::create_dir(folder.join("files")).expect("a folder");
        fs::write(folder.join("jobs.sqlite"), "x").expect("a file");
        prepare(&folder).expect("taken again");
        assert_eq!(fs::read_dir(&folder).expect("a folder").count(), 2, "nothing is left behind");
        assert_eq!(fs::read(folder.join("jobs.sqlite")).expect("a file"), b"x");
    }

    #[test]
    #[cfg(unix)]
    fn what_is_not_ours_is_left_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        // Left by a server that was killed as it looked, when its number was what ours is.
        let probe = folder.path().join(format!(".densecloud-{}", std::process::id()));
        fs::write(&probe, "").expect("a file");
        // Not even root can write to these.
        std::os::unix::fs::symlink("/proc/self/fd", folder.path().join("lost+found")).expect("a link");
        std::os::unix::fs::symlink("/nowhere", folder.path().join("README")).expect("a link");
        prepare(folder.path()).expect("taken");
        std::os::unix::fs::symlink("/proc/self/fd", folder.path().join("files")).expect("a link");
        let Err(CliError::Usage(why)) = prepare(folder.path()) else { panic!("ours must be of use") };
        assert!(why.contains("that can be written to"), "{why}");
    }

    #[test]
    fn a_file_in_its_place_is_told() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let Err(CliError::Usage(why)) = prepare(&file.path().join("jobs")) else { panic!("a file") };
        assert!(why.starts_with("--data-dir ") && why.contains("that can be written to"), "{why}");
    }

    #[test]
    #[cfg(unix)]
    fn whose_it_is_and_who_needs_it_is_told() {
        let folder = tempfile::tempdir().expect("a folder");
        let (owner, own) = owners(folder.path()).expect("a user");
        assert_eq!(owner, own);
        for (place, owner, remedy) in [
            ("/srv/jobs", 7, "chmod -R u+rwX /srv/jobs"),
            ("/srv/jobs", 0, "chown -R 7 /srv/jobs"),
            ("/srv/jobs/jobs.sqlite", 0, "chown -R 7 /srv/jobs"),
            ("/srv", 0, "install -d -o 7 /srv/jobs"),
        ] {
            let (folder, denied) = (Path::new("/srv/jobs"), ErrorKind::PermissionDenied);
            let why = advice(folder, Path::new(place), denied, Some((owner, 7)));
            let start = format!("{place} belongs to uid {owner}, ");
            assert!(why.starts_with(&start) && why.contains(&format!("`{remedy}`")), "{why}");
            assert_eq!(why.contains("--user 0"), owner == 0, "{why}");
        }
    }
}
