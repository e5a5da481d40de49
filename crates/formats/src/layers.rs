//! What may lie about a file's bytes: gzip, and UTF-16 in place of UTF-8. Both are taken off as they are read.

use std::fs::File;
use std::io::{self, ErrorKind, Read};

use flate2::read::MultiGzDecoder;
use sha2::{Digest, Sha256};

use super::first_bytes::ENOUGH;
use super::source::Input;
use super::{FormatError, Limits};

/// Bytes of UTF-16 that are read at a time.
const BLOCK: usize = 64 * 1024;

/// The bytes of a file, free of gzip and UTF-16.
pub(super) struct Layers<'r> {
    packed: Ahead<Packed<'r>>,
    utf16: Option<Utf16>,
}

/// The bytes of a file as they come, and what is inside of gzip.
enum Packed<'r> {
    Plain(Ahead<Raw<'r>>),
    Gzip(Box<Expanded<'r>>),
}

/// The bytes as they come: counted, limited and hashed.
struct Raw<'r> {
    input: Input<'r>,
    pulled: u64,
    limits: Limits,
    hash: Sha256,
}

/// What is inside of gzip, limited like the file itself.
struct Expanded<'r> {
    decoder: MultiGzDecoder<Ahead<Raw<'r>>>,
    expanded: u64,
    limits: Limits,
}

/// Lets the first bytes be looked at before they are read.
struct Ahead<R> {
    inner: R,
    bytes: Vec<u8>,
}

/// Turns UTF-16 into UTF-8.
struct Utf16 {
    is_big: bool,
    /// Bytes that are not yet a whole character.
    rest: Vec<u8>,
    /// Characters that are not yet given.
    text: Vec<u8>,
    given: usize,
}

impl<'r> Layers<'r> {
    /// Looks at the first bytes. `transcode` is whether UTF-16 may be about it; nothing lies about what `is_known`,
    /// since the first bytes of that may be a number.
    pub(super) fn new(
        input: Input<'r>,
        limits: Limits,
        transcode: bool,
        is_known: fn(&[u8]) -> bool,
    ) -> Result<Self, FormatError> {
        let raw = Raw { input, pulled: 0, limits, hash: Sha256::new() };
        let mut raw = Ahead { inner: raw, bytes: Vec::new() };
        // Magic, deflate, and no flag that is reserved.
        let head = raw.peek().map_err(unwrapped)?;
        let is_gzip = matches!(head, [0x1F, 0x8B, 8, 0..0x20, ..]) && !is_known(head);
        let packed = if is_gzip {
            let decoder = MultiGzDecoder::new(raw);
            Packed::Gzip(Box::new(Expanded { decoder, expanded: 0, limits }))
        } else {
            Packed::Plain(raw)
        };
        let mut packed = Ahead { inner: packed, bytes: Vec::new() };
        let utf16 = |is_big| Utf16 { is_big, rest: Vec::new(), text: Vec::new(), given: 0 };
        let utf16 = match packed.peek().map_err(unwrapped)? {
            head if !transcode || is_known(head) => None,
            [0xFF, 0xFE, 0, 0, ..] | [0, 0, 0xFE, 0xFF, ..] => {
                let found = "text in UTF-32; save it as UTF-8".to_owned();
                return Err(FormatError::Unrecognised { found });
            }
            [0xFF, 0xFE, ..] => Some(utf16(false)),
            [0xFE, 0xFF, ..] => Some(utf16(true)),
            _ => None,
        };
        Ok(Self { packed, utf16 })
    }

    /// Reads once; 0 at the end.
    pub(super) fn read(&mut self, bytes: &mut [u8]) -> Result<usize, FormatError> {
        let read = match &mut self.utf16 {
            None => self.packed.read(bytes),
            Some(utf16) => utf16.read(&mut self.packed, bytes),
        };
        read.map_err(unwrapped)
    }

    /// The file itself and its bytes so far, where nothing lies about them.
    pub(super) fn file(&self) -> Option<&File> {
        match (&self.utf16, &self.packed.inner) {
            (None, Packed::Plain(Ahead { inner: Raw { input: Input::File(file), .. }, .. })) => Some(file),
            _ => None,
        }
    }

    /// Bytes of the file that were read so far.
    pub(super) fn pulled(&self) -> u64 {
        self.packed.inner.raw().pulled
    }

    /// SHA-256 over the bytes of the file, as they came.
    pub(super) fn sha256(self) -> [u8; 32] {
        match self.packed.inner {
            Packed::Plain(raw) => raw.inner,
            Packed::Gzip(expanded) => expanded.decoder.into_inner().inner,
        }
        .hash
        .finalize()
        .into()
    }
}

