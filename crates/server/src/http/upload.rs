//! Receiving a request's body: into memory or, where it is long, to the disk, under limits, refused as soon as its header
//! is there.

use std::path::Path;
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes, HttpBody};
use axum::http::{HeaderMap, header};
use http_body_util::BodyExt;
use tokio::time::timeout;

use crate::admission::budget::Held;
use crate::app::App;
use crate::connection::content::{Arriving, Content};
use crate::connection::decode::{Coding, DecodeError, Decoder};
use crate::problem::Problem;
use crate::tiled::Open;
use densecloud_formats::{CloudReader, FirstBytes, FormatError, Header, Limits, Reading};

/// A body that arrives, or is given up politely.
pub(crate) struct Upload {
    body: Body,
    /// Nothing has been read yet, and the client waits for a `100 Continue` before it sends.
    waits: bool,
    /// Whether it is said to be the fields of a form, as curl says of all that it posts, and nothing that has come so
    /// far would not be left by its `-d`, which takes line ends and zero bytes out of a file. Of what is compressed the
    /// bytes that come say nothing.
    stripped: bool,
    /// Whether something has come.
    begun: bool,
}

/// A body that has arrived.
#[derive(Debug)]
pub(crate) struct Received {
    content: Content,
    // Given back with the content, wherever that is dropped.
    held: [Held; 2],
    /// How long it took to arrive.
    pub(crate) took: Duration,
}

/// How long, and how much of, a refused body is read and thrown away, so that the client finds the
/// answer before the connection closes under it.
const LINGER: Duration = Duration::from_secs(10);
const LINGER_BYTES: usize = 512 << 20;

impl Upload {
    pub(crate) fn new(headers: &HeaderMap, body: Body) -> Self {
        let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
        let kind = kind.split(';').next().unwrap_or_default().trim();
        let plain = matches!(Coding::of(headers), Ok(Coding::Identity));
        let stripped = plain && kind.eq_ignore_ascii_case("application/x-www-form-urlencoded");
        Self { body, waits: headers.contains_key(header::EXPECT), stripped, begun: false }
    }

    /// As [`Upload::receive`], for a body that nothing but its own content tells about. Where that was stripped, as no
    /// cloud of two points can be, this is told instead of what else is wrong with it.
    ///
    /// # Errors
    /// Also [`Problem::Stripped`].
    pub(crate) async fn receive_file(
        &mut self,
        headers: &HeaderMap,
        app: &App,
        reading: &Reading,
        known: impl FnMut(&Header) -> Result<(), Problem>,
    ) -> Result<Received, Problem> {
        match self.receive(headers, app, reading, known).await {
            Ok(_) | Err(Problem::UnsupportedFormat(_) | Problem::Malformed(_) | Problem::Interrupted(_))
                if self.begun && self.stripped =>
            {
                Err(Problem::Stripped)
            }
            received => received,
        }
    }

    /// Reads the body to its end. Memory grows with what arrives, not with what is claimed. `known` hears
    /// the points in as soon as the file's header tells them, where it does.
    ///
    /// # Errors
    /// The body is compressed in an unknown way, too large, stalls or breaks off; its header claims too much; `known`
    /// refuses; or its beginning is in no known format. All but the end of the body
    /// are noticed while it arrives.
    pub(crate) async fn receive(
        &mut self,
        headers: &HeaderMap,
        app: &App,
        reading: &Reading,
        known: impl FnMut(&Header) -> Result<(), Problem>,
    ) -> Result<Received, Problem> {
        let mut check = HeaderCheck::new(app, Some(reading), known);
        let judge = |bytes: &[u8], new| check.judge(bytes, new);
        self.receive_into(Some(&app.config.temp_dir()), headers, app, judge).await
    }

    /// As [`Upload::receive`], for what is not a file and stays in memory: after each piece, `judge` is shown all that has
    /// arrived, and how much of it is new.
    pub(crate) async fn receive_judged(
        &mut self,
        headers: &HeaderMap,
        app: &App,
        judge: impl FnMut(&[u8], usize) -> Result<(), Problem>,
    ) -> Result<Received, Problem> {
        self.receive_into(None, headers, app, judge).await
    }

