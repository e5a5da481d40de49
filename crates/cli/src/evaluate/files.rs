//! Finding the files that belong together.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use densecloud_formats::Format;

/// The files of a folder (or one file), by their names without extension: a shape has the same name
/// in the folders of inputs, references, meshes and predictions.
#[derive(Debug, Clone)]
pub(crate) struct FileSet {
    root: PathBuf,
    files: BTreeMap<String, PathBuf>,
    single: bool,
}

/// Which files of a folder count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// Extensions of [`Format::from_extension`], but for meshes.
    Cloud,
    /// `.ply` and `.off`.
    Mesh,
}

/// Why files cannot be matched.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SetError {
    /// The path is missing or cannot be listed.
    #[error("{}: {why}", path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// What went wrong.
        why: io::Error,
    },
    /// The folder holds nothing to use.
    #[error("{}: no {what} in this folder", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
        /// What was looked for.
        what: &'static str,
    },
    /// Two files of a folder differ in nothing but their extension.
    #[error("{} and {} have the same name; keep one of them", first.display(), second.display())]
    Ambiguous {
        /// One file.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// A shape has no file in the folder.
    #[error("{}: nothing named `{name}` in this folder", path.display())]
    Missing {
        /// The folder.
        path: PathBuf,
        /// The shape.
        name: String,
    },
    /// One file cannot serve several shapes.
    #[error("{} is one file, but there are {shapes} shapes; name a folder", path.display())]
    OneForMany {
        /// The file.
        path: PathBuf,
        /// How many shapes there are.
        shapes: usize,
    },
}

impl FileSet {
    /// Lists a folder (not those within it), or takes one file whatever its extension.
    ///
    /// # Errors
    /// The path cannot be listed, has no fitting file, or has two of one name.
    pub(crate) fn open(path: &Path, kind: FileKind) -> Result<Self, SetError> {
        let failed = |why| SetError::Io { path: path.to_owned(), why };
        let mut set = Self { root: path.to_owned(), files: BTreeMap::new(), single: false };
        if !std::fs::metadata(path).map_err(failed)?.is_dir() {
            set.files.insert(stem(path), path.to_owned());
            set.single = true;
            return Ok(set);
        }
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(path).map_err(failed)? {
            paths.push(entry.map_err(failed)?.path());
        }
        // Listings come in any order; errors should not.
        paths.sort();
        for file in paths.into_iter().filter(|p| kind.takes(p) && p.is_file()) {
            if let Some(first) = set.files.insert(stem(&file), file.clone()) {
                return Err(SetError::Ambiguous { first, second: file });
            }
        }
        if set.files.is_empty() {
            return Err(SetError::Empty { path: path.to_owned(), what: kind.what() });
        }
        Ok(set)
    }

    /// The shapes, in alphabetical order.
    #[must_use]
    pub(crate) fn names(&self) -> Vec<String> {
        self.files.keys().cloned().collect()
    }

    /// The files of the named shapes, in their order. One file serves one shape under any name.
    ///
    /// # Errors
    /// A shape has no file.
    pub(crate) fn matching(&self, names: &[String]) -> Result<Vec<&Path>, SetError> {
        if self.single && names.len() > 1 {
            return Err(SetError::OneForMany { path: self.root.clone(), shapes: names.len() });
        }
        let find = |name: &String| {
            let found = if self.single { self.files.values().next() } else { self.files.get(name) };
            found
                .map(PathBuf::as_path)
                .ok_or_else(|| SetError::Missing { path: self.root.clone(), name: name.clone() })
        };
        names.iter().map(find).collect()
    }
}

impl FileKind {
    fn takes(self, path: &Path) -> bool {
        match self {
            // Meshes are read as clouds, too, but lie beside the clouds made of them.
            Self::Cloud => Format::from_extension(path).is_some_and(Format::is_written),
            Self::Mesh => path
                .extension()
                .is_some_and(|e| e.eq_ignore_ascii_case("ply") || e.eq_ignore_ascii_case("off")),
        }
    }

    fn what(self) -> &'static str {
        match self {
            Self::Cloud => "clouds (.ply, .xyz)",
            Self::Mesh => "meshes (.ply, .off)",
        }
    }
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        for file in files {
            std::fs::write(folder.path().join(file), "").expect("a file");
        }
        folder
    }

    #[test]
    fn shapes_are_matched_by_name() {
        let clouds = folder(&["b.xyz", "a.ply", "notes.md"]);
        let meshes = folder(&["a.off", "b.PLY", "c.off", "c.xyz"]);
        let names = FileSet::open(clouds.path(), FileKind::Cloud).expect("clouds").names();
        assert_eq!(names, ["a", "b"]);
        let meshes = FileSet::open(meshes.path(), FileKind::Mesh).expect("meshes");
        let files = meshes.matching(&names).expect("both");
        assert!(files[0].ends_with("a.off") && files[1].ends_with("b.PLY"));
        let error = meshes.matching(&["d".to_owned()]).expect_err("missing").to_string();
        assert!(error.contains("`d`"), "{error}");
    }

    #[test]
    fn one_file_serves_one_shape() {
        let clouds = folder(&["a.xyz"]);
        let set = FileSet::open(&clouds.path().join("a.xyz"), FileKind::Cloud).expect("a file");
        assert_eq!(set.names(), ["a"]);
        assert!(set.matching(&["z".to_owned()]).is_ok());
        let error = set.matching(&["x".to_owned(), "y".to_owned()]).expect_err("two").to_string();
        assert!(error.contains("2 shapes"), "{error}");
    }

    #[test]
    fn folders_that_cannot_be_used_are_named() {
        let twice = folder(&["a.xyz", "a.ply"]);
        assert!(matches!(FileSet::open(twice.path(), FileKind::Cloud), Err(SetError::Ambiguous { .. })));
        let none = folder(&["a.md"]);
        assert!(matches!(FileSet::open(none.path(), FileKind::Cloud), Err(SetError::Empty { .. })));
        let gone = none.path().join("gone");
        assert!(matches!(FileSet::open(&gone, FileKind::Cloud), Err(SetError::Io { .. })));
    }
}