impl<'r> Packed<'r> {
    fn raw(&self) -> &Raw<'r> {
        match self {
            Self::Plain(raw) => &raw.inner,
            Self::Gzip(expanded) => &expanded.decoder.get_ref().inner,
        }
    }
}

/// A limit that was passed, or damage, out of the error that carries it.
fn unwrapped(error: io::Error) -> FormatError {
    match error.downcast::<FormatError>() {
        Ok(error) => error,
        Err(error) => error.into(),
    }
}

fn check_bytes(bytes: u64, limits: Limits) -> io::Result<()> {
    limits.check_bytes(bytes).map_err(io::Error::other)
}

impl Read for Raw<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let mut room = bytes.len();
        if let Some(max) = self.limits.max_bytes {
            // One byte more than allowed tells a file at the limit from one beyond it.
            let left = max.saturating_sub(self.pulled).saturating_add(1);
            room = room.min(usize::try_from(left).unwrap_or(usize::MAX));
        }
        let got = loop {
            match self.input.read(&mut bytes[..room]) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                other => break other?,
            }
        };
        self.hash.update(&bytes[..got]);
        self.pulled += got as u64;
        check_bytes(self.pulled, self.limits)?;
        Ok(got)
    }
}

impl Read for Packed<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Plain(raw) => raw.read(bytes),
            Self::Gzip(expanded) => expanded.read(bytes),
        }
    }
}

impl Read for Expanded<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.decoder.read(bytes);
        let got = read.map_err(|error| {
            let at = super::Place::Byte(self.expanded);
            match error.kind() {
                ErrorKind::UnexpectedEof => io::Error::other(FormatError::truncated(
                    at,
                    "the gzip file goes on after its last byte here",
                )),
                ErrorKind::InvalidInput | ErrorKind::InvalidData => {
                    io::Error::other(FormatError::malformed(at, format!("the gzip file is damaged: {error}")))
                }
                _ => error,
            }
        })?;
        self.expanded += got as u64;
        check_bytes(self.expanded, self.limits)?;
        Ok(got)
    }
}

impl<R: Read> Ahead<R> {
    /// The first bytes, enough to recognise any format, fewer where there are no more. To be asked before anything is
    /// read.
    fn peek(&mut self) -> io::Result<&[u8]> {
        let mut bytes = [0; ENOUGH];
        while self.bytes.len() < ENOUGH {
            let got = self.inner.read(&mut bytes[..ENOUGH - self.bytes.len()])?;
            if got == 0 {
                break;
            }
            self.bytes.extend_from_slice(&bytes[..got]);
        }
        Ok(&self.bytes)
    }
}

impl<R: Read> Read for Ahead<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if self.bytes.is_empty() {
            return self.inner.read(bytes);
        }
        let count = self.bytes.len().min(bytes.len());
        bytes[..count].copy_from_slice(&self.bytes[..count]);
        self.bytes.drain(..count);
        Ok(count)
    }
}

impl Utf16 {
    /// Reads once, into at least one byte; 0 at the end.
    fn read(&mut self, from: &mut impl Read, bytes: &mut [u8]) -> io::Result<usize> {
        while self.given == self.text.len() {
            let before = self.rest.len();
            self.rest.resize(BLOCK, 0);
            let got = from.read(&mut self.rest[before..])?;
            self.rest.truncate(before + got);
            self.decode(got == 0);
            if got == 0 && self.text.is_empty() {
                return Ok(0);
            }
        }
        let count = bytes.len().min(self.text.len() - self.given);
        bytes[..count].copy_from_slice(&self.text[self.given..self.given + count]);
        self.given += count;
        Ok(count)
    }

    /// Makes text of all whole characters; at the end of all, what is half there is a replacement character.
    fn decode(&mut self, is_end: bool) {
        let (pairs, half) = self.rest.as_chunks::<2>();
        let mut units: Vec<u16> = pairs
            .iter()
            .map(|pair| if self.is_big { u16::from_be_bytes(*pair) } else { u16::from_le_bytes(*pair) })
            .collect();
        let mut rest = half.to_vec();
        match units.last() {
            // The first half of a pair, whose second is to come.
            Some(0xD800..=0xDBFF) if !is_end => {
                units.pop();
                rest.splice(0..0, pairs[pairs.len() - 1]);
            }
            _ if is_end && !rest.is_empty() => {
                units.push(0xFFFD);
                rest.clear();
            }
            _ => {}
        }
        let text: String =
            char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
        (self.rest, self.text, self.given) = (rest, text.into_bytes(), 0);
    }
}
