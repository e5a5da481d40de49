//! The server's log: lines on standard error that hold up nobody.
//!
//! Whoever logs puts a line into a queue; a thread of its own writes it. A reader who stands still, or a disk that is full, so
//! costs lines, which are counted, and nothing else: no request, no signal and no end of the program waits for the log.
//! `tracing-appender` has such a queue, but its bound is not in bytes, it does not count what cannot be written, and at its
//! end it may itself write to a stream that stands still.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Write};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use densecloud_server::LinesLost;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::fmt::MakeWriter;

/// Bytes of lines that wait to be written: some thousand.
const ROOM: usize = 1 << 20;
/// After a stream said that it takes nothing at the moment.
const PAUSE: Duration = Duration::from_millis(10);

/// Where lines are put; clones share one queue.
#[derive(Clone)]
pub(super) struct Log(Arc<Queue>);

struct Queue {
    waiting: Mutex<Waiting>,
    // A channel has no bound in bytes, and nobody could wait for its end.
    changed: Condvar,
    lost: LinesLost,
}

#[derive(Default)]
struct Waiting {
    lines: VecDeque<Vec<u8>>,
    bytes: usize,
    /// One of them is out of the queue and not written yet.
    writing: bool,
}

impl Log {
    /// A log to standard error.
    pub(super) fn start() -> io::Result<Self> {
        Self::to(standard_error())
    }

    /// A log to any place.
    fn to(place: impl Write + Send + 'static) -> io::Result<Self> {
        let (waiting, changed, lost) = Default::default();
        let queue = Arc::new(Queue { waiting, changed, lost });
        let log = Self(Arc::clone(&queue));
        std::thread::Builder::new().name("densecloud-log".into()).spawn(move || write(&queue, place))?;
        Ok(log)
    }

    /// Lines that were lost, of all clones.
    pub(super) fn lost(&self) -> &LinesLost {
        &self.0.lost
    }

    /// Adds a line, or counts it as lost where there is no room. Waits for nobody.
    pub(super) fn line(&self, line: Vec<u8>) {
        let mut waiting = self.0.waiting();
        if waiting.bytes + line.len() > ROOM {
            drop(waiting);
            self.0.lost.add();
            return;
        }
        waiting.bytes += line.len();
        waiting.lines.push_back(line);
        drop(waiting);
        self.0.changed.notify_all();
    }

    /// Waits until all lines are written, but no longer than this.
    pub(super) fn flush(&self, patience: Duration) {
        let busy = |waiting: &mut Waiting| waiting.writing || !waiting.lines.is_empty();
        // Whichever it was, there is nothing more to be done.
        let _ = self.0.changed.wait_timeout_while(self.0.waiting(), patience, busy);
    }
}

