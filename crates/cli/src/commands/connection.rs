//! Connections to a server elsewhere: by way of a proxy or not, and with an ear for what the server says while
//! it is still being sent a request. The second is by ureq's `unversioned` parts, which may change with its minor
//! versions; `Cargo.toml` stays at the one that this was written for.

use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::{fmt, io};

use ureq::config::Config;
use ureq::http::Uri;
use ureq::unversioned::resolver::DefaultResolver;
use ureq::unversioned::transport::{
    Buffers, ConnectionDetails, Connector, DefaultConnector, NextTimeout, Transport,
};
use ureq::{Agent, Error, Proxy, ProxyProtocol};

/// The proxy that the environment names (`HTTP_PROXY` and the like) for an address: none for this machine itself,
/// and none for what `NO_PROXY` excepts.
pub(super) fn proxy(address: &Uri) -> Option<Proxy> {
    // Others need TLS, or SOCKS, which this program has not.
    let proxy = Proxy::try_from_env().filter(|proxy| proxy.protocol() == ProxyProtocol::Http)?;
    (!is_loopback(address) && !proxy.is_no_proxy(address)).then_some(proxy)
}

fn is_loopback(address: &Uri) -> bool {
    let host = address.host().unwrap_or_default().trim_matches(['[', ']']);
    host.eq_ignore_ascii_case("localhost") || host.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

/// Whether the server closed the connection before the last request was sent as a whole.
#[derive(Debug, Clone, Default)]
pub(super) struct Closed(Arc<AtomicBool>);

impl Closed {
    pub(super) fn get(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn set(&self, closed: bool) {
        self.0.store(closed, Ordering::Relaxed);
    }
}

/// An agent that reads a server's answer also where the server closed the connection while the request was still
/// being sent, as HTTP lets it (RFC 9112, section 9.5): ureq alone gives up at the first write that fails, and an
/// answer that says why the request was refused would be lost. `closed` tells that it was so of the last request.
pub(super) fn agent(config: Config, closed: Closed) -> Agent {
    Agent::with_parts(config, DefaultConnector::new().chain(Listening(closed)), DefaultResolver::default())
}

#[derive(Debug)]
struct Listening(Closed);

impl<T: Transport> Connector<T> for Listening {
    type Out = Listened<T>;

    fn connect(&self, _: &ConnectionDetails<'_>, chained: Option<T>) -> Result<Option<Self::Out>, Error> {
        self.0.set(false);
        Ok(chained.map(|inner| Listened { inner, closed: self.0.clone() }))
    }
}

struct Listened<T> {
    inner: T,
    closed: Closed,
}

impl<T: Transport> Transport for Listened<T> {
    fn buffers(&mut self) -> &mut dyn Buffers {
        self.inner.buffers()
    }

    /// Takes, and drops, what can be sent no more, so that the answer is read next.
    fn transmit_output(&mut self, amount: usize, timeout: NextTimeout) -> Result<(), Error> {
        if self.closed.get() {
            return Ok(());
        }
        match self.inner.transmit_output(amount, timeout) {
            Err(Error::Io(why))
                if matches!(why.kind(), io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset) =>
            {
                self.closed.set(true);
                Ok(())
            }
            sent => sent,
        }
    }

    fn await_input(&mut self, timeout: NextTimeout) -> Result<bool, Error> {
        self.inner.await_input(timeout)
    }

    fn is_open(&mut self) -> bool {
        !self.closed.get() && self.inner.is_open()
    }

    fn is_tls(&self) -> bool {
        self.inner.is_tls()
    }
}

impl<T: Transport> fmt::Debug for Listened<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Listened").field("inner", &self.inner).field("closed", &self.closed).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_is_told_from_others() {
        for (address, expected) in [
            ("http://127.0.0.1:8080", true),
            ("http://127.9.9.9", true),
            ("http://[::1]:8080/x", true),
            ("http://LocalHost:1", true),
            ("http://localhost.example.org", false),
            ("http://10.0.0.1:8080", false),
        ] {
            assert_eq!(is_loopback(&address.parse().expect("an address")), expected, "{address}");
        }
    }
}
