//! Files, objects and standard streams as the commands name them: `-` is a standard stream.

use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::CliError;
use super::places::Place;
use densecloud_blobs::{Blobs, Objects};
use densecloud_cloud::{Attribute, Cloud, Origin, Position};
use densecloud_formats::{CloudReader, Format, Header, Limits, Reading, encode};
use densecloud_geometry::check_count;

pub(super) fn is_stream(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// The path with `suffix` after its name.
#[must_use]
pub fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Opens a cloud, `-` from standard input, and reads its header. An object is read as it comes.
pub(super) fn open(path: &Path, reading: &Reading) -> Result<CloudReader<'static>, CliError> {
    if is_stream(path) {
        let opened = CloudReader::open_as(BufReader::new(io::stdin().lock()), Limits::default(), reading);
        return opened.map_err(|why| CliError::file(path, why));
    }
    let opened = match Place::of(path)? {
        Place::Path(file) => CloudReader::open_path(&file, reading),
        Place::Object(objects, name) => {
            let object = objects.open(&name).map_err(|why| CliError::file(path, why))?;
            CloudReader::open_named(object, name.as_ref(), reading)
        }
    };
    opened.map_err(|why| CliError::file(path, why))
}

/// Reads a cloud, `-` from standard input; refuses one of more points than indices can tell apart.
pub(super) fn read_cloud(path: &Path, reading: &Reading) -> Result<(Cloud, Header), CliError> {
    let reader = open(path, reading)?;
    let header = reader.header().clone();
    let cloud = reader.read().map_err(|why| CliError::file(path, why))?;
    check_count(cloud.positions.len()).map_err(|why| CliError::file(path, why))?;
    Ok((cloud, header))
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

/// The format that an output's name asks for, if it asks for any.
pub(super) fn wanted(path: &Path) -> Result<Option<Format>, CliError> {
    Format::of_output(path).map_err(|why| CliError::Usage(format!("{}: {why}", path.display())))
}

/// As [`wanted`], of what is made of a file.
pub(super) fn wanted_from(
    input: &Path,
    output: &Path,
    reading: &Reading,
) -> Result<Option<Format>, CliError> {
    let wanted = Format::of_output_from(output, input, reading);
    wanted.map_err(|why| CliError::Usage(format!("{}: {why}", output.display())))
}

/// Prints to standard output. A reader that has seen enough may close the pipe.
pub(super) fn print(text: &str) -> Result<(), CliError> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(why) if why.kind() != ErrorKind::BrokenPipe => Err(CliError::file("-", why)),
        _ => Ok(()),
    }
}

/// What the name of an output stands for.
enum Output {
    Stdout,
    /// A file of this name, which need not be there yet.
    File(PathBuf),
    /// A device or a named pipe.
    Device,
    /// An object of this name.
    Object(Objects, String),
}

impl Output {
    /// Follows links: what is written is what they lead to, and they stay.
    fn of(path: &Path) -> Result<Self, CliError> {
        // By its name, /dev/stdout is what it leads to; replaced as a file, that would lose what others wrote there.
        if is_stream(path) || path == Path::new("/dev/stdout") {
            return Ok(Self::Stdout);
        }
        match Place::of(path)? {
            Place::Object(objects, name) => Ok(Self::Object(objects, name)),
            Place::Path(file) => Self::of_path(&file).map_err(|why| CliError::file(path, why)),
        }
    }

    fn of_path(path: &Path) -> io::Result<Self> {
        match fs::metadata(path) {
            Ok(there) if there.is_dir() => return Err(ErrorKind::IsADirectory.into()),
            Ok(there) if !there.is_file() => return Ok(Self::Device),
            Err(why) if why.kind() != ErrorKind::NotFound => return Err(why),
            _ => {}
        }
        // Not `canonicalize`, which knows no link to what is not there yet.
        let mut file = path.to_owned();
        while let Ok(link) = fs::read_link(&file) {
            file = file.parent().unwrap_or(Path::new("")).join(link);
        }
        Ok(Self::File(file))
    }
}

/// Whether an output is a file or an object, which another one may lie beside.
pub(super) fn is_kept(path: &Path) -> bool {
    matches!(Output::of(path), Ok(Output::File(_) | Output::Object(..)))
}

/// Whether an output is standard output.
pub(super) fn is_stdout(path: &Path) -> bool {
    matches!(Output::of(path), Ok(Output::Stdout))
}

/// Whether there is a file or an object of this name; where nobody can tell, there is.
pub(super) fn is_there(path: &Path) -> bool {
    match Output::of(path) {
        Ok(Output::Object(objects, name)) => {
            !matches!(objects.open(&name), Err(why) if why.kind() == ErrorKind::NotFound)
        }
        Ok(Output::File(file)) => file.symlink_metadata().is_ok(),
        _ => false,
    }
}

