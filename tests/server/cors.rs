//! Pages of other sites: kept out, unless they are named.

use densecloud_server::Config;

use crate::support::{PLY, Reply, Scripted, Server, cloud, encode};

const SITE: &str = "https://viewer.example.org";

fn server(origins: &[&str]) -> Server {
    let cors = origins.iter().map(|origin| origin.parse().unwrap()).collect();
    Server::start(&Scripted::new(), Config { cors, ..Config::default() })
}

fn from_site(server: &Server, method: &str, path: &str, site: &str, more: &str, body: &[u8]) -> Reply {
    let mut client = server.connect();
    let head = format!(
        "{method} {path} HTTP/1.1\r\nhost: x\r\nconnection: close\r\norigin: {site}\r\ncontent-length: {}\r\n{more}\r\n",
        body.len()
    );
    client.send(&[head.as_bytes(), body].concat());
    client.reply()
}

fn preflight(server: &Server, path: &str, method: &str, headers: &str) -> Reply {
    let more =
        format!("access-control-request-method: {method}\r\naccess-control-request-headers: {headers}\r\n");
    from_site(server, "OPTIONS", path, SITE, &more, b"")
}

fn let_in(reply: &Reply) -> Option<&str> {
    reply.header("access-control-allow-origin")
}

#[test]
fn without_the_setting_no_other_site_is_let_in() {
    let server = server(&[]);
    for path in ["/readyz", "/docs", "/nowhere"] {
        let reply = from_site(&server, "GET", path, SITE, "", b"");
        assert!(!reply.headers.iter().any(|(name, _)| name.starts_with("access-control")), "{reply:?}");
    }
    let refused = preflight(&server, "/upsample?ratio=4", "POST", "content-type");
    assert_eq!((refused.status, let_in(&refused)), (405, None));
    // A form, or text, needs no preflight: a browser sends it, whatever becomes of the answer.
    let body = encode(&cloud(100), PLY);
    for (method, path) in [("POST", "/upsample?ratio=4"), ("POST", "/jobs?ratio=4"), ("DELETE", "/jobs/1")] {
        for (site, more) in [(SITE, ""), ("null", ""), ("http://x", "sec-fetch-site: cross-site\r\n")] {
            let refused = from_site(&server, method, path, site, more, &body);
            assert_eq!(
                (refused.status, refused.problem_name().as_str()),
                (403, "cross-site"),
                "{path} {site}"
            );
            assert_eq!(refused.problem()["setting"], "--cors-origin");
        }
    }
    assert_eq!(server.metric("densecloud_admitted_total"), 0.0);
    // The server's own pages, also behind a proxy that calls it otherwise.
    for (site, more) in [("http://x", ""), (SITE, "sec-fetch-site: same-origin\r\n")] {
        let reply = from_site(&server, "POST", "/upsample?ratio=4", site, more, &body);
        assert_eq!(reply.status, 200, "{site}");
    }
}

#[test]
fn a_named_site_may_use_everything_and_read_what_comes() {
    let server = server(&["http://localhost:3000", SITE]);
    let body = encode(&cloud(100), PLY);
    let reply = from_site(&server, "POST", "/upsample?ratio=4", SITE, "", &body);
    assert_eq!((reply.status, let_in(&reply)), (200, Some(SITE)));
    assert_eq!(reply.header("access-control-expose-headers"), Some("*"));
    assert_eq!(reply.header("access-control-allow-credentials"), None, "a star holds only without them");
    let problem = from_site(&server, "POST", "/upsample?ratio=99", SITE, "", &body);
    assert_eq!((problem.problem_name().as_str(), let_in(&problem)), ("invalid-parameter", Some(SITE)));
    for path in ["/docs", "/openapi.json", "/nowhere", "/v2"] {
        assert_eq!(let_in(&from_site(&server, "GET", path, SITE, "", b"")), Some(SITE), "{path}");
    }
    let other = from_site(&server, "GET", "/readyz", "https://other.example.org", "", b"");
    assert_eq!((other.status, let_in(&other)), (200, None), "the browser keeps it from the page");
    // One header of several: answers vary by their coding, too.
    assert!(other.headers.iter().any(|(n, v)| n == "vary" && v.contains("origin")), "{other:?}");
}

#[test]
fn a_browser_that_asks_first_hears_what_is_allowed() {
    let server = server(&[SITE]);
    for (path, method) in
        [("/upsample?ratio=4", "POST"), ("/jobs/abc", "DELETE"), ("/jobs/abc/result", "GET")]
    {
        let reply = preflight(&server, path, method, "authorization,content-encoding,idempotency-key");
        assert_eq!((reply.status, let_in(&reply)), (200, Some(SITE)), "{path}");
        let allowed = |what: &str| reply.header(&format!("access-control-allow-{what}")).unwrap().to_owned();
        assert!(allowed("methods").contains(method), "{path}: {}", allowed("methods"));
        assert_eq!(allowed("headers"), "authorization,content-encoding,idempotency-key");
        assert!(reply.header("access-control-max-age").is_some() && reply.header("x-request-id").is_some());
    }
}

#[test]
fn a_star_lets_every_site_in_and_stands_alone() {
    let server = server(&["*"]);
    assert_eq!(let_in(&from_site(&server, "GET", "/readyz", SITE, "", b"")), Some("*"));
    let both = Config { cors: vec!["*".parse().unwrap(), SITE.parse().unwrap()], ..Config::default() };
    assert!(both.validate().expect_err("one is idle").to_string().contains("--cors-origin"));
}
