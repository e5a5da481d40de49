//! Who asks: by the key that is shown where keys are needed, else by the address.

use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::admission::keys::Keys;
use crate::app::App;
use crate::connection::accept::Connection;
use crate::problem::Problem;
use crate::{grpc, inference, page};
use densecloud_engine::Client;

/// Who may ask, and how clients are told apart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Access {
    /// The keys, where one is needed (`--keys`).
    pub keys: Option<Arc<Keys>>,
    /// Whether `/healthz`, `/readyz` and what is like them under `/v2` need none (`--open health`).
    pub open_health: bool,
    /// Whether `/metrics` needs none (`--open metrics`).
    pub open_metrics: bool,
    /// Whether the page at `/`, `/openapi.json` and `/docs` need none (`--open docs`).
    pub open_docs: bool,
    /// Whether the last hop named by `X-Forwarded-For` is the client's address (`--trust-forwarded`). Only for use
    /// behind a proxy that sets the header: a client can send it, too.
    pub trust_forwarded: bool,
}

impl Default for Access {
    /// No keys; with keys, all but the work is open.
    fn default() -> Self {
        Self { keys: None, open_health: true, open_metrics: true, open_docs: true, trust_forwarded: false }
    }
}

impl Access {
    /// Who sends a request with these headers.
    ///
    /// # Errors
    /// [`Problem::Unauthorized`] where a key is needed.
    pub(crate) fn client(&self, headers: &HeaderMap, peer: Option<IpAddr>) -> Result<Client, Problem> {
        let Some(keys) = &self.keys else {
            return Ok(Client::new(&network(self.address(headers, peer))));
        };
        let key = key(headers).ok_or(Problem::Unauthorized("this server needs a key, and none came"))?;
        let name = keys.name(key).ok_or(Problem::Unauthorized("this key is not known here"))?;
        Ok(Client::new(&name))
    }

    fn address(&self, headers: &HeaderMap, peer: Option<IpAddr>) -> Option<IpAddr> {
        let forwarded =
            headers.get_all("x-forwarded-for").iter().next_back().filter(|_| self.trust_forwarded);
        let last = forwarded.and_then(|value| value.to_str().ok()?.rsplit(',').next());
        last.and_then(|hop| address_of(hop.trim())).or(peer)
    }

    /// Whether a path needs no key.
    fn is_open(&self, path: &str) -> bool {
        match path {
            "/healthz" | "/readyz" => self.open_health,
            "/metrics" => self.open_metrics,
            "/openapi.json" | "/docs" => self.open_docs,
            path if path.starts_with("/grpc.reflection.") || page::is_part(path) => self.open_docs,
            path => self.open_health && (inference::is_probe(path) || grpc::is_probe(path)),
        }
    }

    /// Whose jobs somebody may see: with keys, their own; without, all.
    pub(crate) fn owner(&self, client: &Client) -> Option<String> {
        self.keys.as_ref().map(|_| client.name().to_owned())
    }
}

/// The key that came, as `Authorization: Bearer KEY` or `X-API-Key: KEY`.
fn key(headers: &HeaderMap) -> Option<&[u8]> {
    match headers.get(header::AUTHORIZATION) {
        Some(value) => {
            let (scheme, key) = value.as_bytes().split_at_checked("bearer ".len())?;
            scheme.eq_ignore_ascii_case(b"bearer ").then(|| key.trim_ascii())
        }
        None => headers.get("x-api-key").map(|value| value.as_bytes()),
    }
}

/// The address that a proxy names; some add the port.
fn address_of(hop: &str) -> Option<IpAddr> {
    let with_port = || hop.parse().ok().map(|address: SocketAddr| address.ip());
    hop.parse().ok().or_else(with_port)
}

/// The name of a client by its address; of a whole network of IPv6, since a household has one.
pub(crate) fn network(address: Option<IpAddr>) -> String {
    match address.map(|address| address.to_canonical()) {
        None => String::new(),
        Some(IpAddr::V4(address)) => address.to_string(),
        Some(IpAddr::V6(address)) => {
            let [a, b, c, d, ..] = address.segments();
            format!("{}/64", Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0))
        }
    }
}