/// Makes the folder that an output lies in.
pub(super) fn make_folder_of(path: &Path) -> Result<(), CliError> {
    match Output::of(path)? {
        Output::File(file) => match file.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            Some(folder) => fs::create_dir_all(folder).map_err(|why| CliError::file(folder, why)),
            None => Ok(()),
        },
        _ => Ok(()),
    }
}

/// Writes an output with `encode`, `-` to standard output. A file is as [`write_file`] makes it, and an object is there when all of
/// it is.
pub(super) fn write(
    path: &Path,
    encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), Box<dyn std::error::Error>>,
) -> Result<(), CliError> {
    let failed = |why: Box<dyn std::error::Error>| CliError::file(path, why);
    match Output::of(path)? {
        Output::Stdout => through(&mut io::stdout(), encode).map_err(failed),
        Output::Object(objects, name) => {
            let unmade = |why: io::Error| CliError::file(path, why);
            let mut object = objects.create(&name).map_err(unmade)?;
            through(&mut object, encode).map_err(failed)?;
            object.finish().map_err(unmade)
        }
        Output::Device => to_device(path, encode).map_err(failed),
        Output::File(target) => to_file(&target, encode).map_err(failed),
    }
}

/// Writes a file with `encode`. It is made beside its name and renamed, so that no failure leaves half a file under that name; a device
/// or a named pipe is written to as it is. Links are followed.
///
/// # Errors
/// That of `encode`, or the system's.
pub fn write_file<E: From<io::Error>>(
    path: &Path,
    encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), E>,
) -> Result<(), E> {
    match Output::of_path(path)? {
        Output::File(target) => to_file(&target, encode),
        _ => to_device(path, encode),
    }
}

fn to_device<E: From<io::Error>>(
    path: &Path,
    encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), E>,
) -> Result<(), E> {
    through(&mut File::options().write(true).open(path)?, encode)
}

fn to_file<E: From<io::Error>>(
    target: &Path,
    encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), E>,
) -> Result<(), E> {
    let part = beside(target, ".part");
    let mut file = File::create(&part)?;
    let written = through(&mut file, encode).and_then(|()| Ok(fs::rename(&part, target)?));
    // The first error is the one to report.
    written.inspect_err(|_| drop(fs::remove_file(&part)))
}

fn through<E: From<io::Error>>(
    sink: &mut (dyn Write + Send),
    encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), E>,
) -> Result<(), E> {
    let mut sink = BufWriter::with_capacity(1 << 20, sink);
    encode(&mut sink)?;
    Ok(sink.flush()?)
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
        assert_eq!(read_cloud(&path, &Reading::default()).expect("a cloud").0.positions, [[1.0, 2.0, 3.0]]);
        assert_eq!(std::fs::read_dir(dir.path()).expect("a folder").count(), 1, "a part was left");
    }

    #[test]
    #[cfg(unix)]
    fn a_link_stays_and_what_it_leads_to_is_written() {
        let dir = tempfile::tempdir().expect("a folder");
        std::fs::create_dir(dir.path().join("kept")).expect("a folder");
        let (link, further) = (dir.path().join("link"), dir.path().join("kept/further"));
        std::os::unix::fs::symlink("kept/further", &link).expect("a link");
        std::os::unix::fs::symlink("cloud", &further).expect("a link");
        // At first nothing is there.
        for text in ["one", "another"] {
            assert!(is_kept(&link));
            write(&link, |sink| Ok(sink.write_all(text.as_bytes())?)).expect("a file");
            assert_eq!(std::fs::read_to_string(dir.path().join("kept/cloud")).expect("a file"), text);
        }
        assert!(link.is_symlink() && further.is_symlink());
        assert_eq!(
            std::fs::read_dir(dir.path().join("kept")).expect("a folder").count(),
            2,
            "a part was left"
        );
    }

    #[test]
    #[cfg(unix)]
    fn a_named_pipe_is_written_to_and_stays() {
        use std::os::unix::fs::FileTypeExt;
        let dir = tempfile::tempdir().expect("a folder");
        let pipe = dir.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
        assert!(!is_kept(&pipe) && !is_kept(Path::new("-")));
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || std::fs::read_to_string(pipe)
        });
        write(&pipe, |sink| Ok(sink.write_all(b"points")?)).expect("a pipe");
        // Before it is waited for: where the pipe has become a file, its reader waits for ever.
        assert!(std::fs::metadata(&pipe).expect("a pipe").file_type().is_fifo());
        assert_eq!(reader.join().expect("no panic").expect("text"), "points");
        assert_eq!(std::fs::read_dir(dir.path()).expect("a folder").count(), 1);
    }

    #[test]
    fn a_folder_is_no_output() {
        let dir = tempfile::tempdir().expect("a folder");
        let never = |_: &mut (dyn Write + Send)| panic!("a folder was written to");
        assert!(matches!(write(dir.path(), never), Err(CliError::File { .. })));
    }
}
