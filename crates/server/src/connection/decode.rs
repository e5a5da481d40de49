//! Decodes a body's `Content-Encoding` while it arrives. Limits and memory count decoded bytes, not sent ones.

use std::io::{self, Write};

use axum::body::Bytes;
use axum::http::{HeaderMap, header};
use flate2::write::{MultiGzDecoder, ZlibDecoder};
use tokio::task::spawn_blocking;
use zstd::stream::raw;
use zstd::stream::zio;
use zstd::zstd_safe::DParameter;

use crate::admission::budget::Held;
use crate::connection::content::{Arriving, Content};
use crate::problem::Problem;

/// How a body is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Coding {
    Identity,
    Gzip,
    /// In zlib's format (RFC 9110, section 8.4.1.2).
    Deflate,
    /// With a window of up to 8 MiB, as RFC 9659 has it.
    Zstd,
}

/// The largest window that a frame of zstd may ask for, as a power of two: what web clients keep to. A frame's
/// header of a few bytes could ask for gigabytes.
const ZSTD_WINDOW: u32 = 23;
/// Memory of a zstd decoder: the window, and what it has beside that.
const ZSTD_MEMORY: u64 = (1 << ZSTD_WINDOW) + (512 << 10);

impl Coding {
    /// The values of `Accept-Encoding` for all that there are.
    pub(crate) const ACCEPTED: &str = "gzip, deflate, zstd, identity";

    /// The coding that these headers name.
    ///
    /// # Errors
    /// [`Problem::UnsupportedEncoding`] for others, and for several, one upon the other.
    pub(crate) fn of(headers: &HeaderMap) -> Result<Self, Problem> {
        let values = headers.get_all(header::CONTENT_ENCODING);
        let names: Vec<_> = values.iter().map(|value| String::from_utf8_lossy(value.as_bytes())).collect();
        match names.join(", ").trim().to_ascii_lowercase().as_str() {
            "" | "identity" => Ok(Self::Identity),
            "gzip" | "x-gzip" => Ok(Self::Gzip),
            "deflate" => Ok(Self::Deflate),
            "zstd" => Ok(Self::Zstd),
            other => Err(Problem::UnsupportedEncoding(other.to_owned())),
        }
    }
}

/// A body so far, decoded.
pub(crate) enum Decoder {
    Identity(Sink),
    Gzip(Box<MultiGzDecoder<Sink>>),
    Deflate(Box<ZlibDecoder<Sink>>),
    Zstd {
        decoder: Box<zio::Writer<Sink, raw::Decoder<'static>>>,
        /// Its own memory, which is more than small change.
        _own: Held,
    },
}

/// Why decoding ends early.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum DecodeError {
    /// More bytes than one body may have.
    TooLarge,
    /// No memory left for it.
    NoRoom,
    /// No more of the disk is to be taken.
    NoDisk,
    /// The disk does not take it.
    Disk(io::ErrorKind, String),
    /// Not what its coding says, or not all of it.
    Broken(String),
}

impl Decoder {
    /// For a body of this coding, of at most `limit` bytes when decoded, which goes to `arriving`; the first of two shares
    /// counts those in memory, the second those on the disk.
    ///
    /// # Errors
    /// [`DecodeError::NoRoom`] for the decoder itself.
    pub(crate) fn new(
        coding: Coding,
        arriving: Arriving,
        [held, on_disk]: [Held; 2],
        limit: u64,
    ) -> Result<Self, DecodeError> {
        let sink = Sink { arriving, held, on_disk, limit, refusal: None };
        Ok(match coding {
            Coding::Identity => Self::Identity(sink),
            Coding::Gzip => Self::Gzip(Box::new(MultiGzDecoder::new(sink))),
            Coding::Deflate => Self::Deflate(Box::new(ZlibDecoder::new(sink))),
            Coding::Zstd => {
                let own = sink.held.beside(ZSTD_MEMORY).ok_or(DecodeError::NoRoom)?;
                let mut decoder = raw::Decoder::new().map_err(broken)?;
                decoder.set_parameter(DParameter::WindowLogMax(ZSTD_WINDOW)).map_err(broken)?;
                Self::Zstd { decoder: Box::new(zio::Writer::new(sink, decoder)), _own: own }
            }
        })
    }

    /// What there is so far, or, where that is long, the beginning of it.
    pub(crate) fn head(&self) -> &[u8] {
        self.sink().arriving.head()
    }

    /// Takes one more piece. What a small piece becomes may be large, so decoding is done on a blocking
    /// thread, and so is writing to the disk.
    ///
    /// # Errors
    /// [`DecodeError`], as soon as the limit is passed.
    pub(crate) async fn add(mut self, piece: Bytes) -> Result<Self, DecodeError> {
        if matches!(&self, Self::Identity(sink) if !sink.arriving.is_on_disk(piece.len())) {
            return self.write(&piece).map(|()| self);
        }
        let written = spawn_blocking(move || self.write(&piece).map(|()| self));
        written.await.unwrap_or_else(|error| Err(DecodeError::Broken(error.to_string())))
    }

