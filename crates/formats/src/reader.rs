//! Reading a cloud in whatever format it comes.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::npy::{self, NpyHeader};
use super::off::{self, OffHeader};
use super::pcd::PcdHeader;
use super::ply::{self, PlyHeader};
use super::source::Source;
use super::text::{next_token, shown, strip_comment};
use super::xyz::XyzReader;
use super::{Format, FormatError, Header, Limits, e57, las, obj};
use densecloud_cloud::Cloud;

/// Reads one cloud: [`open`](Self::open) takes the header, [`read`](Self::read) the points.
///
/// It buffers by itself, so that `R` needs no `BufReader` around it.
pub struct CloudReader<R> {
    source: Source<R>,
    header: Header,
    body: Body,
    limits: Limits,
}

enum Body {
    Ply(PlyHeader),
    Xyz(XyzReader),
    Las,
    Pcd(PcdHeader),
    Npy(NpyHeader),
    E57,
    Off(OffHeader),
    Obj,
}

impl<R: Read> CloudReader<R> {
    /// Recognises the format by its content and reads its header (for text: up to the first point).
    ///
    /// # Errors
    /// The format is none of ours, the header is malformed, or what it claims is over a limit.
    pub fn open(reader: R, limits: Limits) -> Result<Self, FormatError> {
        Self::open_as(reader, limits, None)
    }

    /// As [`open`](Self::open); `expected` is the format that the file's name tells. Content wins, but
    /// text under the name of another format is refused rather than taken for points.
    fn open_as(reader: R, limits: Limits, expected: Option<Format>) -> Result<Self, FormatError> {
        let mut source = Source::new(reader, limits)?;
        match sniff(source.peek(4096)?) {
            Sniffed::Ply => {
                let ply = ply::parse(&mut source)?;
                let header = ply::describe(&source, &ply, limits)?;
                Ok(Self { source, header, body: Body::Ply(ply), limits })
            }
            Sniffed::Pcd => {
                let (pcd, header) = PcdHeader::open(&mut source, limits)?;
                Ok(Self { source, header, body: Body::Pcd(pcd), limits })
            }
            Sniffed::Npy => {
                let (npy, header) = NpyHeader::open(&mut source, limits)?;
                Ok(Self { source, header, body: Body::Npy(npy), limits })
            }
            Sniffed::Off => {
                let (off, header) = OffHeader::open(&mut source, limits)?;
                Ok(Self { source, header, body: Body::Off(off), limits })
            }
            Sniffed::Obj => Ok(Self { source, header: obj::header(), body: Body::Obj, limits }),
            Sniffed::E57 => {
                let header = e57::open(&mut source)?;
                Ok(Self { source, header, body: Body::E57, limits })
            }
            Sniffed::Las => {
                let header = las::open(&mut source, limits)?;
                Ok(Self { source, header, body: Body::Las, limits })
            }
            Sniffed::Text => {
                if let Some(begins) = expected.and_then(beginning) {
                    let found = format!("text that does not begin with {begins}");
                    return Err(FormatError::Unrecognised { found });
                }
                let (xyz, header) = XyzReader::open(&mut source, limits)?;
                Ok(Self { source, header, body: Body::Xyz(xyz), limits })
            }
            Sniffed::Other(found) => Err(FormatError::Unrecognised { found }),
            Sniffed::Nothing => Err(FormatError::Empty("points")),
        }
    }

