//! The signals that end the server, and the one that has it read its files again.

use std::io;
use std::process::exit;
use std::time::Duration;

use super::log::Log;
#[cfg(unix)]
use tokio::signal::unix::{Signal, SignalKind, signal};
#[cfg(windows)]
use tokio::signal::windows::{CtrlBreak, CtrlC, ctrl_break, ctrl_c};

/// What a shell reports for a process that a signal has ended is its number and this.
const BY_SIGNAL: i32 = 128;
/// The number of an interrupt, and so of what stands for it where there are no numbers.
const INTERRUPT: i32 = 2;
/// That of a wish to end.
const TERMINATE: i32 = 15;

/// For the last lines of the log, where the end is to be at once.
const LAST_LINES: Duration = Duration::from_millis(200);

/// Both ways in which the server is told to end, from now on caught.
pub(super) struct Signals {
    #[cfg(unix)]
    terminate: Signal,
    #[cfg(unix)]
    interrupt: Signal,
    /// Also what comes when nobody is at the console.
    #[cfg(windows)]
    terminate: CtrlBreak,
    #[cfg(windows)]
    interrupt: CtrlC,
}

impl Signals {
    /// Begins to catch them.
    ///
    /// # Errors
    /// The system's.
    #[cfg(unix)]
    pub(super) fn catch() -> io::Result<Self> {
        Ok(Self { terminate: signal(SignalKind::terminate())?, interrupt: signal(SignalKind::interrupt())? })
    }

    /// Begins to catch them.
    ///
    /// # Errors
    /// The system's.
    #[cfg(windows)]
    pub(super) fn catch() -> io::Result<Self> {
        Ok(Self { terminate: ctrl_break()?, interrupt: ctrl_c()? })
    }

    /// Resolves at the first signal; from then on the next one ends the process.
    pub(super) async fn first(mut self, log: Log) {
        self.next().await;
        tokio::spawn(async move {
            let number = self.next().await;
            tracing::warn!("second signal: ending at once");
            log.flush(LAST_LINES);
            exit(BY_SIGNAL + number);
        });
    }

    /// The number of the next signal.
    async fn next(&mut self) -> i32 {
        tokio::select! {
            _ = self.terminate.recv() => TERMINATE,
            _ = self.interrupt.recv() => INTERRUPT,
        }
    }
}

/// Hangups, from now on caught: what ends other programs when their terminal closes, and has servers read their files
/// again. There are none outside Unix.
pub(super) struct Hangups {
    #[cfg(unix)]
    hangup: Signal,
}

impl Hangups {
    /// Begins to catch them, in a runtime.
    ///
    /// # Errors
    /// The system's.
    pub(super) fn catch() -> io::Result<Self> {
        Ok(Self {
            #[cfg(unix)]
            hangup: signal(SignalKind::hangup())?,
        })
    }

    /// Resolves at the next one; several that come together may be one.
    pub(super) async fn next(&mut self) {
        #[cfg(unix)]
        self.hangup.recv().await;
        #[cfg(not(unix))]
        std::future::pending::<()>().await;
    }
}