impl Queue {
    /// Nothing panics while it is held.
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next line, once there is one.
    fn next(&self) -> Vec<u8> {
        let mut waiting = self.waiting();
        loop {
            if let Some(line) = waiting.lines.pop_front() {
                waiting.bytes -= line.len();
                waiting.writing = true;
                return line;
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn written(&self) {
        self.waiting().writing = false;
        self.changed.notify_all();
    }
}

/// Standard error without the lock that others who write there take, and with the errors that the library's own stream
/// passes over.
#[cfg(unix)]
fn standard_error() -> Box<dyn Write + Send> {
    use std::os::fd::AsFd;
    match io::stderr().as_fd().try_clone_to_owned() {
        Ok(stream) => Box::new(std::fs::File::from(stream)),
        Err(_) => Box::new(io::stderr()),
    }
}

/// A console takes UTF-8 from the library's own stream alone.
#[cfg(not(unix))]
fn standard_error() -> Box<dyn Write + Send> {
    Box::new(io::stderr())
}

/// The thread's life. It ends with the process.
fn write(queue: &Queue, mut place: impl Write) {
    let mut told = 0;
    // Whether a line was cut off in its middle.
    let mut torn = false;
    loop {
        let mut line = queue.next();
        if torn {
            line.insert(0, b'\n');
        }
        let left = put(&mut place, &line);
        torn = if left == line.len() { torn } else { left > 0 };
        if left > 0 {
            queue.lost.add();
        }
        queue.written();
        let lost = queue.lost.count();
        if left == 0 && lost > told {
            told = lost;
            tracing::warn!(lost, "lines of the log were lost");
        }
    }
}

/// Writes as much as can be written; says how many bytes are left.
fn put(place: &mut impl Write, bytes: &[u8]) -> usize {
    let mut left = bytes;
    while !left.is_empty() {
        match place.write(left) {
            Ok(0) => break,
            Ok(count) => left = &left[count.min(left.len())..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            // Another program may have set the stream so.
            Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::sleep(PAUSE),
            Err(_) => break,
        }
    }
    left.len()
}

/// One line that comes in one piece: the subscriber writes each event as a whole. So what others say, and is told in an
/// event, cannot look like another.
impl Write for &Log {
    fn write(&mut self, event: &[u8]) -> io::Result<usize> {
        self.line(one_line(event));
        Ok(event.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// An event with its line breaks written as in JSON, but for the last.
fn one_line(event: &[u8]) -> Vec<u8> {
    let (text, end) = event.split_at(event.len() - usize::from(event.ends_with(b"\n")));
    let escaped = text.iter().flat_map(|byte| match byte {
        b'\n' => b"\\n",
        b'\r' => b"\\r",
        byte => std::slice::from_ref(byte),
    });
    escaped.chain(end).copied().collect()
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = &'a Self;

    fn make_writer(&'a self) -> Self::Writer {
        self
    }
}

/// Says why the server did not start, or has ended, as a line of a log in JSON, whatever else the log shows.
pub(super) fn failed_in_json(why: &str, place: impl for<'a> MakeWriter<'a> + Send + Sync + 'static) {
    let log = tracing_subscriber::fmt()
        .json()
        .with_max_level(LevelFilter::ERROR)
        .with_writer(place)
        .with_target(false)
        .log_internal_errors(false)
        .finish();
    tracing::subscriber::with_default(log, || tracing::error!(why, "failed"));
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, Sender, channel};

    use super::*;

    /// Longer than anything here takes.
    const LONG: Duration = Duration::from_secs(120);

    /// A place that does with each piece what a test says, and shows what it was given.
    struct Place {
        shown: Sender<String>,
        /// Bytes that are taken, or the error.
        takes: Receiver<io::Result<usize>>,
    }

    impl Write for Place {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _ = self.shown.send(String::from_utf8_lossy(bytes).into_owned());
            // A test that is over takes all.
            self.takes.recv().unwrap_or(Ok(bytes.len())).map(|most| most.min(bytes.len()))
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn log() -> (Log, Receiver<String>, Sender<io::Result<usize>>) {
        let ((shown, pieces), (sender, takes)) = (channel(), channel());
        (Log::to(Place { shown, takes }).expect("a thread"), pieces, sender)
    }

    #[test]
    fn lines_come_in_order_and_all_of_them_before_the_end() {
        let (log, pieces, takes) = log();
        drop(takes);
        for i in 0..1000 {
            log.line(format!("{i}\n").into());
        }
        log.flush(LONG);
        let written: String = pieces.try_iter().collect();
        assert_eq!(written, (0..1000).map(|i| format!("{i}\n")).collect::<String>());
        assert_eq!(log.lost().count(), 0);
    }

    #[test]
    fn a_reader_who_stands_still_costs_lines_and_nobody_waits() {
        let (log, pieces, takes) = log();
        log.line(b"first\n".into());
        assert_eq!(pieces.recv_timeout(LONG).expect("a piece"), "first\n");
        // It is being written, for as long as nobody takes it.
        let line = vec![b'x'; ROOM / 4];
        for _ in 0..7 {
            log.line(line.clone());
        }
        assert_eq!(log.lost().count(), 3, "four fit");
        log.flush(Duration::ZERO);
        drop(takes);
        log.flush(LONG);
        assert_eq!(pieces.try_iter().count(), 4);
    }

    #[test]
    fn lines_that_cannot_be_written_are_counted_and_the_next_one_is_tried() {
        let (log, pieces, takes) = log();
        for (line, error) in
            [("a\n", ErrorKind::StorageFull), ("b\n", ErrorKind::BrokenPipe), ("c\n", ErrorKind::Other)]
        {
            takes.send(Err(error.into())).expect("a place");
            log.line(line.into());
        }
        log.flush(LONG);
        assert_eq!(log.lost().count(), 3);
        takes.send(Ok(0)).expect("a place");
        log.line(b"d\n".into());
        takes.send(Ok(100)).expect("a place");
        log.line(b"e\n".into());
        log.flush(LONG);
        assert_eq!(log.lost().count(), 4);
        assert_eq!(pieces.try_iter().collect::<String>(), "a\nb\nc\nd\ne\n");
    }

    #[test]
    fn a_line_that_was_cut_off_is_ended_before_the_next() {
        let (log, pieces, takes) = log();
        for taken in [Ok(2), Err(ErrorKind::StorageFull.into()), Err(ErrorKind::StorageFull.into())] {
            takes.send(taken).expect("a place");
        }
        log.line(b"first\n".into());
        log.line(b"second\n".into());
        // Interrupted, not now, in two pieces.
        for taken in [Err(ErrorKind::Interrupted.into()), Err(ErrorKind::WouldBlock.into()), Ok(3), Ok(100)] {
            takes.send(taken).expect("a place");
        }
        log.line(b"third\n".into());
        log.line(b"fourth\n".into());
        drop(takes);
        log.flush(LONG);
        let pieces: Vec<_> = pieces.try_iter().collect();
        let expected =
            ["first\n", "rst\n", "\nsecond\n", "\nthird\n", "\nthird\n", "\nthird\n", "ird\n", "fourth\n"];
        assert_eq!(pieces, expected);
        assert_eq!(log.lost().count(), 2);
    }

    #[test]
    fn an_event_is_one_line_whatever_it_says() {
        let (log, pieces, takes) = log();
        drop(takes);
        let text = tracing_subscriber::fmt().with_writer(log.clone()).with_ansi(false).finish();
        tracing::subscriber::with_default(text, || {
            tracing::error!(error = %"no room\nDETAIL: none\r\n", "a\nb");
            tracing::error!("the next");
        });
        log.flush(LONG);
        let written: String = pieces.try_iter().collect();
        assert_eq!(written.lines().count(), 2, "{written}");
        assert!(written.contains("no room\\nDETAIL: none\\r\\n"), "{written}");
        assert!(!written.contains('\r') && written.ends_with("the next\n"), "{written}");
    }

    #[test]
    fn a_failure_is_one_line_of_json_whatever_the_log_shows() {
        let (log, pieces, takes) = log();
        drop(takes);
        failed_in_json("no \"port\"\nleft", log.clone());
        log.flush(LONG);
        let text: String = pieces.try_iter().collect();
        let event: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(event["level"], "ERROR");
        assert_eq!(event["fields"]["message"], "failed");
        assert_eq!(event["fields"]["why"], "no \"port\"\nleft");
        assert_eq!(text.matches('\n').count(), 1, "{text}");
    }
}
