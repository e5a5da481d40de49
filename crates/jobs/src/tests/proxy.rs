//! A network between a database and those who ask it, which fails as it is told to.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::spawn;

/// How the network fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// Not at all.
    None,
    /// Nothing comes through, and nobody is told.
    Silence,
    /// Nobody gets a connection.
    Refused,
    /// Once, as a change is to be kept, the connection is lost before the database hears of it.
    Before,
    /// Or after it has done so, before anybody else hears of that.
    After,
    /// As [`Fault::After`], and then [`Fault::Refused`].
    AfterAll,
}

/// A port of this machine that leads to another.
pub(super) struct Proxy {
    pub(super) port: u16,
    network: Arc<Network>,
}

struct Network {
    to: u16,
    fault: Mutex<Fault>,
    changed: Condvar,
    /// Both ends of all connections.
    open: Mutex<Vec<TcpStream>>,
}

impl Proxy {
    /// Its threads end with the test.
    pub(super) fn to(to: u16) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let fault = Mutex::new(Fault::None);
        let network = Arc::new(Network { to, fault, changed: Condvar::new(), open: Mutex::default() });
        let shared = Arc::clone(&network);
        spawn(move || listener.incoming().flatten().for_each(|client| shared.connect(client)));
        Self { port, network }
    }

    pub(super) fn set(&self, fault: Fault) {
        *self.network.fault() = fault;
        self.network.changed.notify_all();
    }

    /// Whether a fault has happened that happens once.
    pub(super) fn has_failed(&self) -> bool {
        !matches!(*self.network.fault(), Fault::Before | Fault::After | Fault::AfterAll)
    }

    /// Loses all connections.
    pub(super) fn cut(&self) {
        let open = std::mem::take(&mut *self.network.open.lock().expect("no panic under it"));
        open.iter().for_each(close);
    }
}

/// What becomes of bytes that have come.
enum Next {
    Pass,
    Drop,
    /// Nor does anything else come through.
    End,
}

/// A word of those who ask, and of the database where it has done so.
fn is_commit(bytes: &[u8]) -> bool {
    bytes.windows(7).any(|text| text == b"COMMIT\0")
}

/// What becomes of an answer: where those who ask are cut off, nobody hears it, and the connection is lost once the change
/// is kept.
fn answer(bytes: &[u8], deaf: &Mutex<bool>) -> Next {
    if !*deaf.lock().expect("no panic under it") {
        return Next::Pass;
    }
    if is_commit(bytes) { Next::End } else { Next::Drop }
}

/// Whoever had it may have lost it already.
fn close(stream: &TcpStream) {
    let _ = stream.shutdown(Shutdown::Both);
}

impl Network {
    fn fault(&self) -> MutexGuard<'_, Fault> {
        self.fault.lock().expect("no panic under it")
    }

    /// Waits while nothing comes through.
    fn wait(&self) -> MutexGuard<'_, Fault> {
        let silent = |fault: &mut Fault| *fault == Fault::Silence;
        self.changed.wait_while(self.fault(), silent).expect("no panic under it")
    }

    fn connect(self: &Arc<Self>, client: TcpStream) {
        let Some(server) = self.server() else { return close(&client) };
        let deaf = Arc::new(Mutex::new(false));
        let ends = || (client.try_clone().expect("an end"), server.try_clone().expect("an end"));
        self.open.lock().expect("no panic under it").extend(<[_; 2]>::from(ends()));
        let ((asks, asked), (told, tells)) = (ends(), ends());
        let (network, hears) = (Arc::clone(self), Arc::clone(&deaf));
        spawn(move || network.pass(asks, asked, |bytes| network.ask(bytes, &hears)));
        let network = Arc::clone(self);
        spawn(move || network.pass(tells, told, |bytes| answer(bytes, &deaf)));
    }

    fn server(&self) -> Option<TcpStream> {
        if *self.wait() == Fault::Refused {
            return None;
        }
        TcpStream::connect(("127.0.0.1", self.to)).ok()
    }

    /// Passes on what comes, as long as it may.
    fn pass(&self, mut from: TcpStream, mut to: TcpStream, what: impl Fn(&[u8]) -> Next) {
        let mut buffer = [0; 1 << 16];
        while let Ok(count) = from.read(&mut buffer) {
            drop(self.wait());
            let bytes = &buffer[..count];
            let goes_on = count > 0
                && match what(bytes) {
                    Next::Pass => to.write_all(bytes).is_ok(),
                    Next::Drop => true,
                    Next::End => false,
                };
            if !goes_on {
                break;
            }
        }
        close(&from);
        close(&to);
    }

    /// Whether the database hears what it is asked.
    fn ask(&self, bytes: &[u8], deaf: &Mutex<bool>) -> Next {
        if !is_commit(bytes) {
            return Next::Pass;
        }
        let mut fault = self.fault();
        let now = *fault;
        match now {
            Fault::Before | Fault::After => *fault = Fault::None,
            Fault::AfterAll => *fault = Fault::Refused,
            _ => return Next::Pass,
        }
        *deaf.lock().expect("no panic under it") = now != Fault::Before;
        if now == Fault::Before { Next::End } else { Next::Pass }
    }
}
