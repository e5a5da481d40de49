//! A server elsewhere, as the commands that talk to one see it.

use std::fmt::Display;
use std::fs::File;
use std::io::{self, IsTerminal, Read, Seek, Write};
use std::path::Path;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::Value;
use ureq::http::{Response, StatusCode, header};
use ureq::{Agent, Body, SendBody};

use super::{CliError, files};

/// A server, and what opens it.
pub(super) struct Server {
    base: String,
    key: Option<String>,
    agent: Agent,
}

/// How often a server that is full is asked, and how long a wait that it names is waited for.
const TRIES: u32 = 5;
const LONGEST: Duration = Duration::from_secs(60);
/// For a connection. What comes after may take as long as it takes; the server has deadlines.
const CONNECT: Duration = Duration::from_secs(30);

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
        // A refusal has a body that says why.
        let agent = Agent::config_builder().http_status_as_error(false).timeout_connect(Some(CONNECT));
        Ok(Self {
            base: url.trim_end_matches('/').to_owned(),
            key: key.map(str::to_owned),
            agent: agent.build().new_agent(),
        })
    }

    /// Asks for a path.
    pub(super) fn get(&self, path: &str) -> Result<Response<Body>, CliError> {
        let mut request = self.agent.get(format!("{}{path}", self.base));
        if let Some((name, key)) = self.authorization() {
            request = request.header(name, key);
        }
        self.checked(request.call())
    }

    /// Deletes what a path names.
    pub(super) fn delete(&self, path: &str) -> Result<Response<Body>, CliError> {
        let mut request = self.agent.delete(format!("{}{path}", self.base));
        if let Some((name, key)) = self.authorization() {
            request = request.header(name, key);
        }
        self.checked(request.call())
    }

    /// Sends a file (`-`: standard input), and again where the server is full for the moment.
    pub(super) fn upload(
        &self,
        path: &str,
        query: &[(&'static str, String)],
        headers: &[(&'static str, String)],
        input: &Path,
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
            let mut reader = Shown { inner: &mut source, bar: &bar };
            let answer = request.send(SendBody::from_reader(&mut reader)).map_err(|e| self.failed(&e));
            bar.finish_and_clear();
            let answer = answer?;
            let wait = match self.wait(&answer) {
                Some(wait) if attempt < TRIES && wait <= LONGEST => wait,
                _ => return self.judged(answer),
            };
            // What came from a pipe cannot be had again.
            let Source::File(file) = &mut source else { return self.judged(answer) };
            if file.rewind().is_err() {
                return self.judged(answer);
            }
            let why = self.judged(answer).err().map_or_else(String::new, |error| error.to_string());
            show.note(&format!("{why}; trying again in {} s ({attempt} of {})", wait.as_secs(), TRIES - 1));
            std::thread::sleep(wait);
        }
        Err(self.failed(&"gave up"))
    }

    /// How long a server that is full for the moment asks to wait.
    fn wait(&self, answer: &Response<Body>) -> Option<Duration> {
        if !matches!(answer.status(), StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE) {
            return None;
        }
        let seconds = answer.headers().get(header::RETRY_AFTER)?.to_str().ok()?.trim().parse().ok()?;
        Some(Duration::from_secs(seconds))
    }

    fn authorization(&self) -> Option<(header::HeaderName, String)> {
        self.key.as_ref().map(|key| (header::AUTHORIZATION, format!("Bearer {key}")))
    }

    fn checked(&self, called: Result<Response<Body>, ureq::Error>) -> Result<Response<Body>, CliError> {
        self.judged(called.map_err(|error| self.failed(&error))?)
    }

    /// The answer, unless it is a problem, which has the exit code that it would have had here.
    fn judged(&self, mut answer: Response<Body>) -> Result<Response<Body>, CliError> {
        if answer.status().is_success() {
            return Ok(answer);
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
        let saved = files::write(output, |sink| {
            let copied = io::copy(&mut Shown { inner: &mut body, bar: &bar }, sink);
            let copied = copied.map_err(|error| format!("{}: the answer broke off: {error}", self.base))?;
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
            // Where nobody can be told, the work goes on.
            let _ = writeln!(io::stderr(), "densecloud: {text}");
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
}

impl<R: Read> Read for Shown<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.bar.inc(count as u64);
        let sent = count == 0 || self.bar.length() == Some(self.bar.position());
        if sent && self.bar.message() == UPLOAD {
            self.bar.set_message("waiting for the server");
        }
        Ok(count)
    }
}
