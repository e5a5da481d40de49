//! A server elsewhere, as the commands that talk to one see it.

use std::fmt::Display;
use std::fs::File;
use std::io::{self, ErrorKind, IsTerminal, Read, Seek};
use std::path::Path;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::Value;
use ureq::http::{Method, Request, Response, StatusCode, Uri, header};
use ureq::{Agent, Body, SendBody};

use super::connection::{self, Closed};
use super::{CliError, files};
use densecloud_formats::Format;

/// A server, and what opens it.
pub(super) struct Server {
    base: String,
    key: Option<String>,
    agent: Agent,
    /// Of the last request.
    closed: Closed,
    /// Host and port of the proxy between, if there is one.
    proxy: Option<String>,
}

/// What a path answers where all is well. What answers anything else is no densecloud server, but something
/// on the way to one, such as a page to log in at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Expected {
    /// A result.
    Cloud,
    Json,
    Events,
    /// That something was deleted, or is about to be.
    Deleted,
}

impl Expected {
    fn is(self, answer: &Response<Body>) -> bool {
        let (status, kind) = (answer.status().as_u16(), media_type(answer));
        match self {
            Self::Cloud => {
                let points = answer.headers().get("densecloud-points-out");
                status == 200 && points.is_some() && Format::from_media_type(kind).is_some()
            }
            Self::Json => matches!(status, 200 | 202) && kind == JSON,
            Self::Events => status == 200 && kind == "text/event-stream",
            Self::Deleted => status == 204 || status == 200 && kind == JSON,
        }
    }
}

const JSON: &str = "application/json";

/// An answer's media type, without its parameters.
pub(super) fn media_type(answer: &Response<Body>) -> &str {
    let kind = answer.headers().get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
    kind.and_then(|kind| kind.split(';').next()).unwrap_or_default().trim()
}

/// How often a server that is full is asked, and how long a wait that it names is waited for.
const TRIES: u32 = 5;
const LONGEST: Duration = Duration::from_secs(60);
/// For a connection. What comes after may take as long as it takes; the server has deadlines.
const CONNECT: Duration = Duration::from_secs(30);
/// Before a server is asked again that closed the connection and said nothing: as long as it asks for itself where it
/// does not know.
const UNTOLD: Duration = Duration::from_secs(5);

impl Server {
    /// The server at `url`; `key` goes along as `Authorization: Bearer`.
    ///
    /// # Errors
    /// [`CliError::Usage`] for what is no address that this program speaks to.
    pub(super) fn new(url: &str, key: Option<&str>) -> Result<Self, CliError> {
        let usage = |why: &str| Err(CliError::Usage(format!("--server {url}: {why}")));
        match url.split_once("://") {
            Some(("http", host)) if !host.is_empty() => {}
            Some(("https", _)) => {
                return usage("this program has no TLS; give http:// and the address of a tunnel or a proxy");
            }
            _ => return usage("not an address such as http://127.0.0.1:8080"),
        }
        if key.is_some_and(|key| key.is_empty() || !key.bytes().all(|b| b.is_ascii_graphic())) {
            return Err(CliError::Usage("--key: not visible ASCII characters".into()));
        }
        let base = url.trim_end_matches('/').to_owned();
        let Some(address) = base.parse::<Uri>().ok().filter(|address| address.host().is_some()) else {
            return usage("not an address such as http://127.0.0.1:8080");
        };
        let proxy = connection::proxy(&address);
        let shown = proxy.as_ref().map(|proxy| format!("{}:{}", proxy.host(), proxy.port()));
        // A refusal has a body that says why. A redirection is told, not followed: what is at its end is no answer
        // to what was asked.
        let agent = Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .proxy(proxy)
            .timeout_connect(Some(CONNECT));
        let closed = Closed::default();
        Ok(Self {
            base,
            key: key.map(str::to_owned),
            agent: connection::agent(agent.build(), closed.clone()),
            closed,
            proxy: shown,
        })
    }

    /// Asks for a path.
    pub(super) fn get(&self, path: &str, expected: Expected) -> Result<Response<Body>, CliError> {
        self.judged(self.ask(Method::GET, path)?, expected)
    }

    /// The same; nothing where the server is not there, or cannot answer, for the moment.
    pub(super) fn get_if_there(
        &self,
        path: &str,
        expected: Expected,
    ) -> Result<Option<Response<Body>>, CliError> {
        let Ok(answer) = self.ask(Method::GET, path) else { return Ok(None) };
        match answer.status().as_u16() {
            429 | 500 | 502..=504 => Ok(None),
            _ => self.judged(answer, expected).map(Some),
        }
    }

