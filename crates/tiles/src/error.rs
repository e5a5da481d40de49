//! What goes wrong with tiles.

use std::io;
use std::path::{Path, PathBuf};

use densecloud::PrepareError;
use densecloud_cascade::CascadeError;
use densecloud_cloud::Position;
use densecloud_formats::{Format, FormatError};

/// Why a cloud cannot be worked on in tiles.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TilesError {
    /// The input cannot be read, or the result not be written.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The options do not fit the cloud.
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    /// The cloud cannot be upsampled, or the work was stopped.
    #[error(transparent)]
    Cascade(#[from] CascadeError),
    /// The same of one tile.
    #[error("tile {tile}, from {} to {}: {why}", place(.bounds[0]), place(.bounds[1]))]
    Tile {
        /// Its number, from 0.
        tile: u32,
        /// The lowest and the highest coordinates of its points.
        bounds: [Position; 2],
        /// What went wrong.
        why: CascadeError,
    },
    /// A file of ours cannot be read or written.
    #[error("{}: {why}", path.display())]
    File {
        /// Which one.
        path: PathBuf,
        /// What went wrong.
        why: io::Error,
    },
    /// A file of ours is not as it was written.
    #[error("{}: {why}; plan the tiles anew", path.display())]
    Broken {
        /// Which one.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The disk has no room for the work.
    #[error(
        "{}: the work needs about {} there, and {} are free; name a folder on another disk",
        folder.display(), readable(*needed), readable(*free)
    )]
    NoSpace {
        /// The folder for the work.
        folder: PathBuf,
        /// Bytes that are free.
        free: u64,
        /// Bytes that are needed, about.
        needed: u64,
    },
    /// A format whose files are made of whole clouds.
    #[error(
        "{format} is written of a whole cloud, and this one is worked on in tiles, since it has more than {tile_points} points: \
         write {}, or allow for so many points in a tile, and memory for them all",
        among(endings)
    )]
    NotInParts {
        /// The result's.
        format: Box<Format>,
        /// The most points of a tile.
        tile_points: u64,
        /// Extensions of those that will do.
        endings: Vec<String>,
    },
    /// Tiles that are to be joined are not there.
    #[error("tiles are not done: {}", numbers(.0))]
    NotDone(Vec<u32>),
    /// There is no such tile.
    #[error("there is no tile {tile}; they are numbered from 0 to {last}")]
    NoTile {
        /// The number that was given.
        tile: u32,
        /// The last one.
        last: u32,
    },
    /// What is to be gone on with was begun otherwise.
    #[error("{}: begun with another {what} ({there}, and now {here}); remove that folder to begin anew", folder.display())]
    Differs {
        /// The folder of the work.
        folder: PathBuf,
        /// What is not the same.
        what: &'static str,
        /// As it was.
        there: String,
        /// As it is now.
        here: String,
    },
    /// Another program works in the folder.
    #[error("{}: another program works there", .0.display())]
    Busy(PathBuf),
    /// A folder for a plan holds something else.
    #[error("{}: the folder is not empty", .0.display())]
    NotEmpty(PathBuf),
}

impl TilesError {
    /// Of a file of ours.
    pub(crate) fn file(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |why| Self::File { path, why }
    }

    pub(crate) fn broken(path: &Path, why: impl Into<String>) -> Self {
        Self::Broken { path: path.to_owned(), why: why.into() }
    }
}

fn place([x, y, z]: Position) -> String {
    format!("({x}, {y}, {z})")
}

/// Bytes for people.
fn readable(bytes: u64) -> String {
    let giga = bytes as f64 / 1e9;
    if giga >= 1.0 { format!("{giga:.1} GB") } else { format!("{:.1} MB", 1e3 * giga) }
}

fn among(names: &[String]) -> String {
    match names {
        [others @ .., last] if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => names.concat(),
    }
}

/// The first of some numbers, and how many there are beside them.
fn numbers(tiles: &[u32]) -> String {
    let first: Vec<String> = tiles.iter().take(10).map(u32::to_string).collect();
    let more = tiles.len() - first.len();
    if more > 0 { format!("{} and {more} more", first.join(", ")) } else { first.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_are_readable() {
        assert_eq!(
            TilesError::NotDone((0..12).collect()).to_string(),
            "tiles are not done: 0, 1, 2, 3, 4, 5, 6, 7, 8, 9 and 2 more"
        );
        assert_eq!(TilesError::NotDone(vec![3]).to_string(), "tiles are not done: 3");
        let none = TilesError::NoSpace { folder: "/tmp".into(), free: 2_000_000, needed: 3_210_000_000 };
        let told =
            "/tmp: the work needs about 3.2 GB there, and 2.0 MB are free; name a folder on another disk";
        assert_eq!(none.to_string(), told);
        assert_eq!(among(&[".ply", ".las", ".xyz"].map(String::from)), ".ply, .las or .xyz");
        let tile =
            TilesError::Tile { tile: 3, bounds: [[0.0; 3], [1.0, 2.5, 3.0]], why: CascadeError::Cancelled };
        assert_eq!(tile.to_string(), "tile 3, from (0, 0, 0) to (1, 2.5, 3): cancelled");
    }
}
