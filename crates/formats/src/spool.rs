//! Bytes to seek in, where a stream allows none: in memory while they are few, else in a temporary file.

use std::fs::File;
use std::io::{self, Cursor, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::OnceLock;

/// Most bytes that a spool holds in memory.
pub(crate) const IN_MEMORY: usize = 64 << 20;

/// Bytes of a file that are held at a time.
const WINDOW: u64 = 64 << 10;

/// Where temporary files lie, if not in the system's folder for them.
static FOLDER: OnceLock<Box<Path>> = OnceLock::new();

/// Says where temporary files lie from now on, for the whole program: copies of LAS, LAZ and E57 that come from no file, and what
/// LAZ, COPC and E57 are made in. They have no names, so that none is left behind. Without a word, and once one was said, the
/// folder stays: the system's, or that one.
///
/// # Errors
/// The folder cannot be made.
pub fn set_temp_folder(folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    FOLDER.get_or_init(|| folder.into());
    Ok(())
}

/// A temporary file without a name.
fn unnamed() -> io::Result<File> {
    FOLDER.get().map_or_else(tempfile::tempfile, tempfile::tempfile_in)
}

/// Bytes to read, write and seek in, for libraries that need to. Up to [`IN_MEMORY`] bytes are held in memory. More go
/// to a temporary file without a name, and only a window of [`WINDOW`] bytes of it is held. Where no such file can be
/// written, the bytes stay in memory.
#[derive(Debug)]
pub(crate) struct Spool {
    store: Store,
    most: usize,
}

#[derive(Debug)]
enum Store {
    Memory(Cursor<Vec<u8>>),
    File(Window),
}

impl Spool {
    /// An empty one.
    pub(crate) fn new() -> Self {
        Self::with(IN_MEMORY)
    }

    /// An empty one that holds no more than `most` bytes in memory.
    pub(crate) fn with(most: usize) -> Self {
        Self { store: Store::Memory(Cursor::default()), most }
    }

    /// The first `length` bytes of a file.
    pub(crate) fn of_file(file: File, length: u64) -> Self {
        Self { store: Store::File(Window::new(file, length)), most: IN_MEMORY }
    }

    /// The most memory that `bytes` take in a spool, twice where it grows; more only where no temporary file can be written.
    pub(crate) fn most_held(bytes: u64) -> u64 {
        2 * bytes.min(IN_MEMORY as u64)
    }

    /// How many bytes there are.
    pub(crate) fn len(&self) -> u64 {
        match &self.store {
            Store::Memory(bytes) => bytes.get_ref().len() as u64,
            Store::File(window) => window.length,
        }
    }

    /// How many of them are held in memory.
    #[cfg(test)]
    pub(crate) fn held(&self) -> usize {
        match &self.store {
            Store::Memory(bytes) => bytes.get_ref().capacity(),
            Store::File(window) => window.bytes.capacity(),
        }
    }

    /// Fills `bytes` from place `at` on; false where fewer bytes are there.
    pub(crate) fn read_at(&mut self, at: u64, bytes: &mut [u8]) -> io::Result<bool> {
        if at.checked_add(bytes.len() as u64).is_none_or(|end| end > self.len()) {
            return Ok(false);
        }
        self.seek(SeekFrom::Start(at))?;
        self.read_exact(bytes).map(|()| true)
    }

    /// The little-endian number of `N` bytes at `at`; none where the bytes end before.
    pub(crate) fn number<const N: usize>(&mut self, at: u64) -> io::Result<Option<u64>> {
        let mut word = [0; 8];
        let is_there = self.read_at(at, &mut word[..N])?;
        Ok(is_there.then_some(u64::from_le_bytes(word)))
    }

    /// Moves the bytes from memory to a temporary file, if one can be written.
    fn roll(&mut self) {
        let Store::Memory(bytes) = &mut self.store else { return };
        let written = unnamed().and_then(|mut file| {
            file.write_all(bytes.get_ref())?;
            Ok(file)
        });
        match written {
            Ok(file) => {
                let mut window = Window::new(file, bytes.get_ref().len() as u64);
                window.place = bytes.position();
                self.store = Store::File(window);
            }
            Err(_) => self.most = usize::MAX,
        }
    }

    /// Moves the bytes from the file back to memory, because the disk is full, say.
    fn unroll(&mut self) -> io::Result<()> {
        if let Store::File(window) = &mut self.store {
            let mut bytes = Cursor::new(window.all()?);
            bytes.set_position(window.place);
            self.store = Store::Memory(bytes);
            self.most = usize::MAX;
        }
        Ok(())
    }
}

impl Read for Spool {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match &mut self.store {
            Store::Memory(held) => held.read(bytes),
            Store::File(window) => window.read(bytes),
        }
    }
}