    async fn receive_into(
        &mut self,
        temp: Option<&Path>,
        headers: &HeaderMap,
        app: &App,
        mut judge: impl FnMut(&[u8], usize) -> Result<(), Problem>,
    ) -> Result<Received, Problem> {
        let coding = Coding::of(headers)?;
        self.check_length(app.config.limits.body_bytes, app)?;
        let mut arrival = Arrival::begin(coding, temp, app)?;
        while let Some(chunk) = self.next(app.config.timeouts.stall).await? {
            arrival = arrival.add(chunk, &mut judge).await?;
        }
        arrival.finish()
    }

    /// Refuses a body that is known to be longer than `most`: from Content-Length, or from HTTP/2's END_STREAM.
    pub(crate) fn check_length(&self, most: u64, app: &App) -> Result<(), Problem> {
        if self.body.size_hint().lower() > most {
            return Err(Problem::BodyTooLarge { limit: app.config.limits.body_bytes });
        }
        Ok(())
    }

    /// Bytes in the whole body, where that is known beforehand.
    pub(crate) fn length(&self, headers: &HeaderMap) -> Option<u64> {
        let plain = !headers.contains_key(header::CONTENT_ENCODING);
        self.body.size_hint().exact().filter(|_| plain)
    }

    /// Throws away what still arrives, in the background, for a moment.
    ///
    /// Closing a connection while the client sends makes its system discard our answer (the reset
    /// overtakes it), so the reason for the refusal would often be lost.
    pub(crate) fn give_up(self) {
        if self.waits || self.body.is_end_stream() {
            return;
        }
        let mut body = self.body;
        tokio::spawn(timeout(LINGER, async move {
            let mut left = LINGER_BYTES;
            while let Some(Ok(frame)) = body.frame().await {
                left = left.saturating_sub(frame.data_ref().map_or(0, Bytes::len));
                if left == 0 {
                    break;
                }
            }
        }));
    }

    /// The next piece, or nothing at the end.
    pub(crate) async fn next(&mut self, stall: Duration) -> Result<Option<Bytes>, Problem> {
        loop {
            self.waits = false;
            match timeout(stall, self.body.frame()).await {
                Err(_) => return Err(Problem::UploadStalled { limit: stall }),
                Ok(None) => return Ok(None),
                // What is sent in messages, and not as one file, may be wrong in itself.
                Ok(Some(Err(error))) => return Err(broken(error)),
                // Trailers are no part of a cloud.
                Ok(Some(Ok(frame))) => {
                    if let Ok(data) = frame.into_data() {
                        self.begun |= !data.is_empty();
                        self.stripped = self.stripped && !data.iter().any(|byte| b"\n\r\0".contains(byte));
                        return Ok(Some(data));
                    }
                }
            }
        }
    }
}

/// Why a body broke. What is a problem of ours comes in a wrapping or two.
fn broken(error: axum::Error) -> Problem {
    let mut error = error.into_inner();
    loop {
        error = match error.downcast::<axum::Error>() {
            Ok(wrapped) => wrapped.into_inner(),
            Err(error) => {
                return match error.downcast::<Problem>() {
                    Ok(problem) => *problem,
                    Err(error) => Problem::Interrupted(error.to_string()),
                };
            }
        };
    }
}

/// A cloud so far.
pub(crate) struct Arrival<'a> {
    app: &'a App,
    decoder: Decoder,
    /// Bytes as they came.
    sent: u64,
    start: Instant,
}

impl<'a> Arrival<'a> {
    /// Of a cloud that is compressed like this.
    ///
    /// What is long goes to a file in the folder `temp`, if there is one.
    pub(crate) fn begin(coding: Coding, temp: Option<&Path>, app: &'a App) -> Result<Self, Problem> {
        let held = app.budget.hold(0).ok_or_else(|| app.held_full())?;
        let on_disk = app.disk.hold(0).ok_or_else(|| app.disk_full())?;
        let limit = app.config.limits.body_bytes;
        let decoder = Decoder::new(coding, Arriving::new(temp), [held, on_disk], limit);
        let decoder = decoder.map_err(|refusal| refused(app, refusal))?;
        Ok(Self { app, decoder, sent: 0, start: Instant::now() })
    }

