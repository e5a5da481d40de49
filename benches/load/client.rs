//! Clients: one connection a request, from an address of their own.

use std::convert::Infallible;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use densecloud_geometry::Rng;
use http_body_util::combinators::UnsyncBoxBody;
use http_body_util::{BodyExt, Full, StreamBody};
use hyper::body::{Bytes, Frame, Incoming};
use hyper::client::conn::http1::handshake;
use hyper::{HeaderMap, Request, Response};
use hyper_util::rt::TokioIo;
use tokio::net::TcpSocket;
use tokio::task::AbortHandle;

pub(crate) struct Clients {
    pub(crate) address: SocketAddr,
    pub(crate) shares: Vec<f64>,
    pub(crate) keys: Vec<String>,
    pub(crate) headers: Vec<String>,
    pub(crate) patience: Duration,
}

pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) headers: HeaderMap,
    pub(crate) body: Vec<u8>,
    /// When the head of the answer was there.
    pub(crate) told: Instant,
}

/// A connection, closed with the request that it is for.
struct Open(AbortHandle);

impl Drop for Open {
    fn drop(&mut self) {
        self.0.abort();
    }
}

pub(crate) type Body = UnsyncBoxBody<Bytes, Infallible>;

pub(crate) fn whole(bytes: Bytes) -> Body {
    Full::new(bytes).boxed_unsync()
}

/// The first half of a body whose rest never comes.
pub(crate) fn half(bytes: &Bytes) -> Body {
    let first = Ok(Frame::data(bytes.slice(..bytes.len() / 2)));
    let frames = futures::stream::once(async { first });
    StreamBody::new(futures::StreamExt::chain(frames, futures::stream::pending())).boxed_unsync()
}

impl Clients {
    /// One of them, by their shares.
    pub(crate) fn draw(&self, random: &mut Rng) -> usize {
        let mut place = random.f64() * self.shares.iter().sum::<f64>();
        let found = self.shares.iter().position(|share| {
            place -= share;
            place < 0.0
        });
        found.unwrap_or(0)
    }

    /// Asks and reads the whole answer.
    pub(crate) async fn ask(
        &self,
        client: usize,
        method: &str,
        target: &str,
        headers: &[(&str, &str)],
        body: Body,
    ) -> Result<Answer, String> {
        let (_open, response) = self.begin(client, method, target, headers, body).await?;
        let told = Instant::now();
        let (head, mut frames) = response.into_parts();
        let mut body = Vec::new();
        while let Some(frame) = frames.frame().await {
            let frame = frame.map_err(|error| format!("an answer broke off: {error}"))?;
            body.extend_from_slice(frame.data_ref().map_or(&[], |data| data));
        }
        Ok(Answer { status: head.status.as_u16(), headers: head.headers, body, told })
    }

    /// As [`Clients::ask`], but leaves when the answer begins.
    pub(crate) async fn leave_early(
        &self,
        client: usize,
        method: &str,
        target: &str,
        body: Body,
    ) -> Result<(), String> {
        self.begin(client, method, target, &[], body).await.map(|_| ())
    }

    async fn begin(
        &self,
        client: usize,
        method: &str,
        target: &str,
        headers: &[(&str, &str)],
        body: Body,
    ) -> Result<(Open, Response<Incoming>), String> {
        let mut request = Request::builder().method(method).uri(target).header("host", "load");
        for line in &self.headers {
            let (name, value) = line.split_once(": ").expect("--header is NAME: VALUE");
            request = request.header(name, value);
        }
        if !self.keys.is_empty() {
            let key = &self.keys[client % self.keys.len()];
            request = request.header("authorization", format!("Bearer {key}"));
        }
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let request = request.body(body).expect("a request");
        let socket = TcpSocket::new_v4().map_err(|e| format!("no socket: {e}"))?;
        // Loopback has 16 million addresses on Linux; elsewhere, all clients are one.
        let _ = socket.bind((Ipv4Addr::new(127, 0, 0, 2 + client as u8), 0).into());
        let stream = socket.connect(self.address).await.map_err(|e| format!("not connected: {e}"))?;
        let _ = stream.set_nodelay(true);
        let (mut sender, connection) =
            handshake(TokioIo::new(stream)).await.map_err(|e| format!("not connected: {e}"))?;
        let open = Open(tokio::spawn(async { drop(connection.await) }).abort_handle());
        let response = sender.send_request(request).await.map_err(|e| format!("not answered: {e}"))?;
        Ok((open, response))
    }

    /// A figure of `/metrics`.
    pub(crate) async fn metric(&self, name: &str) -> Option<f64> {
        let page = self.ask(0, "GET", "/metrics", &[], whole(Bytes::new())).await.ok()?;
        let text = String::from_utf8(page.body).ok()?;
        text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok())
    }

    /// Waits until the server has nothing left to do; whether that came to be.
    pub(crate) async fn idle(&self) -> bool {
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(120) {
            if self.metric("densecloud_queue_points").await == Some(0.0)
                && self.metric("densecloud_requests_in_flight").await == Some(0.0)
            {
                return true;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        false
    }
}
