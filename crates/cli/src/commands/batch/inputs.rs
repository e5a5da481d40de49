//! Names of inputs, patterns among them: a shell expands these, unless they are quoted or it is one of Windows.

use std::path::{Path, PathBuf};

use glob::{MatchOptions, glob_with};

use super::super::{CliError, files};

/// As shells have it: a `*` stays within a folder, and hidden files are named in full.
const AS_SHELLS: MatchOptions =
    MatchOptions { case_sensitive: true, require_literal_separator: true, require_literal_leading_dot: true };

/// The files that names stand for, those of a pattern in alphabetical order. A name of a file that is there stands for that one,
/// whatever its letters.
///
/// # Errors
/// [`CliError::Usage`] for a pattern of no file, or of none that can be; [`CliError::File`] for a folder that cannot be read.
pub(super) fn expand(names: &[PathBuf]) -> Result<Vec<PathBuf>, CliError> {
    let mut inputs = Vec::new();
    for name in names {
        match pattern(name) {
            Some(pattern) => inputs.extend(matching(pattern)?),
            None => inputs.push(name.clone()),
        }
    }
    Ok(inputs)
}

/// A name that is a pattern, and neither an address nor a file.
fn pattern(name: &Path) -> Option<&str> {
    let pattern = name.to_str().filter(|name| name.contains(['*', '?', '[']) && !name.contains("://"))?;
    (!files::is_stream(name) && name.symlink_metadata().is_err()).then_some(pattern)
}

fn matching(pattern: &str) -> Result<Vec<PathBuf>, CliError> {
    let paths = glob_with(pattern, AS_SHELLS)
        .map_err(|why| CliError::Usage(format!("{pattern}: no pattern of names: {why}")))?;
    let found: Vec<_> = paths
        .map(|path| path.map_err(|why| CliError::file(why.path(), why.error())))
        .collect::<Result<_, _>>()?;
    if found.is_empty() {
        return Err(CliError::Usage(format!("{pattern}: no file is called so")));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_expanded_as_shells_do_and_names_of_files_are_not() {
        let folder = tempfile::tempdir().expect("a folder");
        for name in ["b.ply", "a.ply", ".hidden.ply", "a.las", "[ab].ply"] {
            std::fs::write(folder.path().join(name), "").expect("a file");
        }
        let of = |name: &str| expand(&[folder.path().join(name)]);
        let names = |name: &str| -> Vec<String> {
            let file = |path: PathBuf| path.file_name().expect("a name").to_string_lossy().into_owned();
            of(name).expect("files").into_iter().map(file).collect()
        };
        assert_eq!(names("*.ply"), ["[ab].ply", "a.ply", "b.ply"]);
        assert_eq!(names("a.???"), ["a.las", "a.ply"]);
        assert_eq!(names("[ab].ply"), ["[ab].ply"], "it is there");
        assert_eq!(names("[b].ply"), ["b.ply"]);
        assert_eq!(names("none.ply"), ["none.ply"], "whoever reads it tells that it is not there");
        for wrong in ["*.e57", "[a"] {
            assert!(matches!(of(wrong), Err(CliError::Usage(_))), "{wrong}");
        }
        let address = PathBuf::from("s3://bucket/*.ply");
        assert_eq!(expand(std::slice::from_ref(&address)).expect("an address"), [address]);
    }
}
