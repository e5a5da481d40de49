//! The keys that clients may show, from a file.
//!
//! A line of the file is a client's name, then its key: the key itself, or `sha256:` and the 64
//! hexadecimal digits of its SHA-256. `#` begins a comment. A name may come several times, so that a key
//! can be replaced while the old one still works. Keys themselves are hashed at once and kept nowhere. The file can be read
//! again while the server runs.

use std::collections::HashSet;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// All keys that a server knows; shared by all to whom an `Arc` of it was given, when it is [read again](Keys::reload), too.
pub struct Keys {
    path: PathBuf,
    // Few read it at a time, and none for longer than a lookup takes; a channel would say nothing more.
    entries: RwLock<Arc<[Entry]>>,
    reloads: [AtomicU64; 2],
}

#[derive(Clone, PartialEq, Eq)]
struct Entry {
    name: String,
    hash: [u8; 32],
}

impl std::fmt::Debug for Keys {
    /// Names alone.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_set().entries(self.entries().iter().map(|entry| &entry.name)).finish()
    }
}

impl PartialEq for Keys {
    /// Whether both know the same keys at the moment.
    fn eq(&self, other: &Self) -> bool {
        self.entries() == other.entries()
    }
}

impl Eq for Keys {}

/// Why a file of keys is not taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeysError {
    /// It cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// A line is not a name and a key.
    #[error("line {line}: {why}")]
    Line {
        /// From 1.
        line: usize,
        /// What is wrong with it.
        why: &'static str,
    },
    /// Its end, with keys that would not count, would not be read.
    #[error("it is longer than {LONGEST_FILE} bytes")]
    Long,
    /// There is no key in it, so that nobody would be let in.
    #[error("there is no key in it; a line is a name, a space and a key")]
    Empty,
    /// Everybody on the machine can read keys that are not hashed.
    #[error("everybody can read it; `chmod o-r` it, or put `sha256:` and each key's SHA-256 into it")]
    Readable,
}

/// Fewer characters might be guessed.
const SHORTEST: usize = 16;
const LONGEST_NAME: usize = 64;
/// Of the file: some hundred thousand keys.
const LONGEST_FILE: u64 = 16 << 20;

impl Keys {
    /// Reads a file.
    ///
    /// # Errors
    /// See [`KeysError`].
    pub fn read(path: &Path) -> Result<Self, KeysError> {
        let entries = RwLock::new(entries(path)?.into());
        Ok(Self { path: path.to_owned(), entries, reloads: Default::default() })
    }

    /// One key, of a client of this name, that is in no file.
    ///
    /// # Errors
    /// [`KeysError::Line`] where it is none.
    pub fn of_one(name: &str, key: &str) -> Result<Self, KeysError> {
        let (entries, _) = parse(&format!("{name} {key}"))?;
        Ok(Self { path: PathBuf::new(), entries: RwLock::new(entries.into()), reloads: Default::default() })
    }

    /// Reads the file again: from then on its keys count, and no others. Says how many there are. What was begun under
    /// a key that is gone goes on. Blocks for the file.
    ///
    /// # Errors
    /// See [`KeysError`]; all keys are as before then.
    pub fn reload(&self) -> Result<usize, KeysError> {
        let read = entries(&self.path);
        self.reloads[usize::from(read.is_err())].fetch_add(1, Ordering::Relaxed);
        let read = read?;
        let count = read.len();
        *self.entries.write().unwrap_or_else(PoisonError::into_inner) = read.into();
        Ok(count)
    }

    /// How often the file was read again, and how often it could not be.
    pub(crate) fn reloads(&self) -> [u64; 2] {
        self.reloads.each_ref().map(|count| count.load(Ordering::Relaxed))
    }