impl Write for Spool {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Store::Memory(held) = &mut self.store
            && held.position().saturating_add(bytes.len() as u64) > self.most as u64
        {
            self.roll();
        }
        if let Store::File(window) = &mut self.store {
            match window.write(bytes) {
                Ok(count) => return Ok(count),
                Err(_) => self.unroll()?,
            }
        }
        match &mut self.store {
            Store::Memory(held) => held.write(bytes),
            Store::File(window) => window.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Spool {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match &mut self.store {
            Store::Memory(held) => held.seek(to),
            Store::File(window) => window.seek(to),
        }
    }
}

/// A file and one stretch of it in memory. A `BufReader` would drop its buffer at every seek, and a `BufWriter` cannot
/// be read from.
#[derive(Debug)]
struct Window {
    file: File,
    /// Bytes of the file, the unwritten ones included.
    length: u64,
    place: u64,
    /// Where the stretch begins: a multiple of [`WINDOW`].
    start: u64,
    bytes: Vec<u8>,
    is_changed: bool,
}

impl Window {
    fn new(file: File, length: u64) -> Self {
        Self { file, length, place: 0, start: 0, bytes: Vec::new(), is_changed: false }
    }

    /// Loads the stretch around the current place, and returns the place within it.
    fn hold(&mut self) -> io::Result<usize> {
        let start = self.place - self.place % WINDOW;
        if start != self.start || self.bytes.is_empty() {
            self.write_back()?;
            self.bytes.clear();
            let there = self.length.saturating_sub(start).min(WINDOW);
            self.file.seek(SeekFrom::Start(start))?;
            (&mut self.file).take(there).read_to_end(&mut self.bytes)?;
            self.start = start;
        }
        // Less than WINDOW.
        Ok((self.place - start) as usize)
    }

    fn write_back(&mut self) -> io::Result<()> {
        if self.is_changed {
            self.file.seek(SeekFrom::Start(self.start))?;
            self.file.write_all(&self.bytes)?;
            self.is_changed = false;
        }
        Ok(())
    }

    /// Reads much at once, without a copy in the stretch, of which nothing is unwritten.
    fn read_past(&mut self, out: &mut [u8]) -> io::Result<usize> {
        self.file.seek(SeekFrom::Start(self.place))?;
        let count = (&mut self.file).take(self.length - self.place).read(out)?;
        self.place += count as u64;
        Ok(count)
    }

    /// All bytes of the file, the unwritten ones included.
    fn all(&mut self) -> io::Result<Vec<u8>> {
        let mut all = Vec::new();
        self.file.seek(SeekFrom::Start(0))?;
        let unwritten = if self.is_changed { self.start } else { self.length };
        (&mut self.file).take(unwritten).read_to_end(&mut all)?;
        if self.is_changed {
            all.extend_from_slice(&self.bytes);
            let end = all.len() as u64;
            self.file.seek(SeekFrom::Start(end))?;
            (&mut self.file).take(self.length.saturating_sub(end)).read_to_end(&mut all)?;
        }
        Ok(all)
    }
}

impl Read for Window {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.place >= self.length || out.is_empty() {
            return Ok(0);
        }
        if out.len() >= WINDOW as usize && !self.is_changed {
            return self.read_past(out);
        }
        let from = self.hold()?;
        let there = self.bytes.get(from..).unwrap_or_default();
        let count = there.len().min(out.len());
        out[..count].copy_from_slice(&there[..count]);
        self.place += count as u64;
        Ok(count)
    }
}

