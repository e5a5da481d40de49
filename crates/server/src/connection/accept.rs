//! Accepting connections and serving each until it ends, falls silent, or must close.
//!
//! `axum::serve` would be shorter, but it sets no timer for a request's head and no deadline for a
//! graceful end.

use std::collections::HashMap;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use hyper::Request;
use hyper::body::Incoming;
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tower::ServiceExt;

use crate::admission::client::network;
use crate::config::{Config, Timeouts};
use crate::connection::activity::Activity;
use crate::connection::body::Watched;
use crate::connection::prefix::BasePath;
use crate::connection::socket::Socket;

/// What a request knows of its connection.
#[derive(Debug, Clone)]
pub(crate) struct Connection {
    pub(crate) peer: SocketAddr,
    pub(crate) activity: Activity,
}

/// Largest head of a request, and most that is written ahead of a slow reader.
const BUFFER: usize = 64 << 10;
/// Requests at a time on one HTTP/2 connection.
const STREAMS: u32 = 32;
/// Time between two pings of an HTTP/2 client, and the longest wait for its answer.
const PING: Duration = Duration::from_secs(20);
/// After a failed accept: mostly no file descriptor is left, and trying at once would spin.
const PAUSE: Duration = Duration::from_millis(100);

/// Accepts until `closing` turns true; gives back the connections that are still open then. Dropping
/// them ends them.
pub(crate) async fn accept(
    listener: TcpListener,
    router: Router,
    config: &Config,
    mut closing: watch::Receiver<bool>,
) -> JoinSet<()> {
    let mut connections = JoinSet::new();
    // A semaphore: whoever accepts waits until one of the connections gives its place back.
    let places = Arc::new(Semaphore::new(config.limits.connections.min(Semaphore::MAX_PERMITS)));
    let addresses = Arc::new(Addresses::default());
    let is_closing = closing.clone();
    loop {
        let next = async {
            // Cannot fail: the semaphore is never closed.
            let place = Arc::clone(&places).acquire_owned().await.ok();
            (place, listener.accept().await)
        };
        tokio::select! {
            (place, accepted) = next => match accepted {
                Ok((stream, peer)) => {
                    let Some(own) = addresses.place(&peer, config.client_connections()) else {
                        tracing::debug!(%peer, "its address has too many connections open");
                        continue;
                    };
                    let (timeouts, base) = (config.timeouts.clone(), config.base_path.clone());
                    let served = serve(stream, peer, router.clone(), base, timeouts, is_closing.clone());
                    connections.spawn(async move {
                        served.await;
                        drop((place, own));
                    });
                }
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection");
                    tokio::time::sleep(PAUSE).await;
                }
            },
            Some(_) = connections.join_next() => {}
            () = closed(&mut closing) => return connections,
        }
    }
}

/// Open connections by address. Each address has a limit, so that no client takes all places with requests that need
/// no key, such as watches of the server's health.
#[derive(Default)]
struct Addresses(Mutex<HashMap<String, usize>>);

/// One of an address's connections, until dropped.
struct AddressPermit {
    addresses: Arc<Addresses>,
    address: String,
}

impl Addresses {
    fn place(self: &Arc<Self>, peer: &SocketAddr, most: usize) -> Option<AddressPermit> {
        let address = network(Some(peer.ip()));
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = open.get(&address).copied().unwrap_or(0);
        if count >= most {
            return None;
        }
        open.insert(address.clone(), count + 1);
        Some(AddressPermit { addresses: Arc::clone(self), address })
    }
}

impl Drop for AddressPermit {
    fn drop(&mut self) {
        let mut open = self.addresses.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = open.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                open.remove(&self.address);
            }
        }
    }
}

async fn serve(
    stream: TcpStream,
    peer: SocketAddr,
    router: Router,
    base: BasePath,
    timeouts: Timeouts,
    mut closing: watch::Receiver<bool>,
) {
    // Blocks are written whole; waiting to fill packets only delays the last one.
    let _ = stream.set_nodelay(true);
    let activity = Activity::default();
    let connection = Connection { peer, activity: activity.clone() };
    let service = service_fn(move |request: Request<Incoming>| {
        let mut request = request.map(|body| Body::new(Watched::new(body, &connection.activity)));
        request.extensions_mut().insert(connection.clone());
        base.strip(request.uri_mut());
        let router = router.clone();
        async move { Ok::<_, Infallible>(router.oneshot(request).await.unwrap_or_else(|never| match never {})) }
    });
    let socket = Socket::new(stream, activity.clone());
    let mut builder = Builder::new(TokioExecutor::new());
    builder
        .http1()
        // `silence` and `gone` see to what hyper would do here: close what is slow, and what the client has left.
        .header_read_timeout(None)
        .half_close(true)
        .max_buf_size(BUFFER)
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(STREAMS)
        .max_send_buf_size(BUFFER)
        .keep_alive_interval(PING)
        .keep_alive_timeout(PING);
    let mut served = pin!(builder.serve_connection(TokioIo::new(socket.clone()), service));
    let mut gone = pin!(socket.gone());
    let mut silence = pin!(activity.silence(&timeouts));
    let mut close = pin!(closed(&mut closing));
    let mut open = true;
    loop {
        tokio::select! {
            // What has arrived is read first; whether the client is still there is asked after that.
            biased;
            result = served.as_mut() => {
                if let Err(error) = result {
                    tracing::debug!(%peer, error, "connection broke");
                }
                return;
            }
            () = silence.as_mut() => {
                tracing::debug!(%peer, "connection fell silent");
                return;
            }
            () = gone.as_mut() => {
                tracing::debug!(%peer, "the client has left");
                return;
            }
            () = close.as_mut(), if open => {
                open = false;
                served.as_mut().graceful_shutdown();
            }
        }
    }
}

/// Resolves once `closing` is true; a sender that is gone means the same.
async fn closed(closing: &mut watch::Receiver<bool>) {
    let _ = closing.wait_for(|closing| *closing).await;
}