    /// What is known before the points are read.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Reads the points and everything after them. O(n); memory grows with the data, not with the
    /// header's claim. NaN and infinite coordinates are read as they are.
    ///
    /// # Errors
    /// The data are malformed, end early, go on after what the header counts, pass a limit, or hold no
    /// point.
    pub fn read(mut self) -> Result<Cloud, FormatError> {
        let mut cloud = match self.body {
            Body::Ply(ply) => ply::read_cloud(&mut self.source, &ply)?,
            Body::Xyz(xyz) => xyz.read(&mut self.source, self.limits)?,
            Body::Pcd(pcd) => pcd.read(&mut self.source)?,
            Body::Npy(npy) => npy.read(&mut self.source)?,
            Body::Off(off) => off.read(&mut self.source)?,
            Body::Obj => obj::read(&mut self.source, self.limits)?,
            Body::E57 => e57::read(&mut self.source, self.limits)?,
            Body::Las => las::read(&mut self.source)?,
        };
        if cloud.positions.is_empty() {
            return Err(FormatError::Empty("points"));
        }
        let mut dropped = self.header.dropped_properties;
        dropped.append(&mut cloud.dropped_properties);
        cloud.dropped_properties = dropped;
        cloud.origin.sha256 = Some(self.source.sha256()?);
        Ok(cloud)
    }
}

/// Reads a cloud from a file, without limits. The content tells the format; the extension only keeps
/// text that is named `.ply` from being taken for XYZ.
///
/// # Errors
/// As [`CloudReader::open`] and [`CloudReader::read`], or the file cannot be opened.
pub fn read_cloud_file(path: &Path) -> Result<(Cloud, Header), FormatError> {
    let expected = Format::from_extension(path);
    let reader = CloudReader::open_as(File::open(path)?, Limits::default(), expected)?;
    let header = reader.header.clone();
    Ok((reader.read()?, header))
}

/// What the files of a format begin with, if not with points.
fn beginning(format: Format) -> Option<&'static str> {
    match format {
        Format::Ply { .. } => Some("the line `ply`"),
        Format::Las { .. } => Some("`LASF`"),
        Format::Pcd { .. } => Some("`# .PCD`"),
        Format::Npy { .. } => Some("`\\x93NUMPY`"),
        Format::E57 => Some("`ASTM-E57`"),
        Format::Off => Some("`OFF`"),
        Format::Obj => Some("lines such as `v 1 2 3`"),
        Format::Xyz { .. } => None,
    }
}

enum Sniffed {
    Ply,
    Pcd,
    Las,
    Npy,
    E57,
    Off,
    Obj,
    Text,
    Other(String),
    Nothing,
}

/// First bytes of formats that people will try, to name them in the refusal.
const KNOWN: [(&[u8], &str); 6] = [
    (b"\x1F\x8B", "a gzip file"),
    (b"\x28\xB5\x2F\xFD", "a Zstandard file"),
    (b"PK\x03\x04", "a ZIP file (an .npz is one; unpack it)"),
    (b"glTF", "a glTF mesh"),
    (b"solid ", "an STL mesh"),
    (b"\x89HDF", "an HDF5 file"),
];

fn sniff(head: &[u8]) -> Sniffed {
    if head.is_empty() {
        return Sniffed::Nothing;
    }
    if let Some(rest) = head.strip_prefix(b"ply")
        && rest.first().is_none_or(u8::is_ascii_whitespace)
    {
        return Sniffed::Ply;
    }
    // The comment is usual; the line after it is not optional.
    if head.starts_with(b"# .PCD") || head.starts_with(b"VERSION ") {
        return Sniffed::Pcd;
    }
    if head.starts_with(b"LASF") {
        return Sniffed::Las;
    }
    if head.starts_with(e57::MAGIC) {
        return Sniffed::E57;
    }
    if head.starts_with(npy::MAGIC) {
        return Sniffed::Npy;
    }
    if let Some((_, name)) = KNOWN.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Sniffed::Other((*name).to_owned());
    }
    let control = |b: &u8| *b < 0x20 && !b.is_ascii_whitespace() && !matches!(*b, 0x0B | 0x1A);
    if head.iter().any(control) {
        return Sniffed::Other(format!("binary data that begin with {}", shown(&head[..head.len().min(8)])));
    }
    let mut lines = head.split(|b| matches!(b, b'\n' | b'\r'));
    let first = lines.find_map(|line| next_token(&mut strip_comment(line)));
    if first.is_some_and(off::is_keyword) {
        return Sniffed::Off;
    }
    if obj::is_obj(head) { Sniffed::Obj } else { Sniffed::Text }
}