impl Write for Window {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let from = self.hold()?;
        // Less than WINDOW.
        let count = bytes.len().min(WINDOW as usize - from);
        let to = from + count;
        if self.bytes.len() < to {
            self.bytes.resize(to, 0);
        }
        self.bytes[from..to].copy_from_slice(&bytes[..count]);
        self.is_changed |= count > 0;
        self.place += count as u64;
        self.length = self.length.max(self.place);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.write_back()
    }
}

impl Seek for Window {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
            SeekFrom::Current(by) => self.place.checked_add_signed(by),
        };
        self.place = place.ok_or(ErrorKind::InvalidInput)?;
        Ok(self.place)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[derive(Debug, Clone)]
    enum Step {
        Seek(u64),
        Write(Vec<u8>),
        Read(usize),
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let step = prop_oneof![
            (0..300_000_u64).prop_map(Step::Seek),
            (0..200_000_usize, any::<u8>()).prop_map(|(count, byte)| Step::Write(vec![byte; count])),
            (0..200_000_usize).prop_map(Step::Read),
        ];
        prop::collection::vec(step, 1..12)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_spool_is_what_a_cursor_is(steps in steps(), most in 0..400_000_usize) {
            let (mut spool, mut cursor) = (Spool::with(most), Cursor::new(Vec::new()));
            for step in steps {
                match step {
                    Step::Seek(to) => {
                        // Beyond the end, a cursor and a file differ only in what they hold.
                        let to = SeekFrom::Start(to.min(cursor.get_ref().len() as u64));
                        prop_assert_eq!(spool.seek(to).unwrap(), cursor.seek(to).unwrap());
                    }
                    Step::Write(bytes) => {
                        spool.write_all(&bytes).unwrap();
                        cursor.write_all(&bytes).unwrap();
                    }
                    Step::Read(count) => {
                        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
                        (&mut spool).take(count as u64).read_to_end(&mut ours).unwrap();
                        (&mut cursor).take(count as u64).read_to_end(&mut theirs).unwrap();
                        prop_assert!(ours == theirs);
                    }
                }
                prop_assert_eq!(spool.len(), cursor.get_ref().len() as u64);
            }
            spool.rewind().unwrap();
            let mut all = Vec::new();
            spool.read_to_end(&mut all).unwrap();
            prop_assert!(all == *cursor.get_ref());
        }
    }

    #[test]
    fn what_is_beyond_the_bound_is_not_held() {
        let mut spool = Spool::with(1 << 20);
        for i in 0..100_u8 {
            spool.write_all(&[i; 100_000]).unwrap();
            assert!(spool.held() <= 2 << 20, "{} bytes", spool.held());
        }
        assert_eq!((spool.len(), spool.number::<2>(4_200_000).unwrap()), (10_000_000, Some(42 * 257)));
        assert_eq!(spool.number::<8>(9_999_993).unwrap(), None);
        assert!(spool.held() <= 1 << 17);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn temporary_files_lie_in_the_folder_that_was_said_and_have_no_name() {
        // For all tests of this program, so it stays.
        let folder = tempfile::tempdir().expect("a folder").keep().join("deep");
        set_temp_folder(&folder).expect("a folder");
        let mut spool = Spool::with(10);
        spool.write_all(&[1; 100]).expect("a file");
        let files = std::fs::read_dir("/proc/self/fd").expect("files");
        let links = files.flatten().filter_map(|file| std::fs::read_link(file.path()).ok());
        assert!(links.into_iter().any(|link| link.starts_with(&folder)));
        assert_eq!(std::fs::read_dir(&folder).expect("a folder").count(), 0);
        // The first word counts.
        set_temp_folder(&folder.join("other")).expect("a folder");
        assert_eq!(FOLDER.get().map(AsRef::as_ref), Some(folder.as_path()));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_leaves_the_bytes_in_memory() {
        let full = File::options().read(true).write(true).open("/dev/full").expect("a device");
        let mut spool = Spool { store: Store::File(Window::new(full, 0)), most: 0 };
        spool.write_all(&[7; 200_000]).unwrap();
        let mut all = Vec::new();
        spool.rewind().unwrap();
        spool.read_to_end(&mut all).unwrap();
        assert!(all == [7; 200_000]);
    }
}