    /// Deletes what a path names.
    pub(super) fn delete(&self, path: &str) -> Result<(), CliError> {
        self.judged(self.ask(Method::DELETE, path)?, Expected::Deleted).map(|_| ())
    }

    fn ask(&self, method: Method, path: &str) -> Result<Response<Body>, CliError> {
        let mut request = Request::builder().method(method).uri(format!("{}{path}", self.base));
        if let Some((name, key)) = self.authorization() {
            request = request.header(name, key);
        }
        let request = request.body(()).map_err(|error| self.failed(&error))?;
        self.agent.run(request).map_err(|error| self.unreached(&error))
    }

    /// Sends a file (`-`: standard input), and again where the server is full for the moment.
    pub(super) fn upload(
        &self,
        path: &str,
        query: &[(&'static str, String)],
        headers: &[(&'static str, String)],
        input: &Path,
        expected: Expected,
        show: &Show,
    ) -> Result<Response<Body>, CliError> {
        let unread = |error: io::Error| CliError::file(input, error);
        let (mut source, length): (Source, Option<u64>) = if files::is_stream(input) {
            (Source::Stream(io::stdin()), None)
        } else {
            let file = File::open(input).map_err(unread)?;
            let metadata = file.metadata().map_err(unread)?;
            (Source::File(file), metadata.is_file().then_some(metadata.len()))
        };
        for attempt in 1.. {
            let mut request = self.agent.post(format!("{}{path}", self.base));
            for (name, value) in query {
                request = request.query(name, value);
            }
            for (name, value) in headers {
                request = request.header(*name, value);
            }
            if let Some((name, key)) = self.authorization() {
                request = request.header(name, key);
            }
            // A server that refuses the head alone is not sent the rest.
            request = request.header(header::EXPECT, "100-continue");
            if let Some(length) = length {
                request = request.header(header::CONTENT_LENGTH, length.to_string());
            }
            let bar = show.bar(length, UPLOAD);
            // A pipe may go on for long; a file is over soon, and must be sent in the length that was told.
            let stop = length.is_none().then_some(&self.closed);
            let mut reader = Shown { inner: &mut source, bar: &bar, stop };
            let sent = request.send(SendBody::from_reader(&mut reader));
            bar.finish_and_clear();
            let (outcome, wait) = match sent {
                Ok(answer) => {
                    let wait = Self::wait(&answer);
                    (self.judged(answer, expected), wait)
                }
                Err(_) if self.closed.get() => {
                    let why = "the server ended the upload early, without an answer";
                    (Err(self.failed(&why)), Some(UNTOLD))
                }
                Err(error) => (Err(self.unreached(&error)), None),
            };
            let (Err(why), Some(wait)) = (&outcome, wait) else { return outcome };
            if attempt == TRIES || wait > LONGEST {
                return outcome;
            }
            // What came from a pipe cannot be had again.
            let Source::File(file) = &mut source else { return outcome };
            if file.rewind().is_err() {
                return outcome;
            }
            show.note(&format!("{why}; trying again in {} s ({attempt} of {})", wait.as_secs(), TRIES - 1));
            std::thread::sleep(wait);
        }
        Err(self.failed(&"gave up"))
    }

    /// How long a server that is full for the moment asks to wait.
    fn wait(answer: &Response<Body>) -> Option<Duration> {
        if !matches!(answer.status(), StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE) {
            return None;
        }
        let seconds = answer.headers().get(header::RETRY_AFTER)?.to_str().ok()?.trim().parse().ok()?;
        Some(Duration::from_secs(seconds))
    }

    fn authorization(&self) -> Option<(header::HeaderName, String)> {
        self.key.as_ref().map(|key| (header::AUTHORIZATION, format!("Bearer {key}")))
    }

    /// The answer, unless it is a problem, which has the exit code that it would have had here, or none of a
    /// densecloud server at all.
    fn judged(&self, mut answer: Response<Body>, expected: Expected) -> Result<Response<Body>, CliError> {
        if expected.is(&answer) {
            return Ok(answer);
        }
        if answer.status().is_redirection() {
            let place =
                answer.headers().get(header::LOCATION).map_or(&b"nowhere"[..], |place| place.as_bytes());
            return Err(self.failed(&format!(
                "{}: redirected to {}, which is not followed; if the server has moved there, give its address",
                answer.status(),
                String::from_utf8_lossy(place)
            )));
        }
        if answer.status().is_success() {
            let kind = Some(media_type(&answer)).filter(|kind| !kind.is_empty()).unwrap_or("nothing");
            return Err(self.failed(&format!(
                "answered {} with {kind}, which is no answer of a densecloud server; is that its address?",
                answer.status()
            )));
        }
        let text = answer.body_mut().read_to_string().unwrap_or_default();
        let problem: Value = serde_json::from_str(&text).unwrap_or_default();
        let status = answer.status();
        let mut why = problem["detail"].as_str().map_or_else(|| status.to_string(), str::to_owned);
        if status == StatusCode::UNAUTHORIZED && self.key.is_none() {
            why += " (give a key with --key or DENSECLOUD_KEY)";
        }
        if let Some(id) = problem["request_id"].as_str().filter(|_| status.is_server_error()) {
            why += &format!(" (request {id})");
        }
        let kind = problem["type"].as_str().and_then(|kind| kind.rsplit(':').next()).unwrap_or_default();
        Err(match kind {
            "invalid-parameter" | "not-acceptable" => CliError::Usage(format!("{}: {why}", self.base)),
            _ => self.failed(&why),
        })
    }

    /// An error of the connection, which names the proxy, too.
    fn unreached(&self, why: &ureq::Error) -> CliError {
        match &self.proxy {
            Some(proxy) => self.failed(&format!(
                "{why}, by way of the proxy {proxy} of the environment; NO_PROXY excepts servers from it"
            )),
            None => self.failed(why),
        }
    }

    /// An error that names the server.
    pub(super) fn failed(&self, why: &dyn Display) -> CliError {
        CliError::Failed(format!("{}: {why}", self.base))
    }

    /// An answer's JSON.
    pub(super) fn json(&self, answer: Response<Body>) -> Result<Value, CliError> {
        let mut answer = answer;
        let text = answer.body_mut().read_to_string().map_err(|error| self.failed(&error))?;
        serde_json::from_str(&text).map_err(|error| self.failed(&error))
    }

    /// Writes an answer's body to a file as it comes, all of it or none.
    pub(super) fn save(&self, answer: Response<Body>, output: &Path, show: &Show) -> Result<(), CliError> {
        let length = answer.headers().get(header::CONTENT_LENGTH);
        let length: Option<u64> = length.and_then(|length| length.to_str().ok()?.parse().ok());
        let bar = show.bar(length, "download");
        let mut body = answer.into_body().into_reader();
        let mut body = Shown { inner: &mut body, bar: &bar, stop: None };
        let saved = files::write(output, |sink| {
            // Not `io::copy`, which does not tell whether it was the server or the disk that failed.
            let (mut buffer, mut copied) = (vec![0; 1 << 16], 0);
            loop {
                let count = match body.read(&mut buffer) {
                    Ok(0) => break,
                    Ok(count) => count,
                    Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                    Err(error) => return Err(format!("{}: the answer broke off: {error}", self.base).into()),
                };
                sink.write_all(&buffer[..count])?;
                copied += count as u64;
            }
            match length {
                Some(length) if length != copied => {
                    Err(format!("{}: {copied} of {length} bytes came", self.base).into())
                }
                _ => Ok(()),
            }
        });
        bar.finish_and_clear();
        saved
    }
}

enum Source {
    Stream(io::Stdin),
    File(File),
}

impl Read for Source {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Stream(stream) => stream.read(buffer),
            Self::File(file) => file.read(buffer),
        }
    }
}

/// What is told on standard error while bytes travel.
pub(super) struct Show {
    pub(super) quiet: bool,
}

impl Show {
    pub(super) fn note(&self, text: &str) {
        if !self.quiet {
            super::note(text);
        }
    }

    fn bar(&self, length: Option<u64>, what: &'static str) -> ProgressBar {
        if self.quiet || !io::stderr().is_terminal() {
            return ProgressBar::hidden();
        }
        let bar = ProgressBar::with_draw_target(length, ProgressDrawTarget::stderr());
        let template = match length {
            Some(_) => "{msg:28} [{bar:30}] {percent:>3} %  {bytes} of {total_bytes}",
            None => "{msg:28} {spinner} {bytes}",
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what);
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    }
}

const UPLOAD: &str = "upload";

/// Counts what is read on a bar.
struct Shown<'a, R> {
    inner: &'a mut R,
    bar: &'a ProgressBar,
    /// Ends it early, where nobody takes the rest.
    stop: Option<&'a Closed>,
}

impl<R: Read> Read for Shown<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.stop.is_some_and(Closed::get) {
            return Ok(0);
        }
        let count = self.inner.read(buffer)?;
        self.bar.inc(count as u64);
        let sent = count == 0 || self.bar.length() == Some(self.bar.position());
        if sent && self.bar.message() == UPLOAD {
            self.bar.set_message("waiting for the server");
        }
        Ok(count)
    }
}
