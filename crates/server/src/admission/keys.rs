//! The keys that clients may show, from a file.
//!
//! A line of the file is a client's name, then its key: the key itself, or `sha256:` and the 64
//! hexadecimal digits of its SHA-256. `#` begins a comment. A name may come several times, so that a key
//! can be replaced while the old one still works. Keys themselves are hashed at once and kept nowhere.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// All keys that a server knows.
#[derive(Clone, PartialEq, Eq)]
pub struct Keys(Vec<Entry>);

#[derive(Clone, PartialEq, Eq)]
struct Entry {
    name: String,
    hash: [u8; 32],
}

impl std::fmt::Debug for Keys {
    /// Names alone.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_set().entries(self.0.iter().map(|entry| &entry.name)).finish()
    }
}

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
        let mut text = String::new();
        File::open(path)?.take(LONGEST_FILE).read_to_string(&mut text)?;
        let (keys, plain) = Self::parse(&text)?;
        if plain && readable_by_all(path)? {
            return Err(KeysError::Readable);
        }
        Ok(keys)
    }

    /// Reads a file's text; also says whether there is a key in it that is not hashed.
    fn parse(text: &str) -> Result<(Self, bool), KeysError> {
        let mut entries: Vec<Entry> = Vec::new();
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
            if entries.iter().any(|entry| entry.hash == hash) {
                return Err(wrong("the same key is in an earlier line"));
            }
            entries.push(Entry { name: name.to_owned(), hash });
        }
        if entries.is_empty() {
            return Err(KeysError::Empty);
        }
        Ok((Self(entries), plain))
    }

    /// The name of a key, where it is known. Takes the same time whatever key is shown: hashes are compared, so
    /// that its length does not tell, and all of them to their ends.
    pub(crate) fn name(&self, key: &[u8]) -> Option<&str> {
        let hash: [u8; 32] = Sha256::digest(key).into();
        let mut found = None;
        for entry in &self.0 {
            if bool::from(entry.hash.ct_eq(&hash)) {
                found = Some(entry.name.as_str());
            }
        }
        found
    }
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

    #[test]
    fn keys_are_known_plain_or_hashed_and_by_several_for_one_name() {
        let text = format!(
            "# ours\n\n alice  {KEY}\nbob {}\nalice another-key-of-hers\n",
            hashed("bobs secret key!")
        );
        let (keys, plain) = Keys::parse(&text).expect("keys");
        assert!(plain);
        for (key, name) in [
            (KEY, Some("alice")),
            ("another-key-of-hers", Some("alice")),
            ("bobs secret key!", Some("bob")),
            ("0123456789abcdeg", None),
            ("0123456789abcdef0", None),
            ("", None),
        ] {
            assert_eq!(keys.name(key.as_bytes()), name, "{key}");
        }
        let shown = format!("{keys:?}");
        assert!(shown.contains("alice") && !shown.contains(KEY), "{shown}");
        assert!(!Keys::parse(&format!("bob {}", hashed(KEY))).expect("keys").1);
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
            let error = Keys::parse(&text).expect_err(line).to_string();
            assert!(error.contains("line 2") && error.contains(part), "{line}: {error}");
        }
        assert!(matches!(Keys::parse("# nothing\n"), Err(KeysError::Empty)));
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