    /// The whole body, and its shares of the memory and of the disk.
    ///
    /// # Errors
    /// [`DecodeError::Broken`] where its end is missing or its checksum is wrong.
    pub(crate) fn finish(self) -> Result<(Content, [Held; 2]), DecodeError> {
        let sink = match self {
            Self::Identity(sink) => sink,
            Self::Gzip(decoder) => decoder.finish().map_err(broken)?,
            Self::Deflate(decoder) => decoder.finish().map_err(broken)?,
            Self::Zstd { mut decoder, .. } => {
                decoder.finish().map_err(broken)?;
                decoder.into_inner().0
            }
        };
        match sink.refusal {
            None => Ok((sink.arriving.finish(), [sink.held, sink.on_disk])),
            Some(refusal) => Err(refusal),
        }
    }

    fn write(&mut self, piece: &[u8]) -> Result<(), DecodeError> {
        let written = match self {
            Self::Identity(sink) => sink.write_all(piece),
            // Flushed, so that a file's header is seen as soon as it is there.
            Self::Gzip(decoder) => decoder.write_all(piece).and_then(|()| decoder.flush()),
            Self::Deflate(decoder) => decoder.write_all(piece).and_then(|()| decoder.flush()),
            Self::Zstd { decoder, .. } => decoder.write_all(piece).and_then(|()| decoder.flush()),
        };
        written.map_err(|error| {
            let refusal = self.sink_mut().refusal.take();
            refusal.unwrap_or_else(|| DecodeError::Broken(error.to_string()))
        })
    }

    fn sink(&self) -> &Sink {
        match self {
            Self::Identity(sink) => sink,
            Self::Gzip(decoder) => decoder.get_ref(),
            Self::Deflate(decoder) => decoder.get_ref(),
            Self::Zstd { decoder, .. } => decoder.writer(),
        }
    }

    fn sink_mut(&mut self) -> &mut Sink {
        match self {
            Self::Identity(sink) => sink,
            Self::Gzip(decoder) => decoder.get_mut(),
            Self::Deflate(decoder) => decoder.get_mut(),
            Self::Zstd { decoder, .. } => decoder.writer_mut(),
        }
    }
}

#[allow(clippy::needless_pass_by_value, reason = "for map_err")]
fn broken(error: io::Error) -> DecodeError {
    DecodeError::Broken(error.to_string())
}

