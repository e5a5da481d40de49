//! Files and standard streams as the commands name them: `-` is a standard stream.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use super::CliError;
use crate::cloud::{Attribute, Cloud, Origin, Position};
use crate::formats::{CloudReader, Format, Header, Limits, encode, read_cloud_file};

pub(super) fn is_stream(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// The path with `suffix` after its name.
pub(super) fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Reads a cloud, `-` from standard input.
pub(super) fn read_cloud(path: &Path) -> Result<(Cloud, Header), CliError> {
    let read = if is_stream(path) {
        CloudReader::open(BufReader::new(io::stdin().lock()), Limits::default()).and_then(|reader| {
            let header = reader.header().clone();
            Ok((reader.read()?, header))
        })
    } else {
        read_cloud_file(path)
    };
    read.map_err(|why| CliError::file(path, why))
}

/// Writes a cloud, `-` to standard output.
pub(super) fn write_cloud(
    path: &Path,
    format: Format,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<(), CliError> {
    write(path, |sink| {
        encode(sink, format, positions, attributes, origin)?;
        Ok(())
    })
}

/// Writes a file with `encode`, `-` to standard output. A file is made beside its name and
/// renamed, so that no failure leaves half a file under that name.
pub(super) fn write(
    path: &Path,
    encode: impl FnOnce(&mut dyn Write) -> Result<(), Box<dyn std::error::Error>>,
) -> Result<(), CliError> {
    if is_stream(path) {
        let mut sink = BufWriter::new(io::stdout().lock());
        return encode(&mut sink).and_then(|()| Ok(sink.flush()?)).map_err(|why| CliError::file(path, why));
    }
    let part = beside(path, ".part");
    let file = File::create(&part).map_err(|why| CliError::file(path, why))?;
    let mut sink = BufWriter::with_capacity(1 << 20, file);
    let written = encode(&mut sink).and_then(|()| Ok(sink.flush()?)).and_then(|()| {
        std::fs::rename(&part, path)?;
        Ok(())
    });
    written.map_err(|why| {
        // The first error is the one to report.
        let _ = std::fs::remove_file(&part);
        CliError::file(path, why)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_leaves_what_was_there() {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("cloud.xyz");
        write_cloud(&path, Format::TEXT, &[[1.0, 2.0, 3.0]], &[], &Origin::default()).expect("a file");
        let failed = write(&path, |sink| {
            sink.write_all(b"half")?;
            Err("no more".into())
        });
        assert!(matches!(failed, Err(CliError::File { .. })));
        assert_eq!(read_cloud(&path).expect("a cloud").0.positions, [[1.0, 2.0, 3.0]]);
        assert_eq!(std::fs::read_dir(dir.path()).expect("a folder").count(), 1, "a part was left");
    }
}
