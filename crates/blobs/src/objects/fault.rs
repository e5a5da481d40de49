//! What a store's errors say to people: no credentials, no parameters of addresses, no bodies of answers.

use std::error::Error;
use std::io::{self, ErrorKind};

use object_store::client::{HttpError, HttpErrorKind};

/// What stands before a status in an error.
const STATUS: &str = "status code: ";

/// An error of a store about what lies at this address.
pub(super) fn told(address: &str, error: &object_store::Error) -> io::Error {
    let text = public(&error.to_string());
    let deepest = public(&deepest(error).to_string());
    let told = if text.contains(&deepest) { text } else { format!("{text}: {deepest}") };
    io::Error::new(kind(error), format!("{address}: {told}"))
}

/// No answer in time.
pub(super) fn late(address: &str) -> io::Error {
    io::Error::new(ErrorKind::TimedOut, format!("{address}: the store did not answer in time"))
}

fn kind(error: &object_store::Error) -> ErrorKind {
    use object_store::Error::{NotFound, PermissionDenied, Unauthenticated};
    match error {
        NotFound { .. } => ErrorKind::NotFound,
        PermissionDenied { .. } | Unauthenticated { .. } => ErrorKind::PermissionDenied,
        _ => match chain(error).find_map(|error| error.downcast_ref::<HttpError>()).map(HttpError::kind) {
            Some(HttpErrorKind::Timeout) => ErrorKind::TimedOut,
            Some(HttpErrorKind::Connect) => ErrorKind::NotConnected,
            Some(HttpErrorKind::Interrupted) => ErrorKind::ConnectionAborted,
            Some(_) => ErrorKind::Other,
            None => kind_of_status(&error.to_string()),
        },
    }
}

/// Of lists the status is in the text alone.
fn kind_of_status(text: &str) -> ErrorKind {
    match text.split_once(STATUS).and_then(|(_, answer)| answer.get(..3)) {
        Some("401" | "403") => ErrorKind::PermissionDenied,
        Some("404") => ErrorKind::NotFound,
        Some("429" | "500" | "502" | "503" | "504") => ErrorKind::ResourceBusy,
        _ => ErrorKind::Other,
    }
}

fn chain<'a>(error: &'a (dyn Error + 'static)) -> impl Iterator<Item = &'a (dyn Error + 'static)> {
    std::iter::successors(Some(error), |error| (*error).source())
}

fn deepest<'a>(error: &'a (dyn Error + 'static)) -> &'a (dyn Error + 'static) {
    chain(error).last().unwrap_or(error)
}

/// A text without what may be secret.
pub(super) fn public(text: &str) -> String {
    without_body(text).split_inclusive(' ').map(without_secrets).collect()
}

/// Of an answer, its status and the code of its fault.
fn without_body(text: &str) -> String {
    let before = [STATUS, "error response: "];
    let Some((start, before)) = before.iter().find_map(|&b| Some((text.find(b)? + b.len(), b))) else {
        return text.to_owned();
    };
    let (head, answer) = text.split_at(start);
    let status = if before == STATUS { answer.split(": ").next().unwrap_or_default() } else { "" };
    let code =
        answer.split_once("<Code>").and_then(|(_, rest)| rest.split_once("</Code>")).map(|(code, _)| code);
    let is_word = |code: &&str| code.len() < 60 && code.bytes().all(|b| b.is_ascii_alphanumeric());
    format!("{head}{status}{}", code.filter(is_word).map_or(String::new(), |code| format!(" ({code})")))
}

/// Of a word that is an address, no user and no parameters.
fn without_secrets(word: &str) -> String {
    let Some((scheme, rest)) = word.split_once("://") else { return word.to_owned() };
    let end = rest.find(['?', '#', ' ', '"', ')']).unwrap_or(rest.len());
    let (address, after) = rest.split_at(end);
    let host = address.find('/').unwrap_or(address.len());
    let user = address[..host].rfind('@').map_or(0, |at| at + 1);
    let after = after.trim_start_matches(|c: char| !c.is_whitespace() && !matches!(c, '"' | ')'));
    format!("{scheme}://{}{after}", &address[user..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_secret_is_told() {
        let secret = "Generic S3 error: Error performing PUT http://me:SECRET@host:1/b/k?sig=SECRET&x=1 in 3s, after 2 retries \
                      - Server returned non-2xx status code: 403 Forbidden: <Error><Code>AccessDenied</Code>SECRET: x</Error>";
        let told = "Generic S3 error: Error performing PUT http://host:1/b/k in 3s, after 2 retries \
                    - Server returned non-2xx status code: 403 Forbidden (AccessDenied)";
        assert_eq!(public(secret), told);
        assert_eq!(public("Server returned error response: SECRET"), "Server returned error response: ");
        assert_eq!(public("status code: 500 Fault: SECRET at http://x"), "status code: 500 Fault");
        assert_eq!(public("see (https://a@b/c#SECRET) there"), "see (https://b/c) there");
        assert_eq!(public("connection refused"), "connection refused");
    }
}