/// Collects decoded bytes. It refuses the first byte above the limit, so that the decoder stops there.
#[derive(Debug)]
pub(crate) struct Sink {
    arriving: Arriving,
    held: Held,
    /// Of the disk's budget.
    on_disk: Held,
    limit: u64,
    refusal: Option<DecodeError>,
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.take(bytes).map_err(|refusal| {
            self.refusal = Some(refusal);
            io::Error::other("no room")
        })?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Sink {
    fn take(&mut self, bytes: &[u8]) -> Result<(), DecodeError> {
        if self.arriving.length() + bytes.len() as u64 > self.limit {
            return Err(DecodeError::TooLarge);
        }
        if !self.held.grow(self.arriving.grows(bytes.len())) {
            return Err(DecodeError::NoRoom);
        }
        if !self.on_disk.grow(self.arriving.grows_on_disk(bytes.len())) {
            return Err(DecodeError::NoDisk);
        }
        self.arriving.add(bytes).map_err(|error| match error.kind() {
            io::ErrorKind::OutOfMemory => DecodeError::NoRoom,
            kind => DecodeError::Disk(kind, error.to_string()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::admission::budget::Budget;
    use flate2::Compression;
    use flate2::write::{GzEncoder, ZlibEncoder};

    fn encode(coding: Coding, bytes: &[u8]) -> Vec<u8> {
        match coding {
            Coding::Identity => bytes.to_vec(),
            Coding::Gzip => {
                let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
                encoder.write_all(bytes).and_then(|()| encoder.finish()).expect("memory")
            }
            Coding::Deflate => {
                let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
                encoder.write_all(bytes).and_then(|()| encoder.finish()).expect("memory")
            }
            Coding::Zstd => zstd::encode_all(bytes, 3).expect("memory"),
        }
    }

    /// What comes of these bytes in pieces of `piece`.
    fn decode(coding: Coding, bytes: &[u8], piece: usize, limit: u64) -> Result<Vec<u8>, DecodeError> {
        let mut decoder = Decoder::new(coding, Arriving::new(None), shares(ROOM), limit)?;
        for piece in bytes.chunks(piece) {
            decoder.write(piece)?;
            assert!(decoder.head().len() as u64 <= limit);
        }
        decoder.finish().map(|(content, _)| content.head().to_vec())
    }

    fn shares(room: u64) -> [Held; 2] {
        [room, 0].map(|room| Budget::new(room).hold(0).expect("room"))
    }

    const CODINGS: [Coding; 4] = [Coding::Identity, Coding::Gzip, Coding::Deflate, Coding::Zstd];
    /// For one body, and the decoder that takes most.
    const ROOM: u64 = ZSTD_MEMORY + (1 << 20);

    #[test]
    fn bodies_come_out_as_they_went_in_however_they_are_cut() {
        let text: Vec<u8> = (0..5000_u32).flat_map(|i| format!("{i} 2 3\n").into_bytes()).collect();
        for coding in CODINGS {
            for piece in [1, 100, 100_000] {
                assert!(
                    decode(coding, &encode(coding, &text), piece, 1 << 20) == Ok(text.clone()),
                    "{coding:?}"
                );
            }
        }
        for coding in [Coding::Gzip, Coding::Zstd] {
            let twice = [encode(coding, b"1 2 3\n"), encode(coding, b"4 5 6\n")].concat();
            assert_eq!(decode(coding, &twice, 7, 100), Ok(b"1 2 3\n4 5 6\n".to_vec()));
        }
    }

    #[test]
    fn a_bomb_is_refused_at_the_limit() {
        for coding in CODINGS {
            let bomb = encode(coding, &vec![b' '; 600_000]);
            assert_eq!(decode(coding, &bomb, 1 << 20, 500_000), Err(DecodeError::TooLarge), "{coding:?}");
            let bomb = encode(coding, &vec![b' '; 2 * ROOM as usize]);
            assert_eq!(decode(coding, &bomb, 1 << 20, u64::MAX), Err(DecodeError::NoRoom), "{coding:?}");
        }
    }

    #[test]
    fn a_small_frame_cannot_ask_for_a_large_window() {
        use zstd::stream::write::Encoder;
        let text = b"1 2 3\n".repeat(1000);
        let with_window = |log: u32| {
            let mut encoder = Encoder::new(Vec::new(), 1).expect("memory");
            encoder.window_log(log).expect("a log");
            encoder.write_all(&text).and_then(|()| encoder.finish()).expect("memory")
        };
        assert_eq!(decode(Coding::Zstd, &with_window(ZSTD_WINDOW), 64, 1 << 20), Ok(text.clone()));
        let refused = decode(Coding::Zstd, &with_window(27), 64, 1 << 20);
        assert!(matches!(&refused, Err(DecodeError::Broken(why)) if why.contains("memory")), "{refused:?}");
        // And the one that is allowed is counted before it is taken.
        let refused = Decoder::new(Coding::Zstd, Arriving::new(None), shares(ZSTD_MEMORY - 1), 100);
        assert!(matches!(refused, Err(DecodeError::NoRoom)));
    }

    #[test]
    fn what_is_cut_off_or_broken_is_noticed() {
        for coding in [Coding::Gzip, Coding::Deflate, Coding::Zstd] {
            let whole = encode(coding, &b"1 2 3\n4 5 6\n".repeat(50));
            for end in 1..whole.len() {
                let found = decode(coding, &whole[..end], 8, 1000);
                assert!(matches!(found, Err(DecodeError::Broken(_))), "{coding:?} {end}: {found:?}");
            }
            // zstd's checksum is optional, and absent here.
            if coding != Coding::Zstd {
                let mut wrong = whole.clone();
                wrong[whole.len() - 1] ^= 1;
                assert!(decode(coding, &wrong, 8, 1000).is_err(), "{coding:?}");
            }
            assert!(decode(coding, &[&whole[..], b"more"].concat(), 8, 1000).is_err(), "{coding:?}");
            assert!(decode(coding, b"1 2 3\n", 8, 1000).is_err(), "{coding:?}");
        }
    }

    #[test]
    fn codings_are_known_by_their_names() {
        let of = |names: &[&'static str]| {
            let mut headers = HeaderMap::new();
            for name in names {
                headers.append(header::CONTENT_ENCODING, header::HeaderValue::from_static(name));
            }
            Coding::of(&headers)
        };
        for (names, coding) in [
            (&[][..], Coding::Identity),
            (&["Identity"], Coding::Identity),
            (&["GZIP"], Coding::Gzip),
            (&["x-gzip"], Coding::Gzip),
            (&["deflate"], Coding::Deflate),
            (&["zstd"], Coding::Zstd),
        ] {
            assert_eq!(of(names), Ok(coding));
        }
        for names in [&["br"][..], &["gzip, zstd"], &["gzip, gzip"], &["gzip", "deflate"]] {
            assert!(matches!(of(names), Err(Problem::UnsupportedEncoding(_))), "{names:?}");
        }
    }
}