    /// Takes a piece, and shows `judge` all that has arrived, or the beginning of that, and how much of it is new.
    pub(crate) async fn add(
        self,
        piece: Bytes,
        mut judge: impl FnMut(&[u8], usize) -> Result<(), Problem>,
    ) -> Result<Self, Problem> {
        let Self { app, decoder, mut sent, start } = self;
        // Compressed, endlessly much may stand for nothing.
        sent += piece.len() as u64;
        if sent > app.config.limits.body_bytes {
            return Err(refused(app, DecodeError::TooLarge));
        }
        let before = decoder.head().len();
        let decoder = decoder.add(piece).await.map_err(|refusal| refused(app, refusal))?;
        let new = decoder.head().len() - before;
        if new > 0 {
            judge(decoder.head(), new)?;
        }
        Ok(Self { app, decoder, sent, start })
    }

    pub(crate) fn finish(self) -> Result<Received, Problem> {
        let (content, held) = self.decoder.finish().map_err(|refusal| refused(self.app, refusal))?;
        Ok(Received { content, held, took: self.start.elapsed() })
    }
}

fn refused(app: &App, refusal: DecodeError) -> Problem {
    match refusal {
        DecodeError::TooLarge => Problem::BodyTooLarge { limit: app.config.limits.body_bytes },
        DecodeError::NoRoom => app.held_full(),
        DecodeError::NoDisk => app.disk_full(),
        DecodeError::Disk(kind, why) => Problem::of_temp(kind, why),
        DecodeError::Broken(why) => Problem::Interrupted(why),
    }
}

impl Received {
    /// What arrived, or, where that is long, the beginning of it.
    pub(crate) fn head(&self) -> &[u8] {
        self.content.head()
    }

    pub(crate) fn length(&self) -> u64 {
        self.content.length()
    }

    pub(crate) fn content(&self) -> &Content {
        &self.content
    }

    /// Begins to read the cloud as is asked.
    ///
    /// # Errors
    /// What [`CloudReader`] gives, as problems.
    pub(crate) fn open(&self, app: &App, reading: &Reading) -> Result<CloudReader<'static>, Problem> {
        Ok(self.content.open(reader_limits(app), reading)?)
    }

    /// What opens it later, and its shares of memory and disk, to be kept for as long as it is read.
    pub(crate) fn into_opener(self) -> (Box<Open>, [Held; 2]) {
        let Self { content, held, .. } = self;
        (Box::new(move |limits, reading| content.open(limits, reading)), held)
    }
}

pub(crate) fn reader_limits(app: &App) -> Limits {
    let limits = &app.config.limits;
    Limits { max_bytes: Some(limits.body_bytes), max_points: Some(limits.points_in) }
}

/// Checks a file's header in its first bytes, so that a cloud that is too large is refused before the rest of it
/// arrives.
pub(crate) struct HeaderCheck<'a, F> {
    app: &'a App,
    /// How the file will be read, unless that is yet to come.
    reading: Option<&'a Reading>,
    /// Is shown the header where that tells how many points there are.
    known: F,
    done: bool,
}

impl<'a, F: FnMut(&Header) -> Result<(), Problem>> HeaderCheck<'a, F> {
    pub(crate) fn new(app: &'a App, reading: Option<&'a Reading>, known: F) -> Self {
        Self { app, reading, known, done: false }
    }

    /// To be shown all that has arrived, of which `new` bytes are new.
    pub(crate) fn judge(&mut self, bytes: &[u8], new: usize) -> Result<(), Problem> {
        if self.done {
            return Ok(());
        }
        let first = FirstBytes::of(bytes, new);
        if first == FirstBytes::TooFew {
            return Ok(());
        }
        self.done = true;
        let unread = Reading::default();
        match CloudReader::open_as(bytes, reader_limits(self.app), self.reading.unwrap_or(&unread)) {
            // What is asked for later may be another format.
            Err(FormatError::Unrecognised { .. }) if self.reading.is_none() => Ok(()),
            Ok(reader) if reader.header().points.is_some() => (self.known)(reader.header()),
            Ok(_) => Ok(()),
            // Only the whole of it can be judged.
            Err(FormatError::Malformed { .. } | FormatError::Truncated { .. } | FormatError::Empty(_))
                if first == FirstBytes::CutOff =>
            {
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }
}
