//! A connection's socket, as the HTTP library reads and writes it, and as the connection's task looks at it meanwhile.
//!
//! Three things need the bytes themselves: when a head has begun, whether a client that closed its sending side is
//! still there, and what a head had that the library refuses by itself.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::Bytes;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep};

use crate::connection::activity::Activity;
use crate::connection::head;

/// What every answer of HTTP/1 begins with, whatever it will be.
const BEGINNING: &[u8] = b"HTTP/1.";
/// What HTTP/2 begins with.
const PREFACE: &[u8] = b"PRI * HTTP/2";
/// Bytes of a head that are kept, until the next one comes: more than other programs send.
const KEPT: usize = 16 << 10;
/// How often a client that closed its sending side is looked at.
const TICK: Duration = Duration::from_millis(100);
/// From the first byte that asks whether it is still there to the second; each next gap is twice as long.
const GAP: Duration = Duration::from_secs(1);

/// One connection's socket. Cheap to clone.
///
/// A mutex that is never contended: the library and the connection's task are polled by the same task.
#[derive(Clone)]
pub(crate) struct Socket(Arc<Mutex<State>>);

struct State {
    stream: TcpStream,
    activity: Activity,
    /// Whether all that the library wrote has gone to the system: then the next answer begins here.
    flushed: bool,
    /// Bytes of the next answer's [`BEGINNING`] that were sent before it.
    ahead: usize,
    /// The head that is arriving, and what came with it.
    head: Vec<u8>,
    /// Requests before that head.
    before: u64,
    /// What is still to be sent of an answer that takes the place of the library's own.
    instead: Option<Bytes>,
}

/// What a client did.
enum End {
    /// It sends no more, and may still read.
    Sending,
    /// It is gone.
    Gone,
}

impl Socket {
    pub(crate) fn new(stream: TcpStream, activity: Activity) -> Self {
        let (head, before, instead) = (Vec::new(), 0, None);
        Self(Arc::new(Mutex::new(State { stream, activity, flushed: true, ahead: 0, head, before, instead })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Resolves once the client is gone while a request of HTTP/1 is worked on. One that only closed its sending side is
    /// still served.
    ///
    /// Both look the same until something is sent: a system whose program has closed the whole connection answers that
    /// with a reset. So the first bytes of the answer, which are known beforehand, are sent one at a time.
    pub(crate) async fn gone(&self) {
        match std::future::poll_fn(|context| self.state().poll_end(context)).await {
            End::Gone => return,
            End::Sending => self.state().activity.half_closed(),
        }
        let (mut due, mut gap) = (Instant::now(), GAP);
        loop {
            let asks = Instant::now() >= due;
            match self.state().look(asks) {
                Err(_) => return,
                Ok(true) => {
                    due += gap;
                    gap *= 2;
                }
                Ok(false) => {}
            }
            sleep(TICK).await;
        }
    }
}

impl State {
    /// Whether the client has closed its side of the connection, while a request is in flight. Without one, and on
    /// HTTP/2, the library reads all that comes.
    fn poll_end(&mut self, context: &mut Context<'_>) -> Poll<End> {
        if self.activity.is_idle() || self.is_multiplexed() {
            return Poll::Pending;
        }
        let mut byte = [0];
        match ready!(self.stream.poll_peek(context, &mut ReadBuf::new(&mut byte))) {
            Ok(0) => Poll::Ready(End::Sending),
            // The library has still to read that; nothing can be seen behind it.
            Ok(_) => Poll::Pending,
            Err(_) => Poll::Ready(End::Gone),
        }
    }

    /// Sends one more byte of the beginning where `asks` and where nothing of the answer has been sent; true where
    /// it did.
    ///
    /// # Errors
    /// The client is gone.
    fn look(&mut self, asks: bool) -> io::Result<bool> {
        if let Some(error) = self.stream.take_error()? {
            return Err(error);
        }
        let begun = !self.flushed || !self.activity.is_waited_for();
        let Some(next) = BEGINNING.get(self.ahead..=self.ahead).filter(|_| asks && !begun) else {
            return Ok(false);
        };
        match self.stream.try_write(next) {
            Ok(count) => {
                self.ahead += count;
                Ok(true)
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(error),
        }
    }

    fn is_multiplexed(&self) -> bool {
        self.head.starts_with(PREFACE)
    }

    /// Bytes have arrived.
    fn received(&mut self, bytes: &[u8]) {
        if self.is_multiplexed() {
            return;
        }
        // What else comes is a body.
        let Some(before) = self.activity.received() else { return };
        if before != self.before {
            self.before = before;
            self.head.clear();
        }
        let room = KEPT.saturating_sub(self.head.len());
        self.head.extend_from_slice(&bytes[..bytes.len().min(room)]);
    }

    /// Bytes have gone to the system. On HTTP/2 they may be those of a ping, and say nothing of an answer.
    fn sent(&self, all: bool) {
        if !self.is_multiplexed() {
            self.activity.sent(all);
        }
    }

    /// Bytes of what the library writes that are not to be sent: they have been already, or something else is sent.
    fn taken(&mut self, bytes: &[u8]) -> usize {
        if self.instead.is_none() && self.before == self.activity.count() {
            self.instead = head::answer_instead(&self.head, bytes);
        }
        if self.instead.is_some() {
            return bytes.len();
        }
        let taken = self.ahead.min(bytes.len());
        self.ahead -= taken;
        taken
    }

    /// Sends what takes the place of the library's answer.
    fn poll_instead(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        while let Some(rest) = self.instead.as_mut().filter(|rest| !rest.is_empty()) {
            let count = ready!(Pin::new(&mut self.stream).poll_write(context, rest))?;
            let _sent = rest.split_to(count);
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncRead for Socket {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut state = self.state();
        let before = buffer.filled().len();
        ready!(Pin::new(&mut state.stream).poll_read(context, buffer))?;
        let new = &buffer.filled()[before..];
        if !new.is_empty() {
            state.received(new);
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Socket {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.poll_write_vectored(context, &[IoSlice::new(bytes)])
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let mut state = self.state();
        let first = pieces.iter().find(|piece| !piece.is_empty()).map_or(&[][..], |piece| &piece[..]);
        let taken = state.taken(first);
        if taken > 0 {
            return Poll::Ready(Ok(taken));
        }
        let count = ready!(Pin::new(&mut state.stream).poll_write_vectored(context, pieces))?;
        state.flushed = false;
        state.sent(false);
        Poll::Ready(Ok(count))
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let mut state = self.state();
        ready!(state.poll_instead(context))?;
        ready!(Pin::new(&mut state.stream).poll_flush(context))?;
        state.flushed = true;
        state.sent(true);
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let mut state = self.state();
        ready!(state.poll_instead(context))?;
        Pin::new(&mut state.stream).poll_shutdown(context)
    }
}
