//! The fixed part of a header.

use std::io::{self, Read, Seek, SeekFrom};

use super::super::FormatError;
use super::super::spool::Spool;
use super::LasOrigin;
use super::records::number;

/// The shortest header, that of version 1.0 to 1.2.
pub(super) const SHORTEST: usize = 227;

/// The header up to the point count of version 1.4.
pub(super) const LONGEST: usize = 255;

/// Where the number of points stands in 32 bits.
const LEGACY: std::ops::Range<usize> = 107..111;

/// The fixed part of a header, up to the point count of version 1.4 where it goes so far.
pub(super) struct Head(Vec<u8>);

impl Head {
    /// From a file that is as long as [`open`](super::read::open) has found.
    pub(super) fn of(file: &mut Spool) -> Result<Self, FormatError> {
        let mut bytes = vec![0; file.len().min(LONGEST as u64) as usize];
        file.read_at(0, &mut bytes)?;
        Ok(Self(bytes))
    }

    pub(super) fn number<const N: usize>(&self, from: usize) -> u64 {
        number::<N>(&self.0, from)
    }

    pub(super) fn version(&self) -> (u8, u8) {
        (self.0[24], self.0[25])
    }

    /// Where the points begin.
    pub(super) fn data(&self) -> u64 {
        self.number::<4>(96)
    }

    /// The top bits of the point format mean compression.
    pub(super) fn is_compressed(&self) -> bool {
        self.0[104] & 0xC0 != 0
    }

    /// How many points it counts.
    pub(super) fn counts(&self) -> Counts {
        Counts::of(&self.0)
    }

    /// Where the records after the points begin, and how many the header counts.
    pub(super) fn extended(&self) -> Option<(u64, u64)> {
        let has = self.version() >= (1, 4) && self.0.len() >= 247;
        has.then(|| (self.number::<8>(235), self.number::<4>(243)))
    }

    /// Where the waveforms begin that follow the points, if some do.
    pub(super) fn waveforms(&self) -> Option<u64> {
        let has = self.version() >= (1, 3) && self.0.len() >= 235;
        has.then(|| self.number::<8>(227)).filter(|from| *from > 0)
    }

    /// What it tells beside the points.
    pub(super) fn told(&self) -> LasOrigin {
        let mut las = LasOrigin {
            version: self.version(),
            file_source_id: self.number::<2>(4) as u16,
            // Reserved before version 1.2.
            global_encoding: if self.version() >= (1, 2) { self.number::<2>(6) as u16 } else { 0 },
            created: (self.number::<2>(90) as u16, self.number::<2>(92) as u16),
            ..LasOrigin::default()
        };
        las.guid.copy_from_slice(&self.0[8..24]);
        las.system_identifier.copy_from_slice(&self.0[26..58]);
        las
    }
}

/// How many points a header counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Counts {
    /// In 32 bits, as before version 1.4; there it should be 0 in files of the newer point formats.
    pub(super) legacy: u64,
    /// In 64 bits, from version 1.4 on.
    pub(super) modern: Option<u64>,
}

impl Counts {
    /// From the first bytes of a file, [`SHORTEST`] of them at least.
    pub(super) fn of(head: &[u8]) -> Self {
        let is_there =
            (head[24], head[25]) >= (1, 4) && number::<2>(head, 94) >= 255 && head.len() >= LONGEST;
        Self { legacy: number::<4>(head, 107), modern: is_there.then(|| number::<8>(head, 247)) }
    }

    /// How many there are: in 64 bits where those count any.
    pub(super) fn points(self) -> u64 {
        self.modern.filter(|count| *count > 0).unwrap_or(self.legacy)
    }

    /// A sentence about the count that is not believed, where there are two.
    pub(super) fn stale(self) -> Option<String> {
        let Self { legacy, modern: Some(modern) } = self else { return None };
        let (right, bits) = if modern > 0 { (modern, 64) } else { (legacy, 32) };
        // Newer point formats have no old count.
        (legacy != modern && legacy > 0).then(|| {
            format!(
                "the header counts {legacy} points in 32 bits and {modern} in 64; the {right} of {bits} bits were read"
            )
        })
    }
}

/// A file with the 32-bit count of points as the crate should have it, which believes that one rather than the 64-bit one.
pub(super) struct Rewritten {
    file: Spool,
    legacy: [u8; 4],
}

impl Rewritten {
    /// From its beginning.
    pub(super) fn new(mut file: Spool, head: &Head) -> io::Result<Self> {
        file.rewind()?;
        let counts = head.counts();
        let legacy = if counts.points() == counts.legacy { counts.legacy } else { 0 };
        Ok(Self { file, legacy: (legacy as u32).to_le_bytes() })
    }

    /// The file as it is.
    pub(super) fn into_inner(self) -> Spool {
        self.file
    }
}

impl Read for Rewritten {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let from = self.file.stream_position()?;
        let count = self.file.read(bytes)?;
        if from < LEGACY.end as u64 {
            for (place, byte) in LEGACY.zip(self.legacy) {
                if let Some(there) = place.checked_sub(from as usize).and_then(|i| bytes[..count].get_mut(i))
                {
                    *there = byte;
                }
            }
        }
        Ok(count)
    }
}

impl Seek for Rewritten {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}
