//! The page that shows clouds: `GET /`, its parts, and what it asks of the server that no other program needs.
//!
//! Its sources are in `web/src/`, and are served as they are: nothing is built for them. `three.js` alone is made of a
//! package of another's, by `web/build.js`.

mod about;
mod files;

use axum::extract::Path;
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};

pub(crate) use about::{about, estimate};
pub(crate) use files::file;

use crate::problem::Problem;

/// What the page may load and run: its own parts and what this server answers.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
                      worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const INDEX: &str = include_str!("../../../../web/src/index.html");

/// A part of the page.
struct PagePart {
    name: &'static str,
    media_type: &'static str,
    text: &'static str,
}

/// Parts of a kind, by their names in `web/src/`.
macro_rules! parts {
    ($($kind:literal: $($name:literal)*;)*) => {
        &[$($(PagePart {
            name: $name,
            media_type: $kind,
            text: include_str!(concat!("../../../../web/src/", $name)),
        },)*)*]
    };
}

/// All of them.
static PARTS: &[PagePart] = parts! {
    "text/css; charset=utf-8": "style.css";
    "image/svg+xml": "icon.svg";
    "text/javascript; charset=utf-8": "box.js" "cloud.js" "comparison.js" "distance-worker.js" "distance.js" "dom.js"
        "drawn-cloud.js" "jobs.js" "keys.js" "legend.js" "link.js" "look.js" "main.js" "messages.js" "packed.js" "ruler.js" "server.js" "session.js"
        "shaders.js" "three.js" "tree.js" "view.js" "work.js";
};

/// What every part has beside its type.
const HEADERS: [(HeaderName, HeaderValue); 4] = [
    (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
    (header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY)),
    (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
];

/// `GET /`.
pub(crate) async fn index() -> Response {
    (HEADERS, [(header::CONTENT_TYPE, "text/html; charset=utf-8")], INDEX).into_response()
}

/// `GET /page/{part}`.
pub(crate) async fn part(Path(name): Path<String>) -> Result<Response, Problem> {
    let part = PARTS.iter().find(|part| part.name == name).ok_or(Problem::NotFound)?;
    Ok((HEADERS, [(header::CONTENT_TYPE, part.media_type)], part.text).into_response())
}

/// Whether a path is of the page, and holds nothing that is anybody's.
pub(crate) fn is_part(path: &str) -> bool {
    path == "/" || path.starts_with("/page/")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    #[test]
    fn all_that_the_page_is_made_of_is_served() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../web/src");
        let files =
            std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").file_name());
        let files = files.map(|name| name.into_string().expect("text"));
        let files: BTreeSet<_> =
            files.filter(|name| name != "index.html" && !name.ends_with(".d.ts")).collect();
        assert_eq!(files, PARTS.iter().map(|part| part.name.to_owned()).collect());
    }

    #[test]
    fn the_page_takes_nothing_from_elsewhere() {
        let own = PARTS.iter().filter(|part| part.name != "three.js").map(|part| (part.name, part.text));
        for (name, text) in own.chain([("index.html", INDEX)]) {
            let text = text.replace("http://www.w3.org/2000/svg", "");
            assert!(!text.contains("http://") && !text.contains("https://"), "{name}");
        }
    }

    #[test]
    fn the_page_is_small() {
        let mut all = GzEncoder::new(Vec::new(), Compression::new(3));
        all.write_all(INDEX.as_bytes()).expect("memory");
        PARTS.iter().for_each(|part| all.write_all(part.text.as_bytes()).expect("memory"));
        let bytes = all.finish().expect("memory").len();
        assert!(bytes < 250_000, "{bytes} bytes");
    }
}