/// Lets in who may come, and leaves who it is for the handlers.
pub(crate) async fn identify(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let access = &app.config.access;
    if !access.is_open(request.uri().path()) {
        let peer = request.extensions().get::<Connection>().map(|connection| connection.peer.ip());
        match access.client(request.headers(), peer) {
            Ok(client) => {
                tracing::Span::current().record("client", client.name());
                request.extensions_mut().insert(client);
            }
            Err(problem) => return problem.into_response(),
        }
    }
    next.run(request).await
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client(
        access: &Access,
        headers: &[(&'static str, &'static str)],
        peer: &str,
    ) -> Result<String, Problem> {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.append(*name, axum::http::HeaderValue::from_static(value));
        }
        let peer = peer.parse().expect("an address");
        access.client(&map, Some(peer)).map(|client| client.name().to_owned())
    }

    #[test]
    fn without_keys_the_address_tells_clients_apart() {
        let (direct, proxied) = (Access::default(), Access { trust_forwarded: true, ..Access::default() });
        let forged = &[("x-forwarded-for", "9.9.9.9, 5.6.7.8")][..];
        for (access, headers, peer, expected) in [
            (&direct, &[][..], "1.2.3.4", "1.2.3.4"),
            (&direct, forged, "1.2.3.4", "1.2.3.4"),
            (&proxied, forged, "1.2.3.4", "5.6.7.8"),
            (
                &proxied,
                &[("x-forwarded-for", "5.6.7.8"), ("x-forwarded-for", "6.7.8.9")],
                "1.2.3.4",
                "6.7.8.9",
            ),
            (&proxied, &[], "1.2.3.4", "1.2.3.4"),
            (&proxied, &[("x-forwarded-for", "unknown")], "1.2.3.4", "1.2.3.4"),
            (&direct, &[], "2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
            (&direct, &[], "::ffff:1.2.3.4", "1.2.3.4"),
        ] {
            assert_eq!(client(access, headers, peer), Ok(expected.to_owned()), "{headers:?} {peer}");
        }
        assert_eq!(direct.owner(&Client::new("1.2.3.4")), None);
    }

    #[test]
    fn with_keys_the_key_does() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("keys");
        std::fs::write(&path, format!("alice {}", crate::admission::keys::hashed("a key of hers")))
            .expect("a file");
        let keys = Some(Arc::new(Keys::read(&path).expect("keys")));
        let access = Access { keys, ..Access::default() };
        for headers in [
            [("authorization", "Bearer a key of hers")],
            [("authorization", "bearer  a key of hers")],
            [("x-api-key", "a key of hers")],
        ] {
            assert_eq!(client(&access, &headers, "1.2.3.4"), Ok("alice".to_owned()), "{headers:?}");
        }
        for headers in [
            &[][..],
            &[("authorization", "Bearer nobody")],
            &[("authorization", "Bearer")],
            &[("authorization", "Basic a key of hers")],
            &[("x-api-key", "")],
        ] {
            let refused = client(&access, headers, "1.2.3.4");
            assert!(matches!(refused, Err(Problem::Unauthorized(_))), "{headers:?}: {refused:?}");
        }
        assert_eq!(access.owner(&Client::new("alice")), Some("alice".to_owned()));
    }

    #[test]
    fn what_is_open_is_chosen() {
        let closed =
            Access { open_health: false, open_metrics: false, open_docs: false, ..Access::default() };
        for path in [
            "/healthz",
            "/readyz",
            "/metrics",
            "/docs",
            "/",
            "/page/main.js",
            "/openapi.json",
            "/v2/health/ready",
            "/grpc.health.v1.Health/Check",
        ] {
            assert!(Access::default().is_open(path) && !closed.is_open(path), "{path}");
        }
        for path in [
            "/upsample",
            "/points",
            "/about",
            "/files/0",
            "/jobs",
            "/v2/models/densecloud/infer",
            "/healthz/",
            "/nowhere",
        ] {
            assert!(!Access::default().is_open(path), "{path}");
        }
    }
}