    fn entries(&self) -> Arc<[Entry]> {
        Arc::clone(&self.entries.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// The name of a key, where it is known. Takes the same time whatever key is shown: hashes are compared, so
    /// that its length does not tell, and all of them to their ends.
    pub(crate) fn name(&self, key: &[u8]) -> Option<String> {
        let hash: [u8; 32] = Sha256::digest(key).into();
        let entries = self.entries();
        let mut found = None;
        for entry in &*entries {
            if bool::from(entry.hash.ct_eq(&hash)) {
                found = Some(&entry.name);
            }
        }
        found.cloned()
    }
}

/// Reads a file of keys.
fn entries(path: &Path) -> Result<Vec<Entry>, KeysError> {
    let (entries, plain) = parse(&text(path)?)?;
    if plain && readable_by_all(path)? {
        return Err(KeysError::Readable);
    }
    Ok(entries)
}

fn text(path: &Path) -> Result<String, KeysError> {
    let mut text = String::new();
    File::open(path)?.take(LONGEST_FILE + 1).read_to_string(&mut text)?;
    if text.len() as u64 > LONGEST_FILE {
        return Err(KeysError::Long);
    }
    Ok(text)
}

/// Reads a file's text; also says whether there is a key in it that is not hashed.
fn parse(text: &str) -> Result<(Vec<Entry>, bool), KeysError> {
    let mut entries: Vec<Entry> = Vec::new();
    let mut hashes = HashSet::new();
    let mut plain = false;
    for (i, line) in text.lines().enumerate() {
        let wrong = |why| KeysError::Line { line: i + 1, why };
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let mut words = line.split_whitespace();
        let (Some(name), Some(key), None) = (words.next(), words.next(), words.next()) else {
            return Err(wrong("not a name, a space and a key"));
        };
        let known = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b'-');
        if name.len() > LONGEST_NAME || !name.bytes().all(known) {
            return Err(wrong("a name may have up to 64 letters, digits, dots, dashes and underscores"));
        }
        let hash = match key.strip_prefix("sha256:") {
            Some(digits) => {
                digest(digits).ok_or(wrong("sha256: must be followed by 64 hexadecimal digits"))?
            }
            None if key.len() < SHORTEST => return Err(wrong("a key must have 16 characters at least")),
            None if !key.bytes().all(|b| b.is_ascii_graphic()) => {
                return Err(wrong("a key may have visible ASCII characters alone"));
            }
            None => {
                plain = true;
                Sha256::digest(key).into()
            }
        };
        if !hashes.insert(hash) {
            return Err(wrong("the same key is in an earlier line"));
        }
        entries.push(Entry { name: name.to_owned(), hash });
    }
    if entries.is_empty() {
        return Err(KeysError::Empty);
    }
    Ok((entries, plain))
}

fn digest(digits: &str) -> Option<[u8; 32]> {
    let mut bytes = [0; 32];
    hex::decode_to_slice(digits, &mut bytes).ok()?;
    Some(bytes)
}

#[cfg(unix)]
fn readable_by_all(path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::PermissionsExt;
    Ok(std::fs::metadata(path)?.permissions().mode() & 0o004 != 0)
}

/// Elsewhere files have lists of who may read them, which are not looked into.
#[cfg(not(unix))]
fn readable_by_all(_path: &Path) -> io::Result<bool> {
    Ok(false)
}

/// The form of a key that a file may have in its place.
#[cfg(test)]
pub(crate) fn hashed(key: &str) -> String {
    format!("sha256:{}", hex::encode(Sha256::digest(key)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "0123456789abcdef";

    /// A file of keys that nobody else can read, in a folder of its own.
    fn write(path: &Path, text: &str) {
        std::fs::write(path, text).expect("a file");
        #[cfg(unix)]
        {
            let owners = std::os::unix::fs::PermissionsExt::from_mode(0o600);
            std::fs::set_permissions(path, owners).expect("permissions");
        }
    }

    #[test]
    fn keys_are_known_plain_or_hashed_and_by_several_for_one_name() {
        let text = format!(
            "# ours\n\n alice  {KEY}\nbob {}\nalice another-key-of-hers\n",
            hashed("bobs secret key!")
        );
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("keys");
        write(&path, &text);
        let keys = Keys::read(&path).expect("keys");
        for (key, name) in [
            (KEY, Some("alice")),
            ("another-key-of-hers", Some("alice")),
            ("bobs secret key!", Some("bob")),
            ("0123456789abcdeg", None),
            ("0123456789abcdef0", None),
            ("", None),
        ] {
            assert_eq!(keys.name(key.as_bytes()).as_deref(), name, "{key}");
        }
        let shown = format!("{keys:?}");
        assert!(shown.contains("alice") && !shown.contains(KEY), "{shown}");
        assert!(parse(&text).expect("keys").1);
        assert!(!parse(&format!("bob {}", hashed(KEY))).expect("keys").1);
    }

    #[test]
    fn a_file_that_is_read_again_counts_at_once_and_one_that_is_broken_changes_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("keys");
        write(&path, &format!("alice {KEY}\n"));
        let keys = Arc::new(Keys::read(&path).expect("keys"));
        let names = |keys: &Keys| [KEY, "another-key-of-hers"].map(|key| keys.name(key.as_bytes()));
        let alice = || Some("alice".to_owned());
        write(&path, &format!("alice {KEY}\nalice another-key-of-hers\n"));
        assert_eq!(names(&keys), [alice(), None], "not yet");
        assert_eq!(keys.reload().expect("keys"), 2);
        assert_eq!(names(&keys), [alice(), alice()]);
        write(&path, "alice another-key-of-hers\n");
        assert_eq!(keys.reload().expect("keys"), 1);
        assert_eq!(names(&keys), [None, alice()]);
        for broken in ["", "alice short\n", "# no key\n", "alice \u{1b}\n"] {
            write(&path, broken);
            assert!(keys.reload().is_err(), "{broken:?}");
            assert_eq!(names(&keys), [None, alice()], "{broken:?}");
        }
        std::fs::remove_file(&path).expect("a file");
        assert!(matches!(keys.reload(), Err(KeysError::Io(_))));
        assert_eq!((names(&keys), keys.reloads()), ([None, alice()], [2, 5]));
    }

    #[test]
    fn a_file_that_is_too_long_is_refused_and_not_cut() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("keys");
        // Cut, its last line would still be a key, a shorter one.
        let (start, key) = (format!("alice {KEY}\n#"), format!("\nbob {KEY}{KEY}"));
        let comment = "-".repeat(LONGEST_FILE as usize - start.len() - key.len());
        let whole = format!("{start}{comment}{key}");
        write(&path, &whole);
        let keys = Keys::read(&path).expect("as long as may be");
        assert_eq!(keys.name(format!("{KEY}{KEY}").as_bytes()).as_deref(), Some("bob"));
        write(&path, &format!("{whole}x"));
        assert!(matches!(keys.reload(), Err(KeysError::Long)));
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        for (line, part) in [
            ("alice", "not a name"),
            ("alice secret secret-secret", "not a name"),
            ("alice short", "16 characters"),
            ("al/ice 0123456789abcdef", "letters"),
            ("alice 0123456789abcdéfg", "ASCII"),
            ("alice sha256:12", "64 hexadecimal"),
            ("alice fine-and-long-enough", "earlier line"),
        ] {
            let text = format!("x fine-and-long-enough\n{line}\n");
            let error = parse(&text).err().expect(line).to_string();
            assert!(error.contains("line 2") && error.contains(part), "{line}: {error}");
        }
        assert!(matches!(parse("# nothing\n"), Err(KeysError::Empty)));
    }

    #[test]
    #[cfg(unix)]
    fn keys_in_the_open_must_not_be_readable_by_all() {
        use std::fs::{self, Permissions};
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("keys");
        let write = |text: &str, mode: u32| {
            fs::write(&path, text).expect("a file");
            fs::set_permissions(&path, Permissions::from_mode(mode)).expect("permissions");
            Keys::read(&path)
        };
        assert!(matches!(write(&format!("a {KEY}"), 0o644), Err(KeysError::Readable)));
        assert!(write(&format!("a {KEY}"), 0o640).is_ok());
        assert!(write(&format!("a {}", hashed(KEY)), 0o644).is_ok());
        assert!(matches!(Keys::read(folder.path()), Err(KeysError::Io(_))));
    }
}
