//! `densecloud healthcheck`: whether a server is ready, for containers that have no curl.

use std::ffi::OsString;
use std::time::Duration;

use clap::Args;
use serde_json::Value;
use ureq::Agent;
use ureq::http::Uri;

use super::serve_args::{ServeArgs, seconds};
use super::settings::Refused;
use super::{CliError, Command, connection, files};

/// Ask a server whether it is ready: exit code 0 if it is, 1 if it is not or does not answer.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  densecloud healthcheck
  densecloud healthcheck http://clouds.example.org:8080
  densecloud healthcheck http://127.0.0.1:8080/healthz   # alive is enough

In a Dockerfile:
  HEALTHCHECK CMD [\"/opt/densecloud/densecloud\", \"healthcheck\"]")]
pub(super) struct HealthcheckArgs {
    /// Where the server is; a path that ends in healthz or readyz is asked as it is [default: this machine, at the
    /// port that the environment and its file set for `serve`]
    url: Option<String>,

    /// How long an answer is waited for
    #[arg(long, value_name = "SECONDS", value_parser = seconds, default_value = "5")]
    timeout: Duration,

    /// The key that opens the server, where it asks for one even of probes
    #[arg(long, env = "DENSECLOUD_KEY", hide_env_values = true, value_name = "KEY")]
    key: Option<String>,
}

pub(super) fn run(args: &HealthcheckArgs) -> Result<(), CliError> {
    let url = probe(&match &args.url {
        Some(url) => url.clone(),
        None => own()?,
    });
    let address: Option<Uri> = url.parse().ok().filter(|address: &Uri| address.scheme_str() == Some("http"));
    let Some(address) = address else {
        return Err(CliError::Usage(format!("{url}: not an address such as http://127.0.0.1:8080")));
    };
    let agent: Agent = Agent::config_builder()
        .http_status_as_error(false)
        .max_redirects(0)
        .max_redirects_will_error(false)
        .proxy(connection::proxy(&address))
        .timeout_global(Some(args.timeout))
        .build()
        .into();
    let mut request = agent.get(&url);
    if let Some(key) = &args.key {
        request = request.header("authorization", format!("Bearer {key}"));
    }
    let failed = |why: &dyn std::fmt::Display| CliError::Failed(format!("{url}: {why}"));
    let mut answer = request.call().map_err(|why| failed(&why))?;
    let text = answer.body_mut().read_to_string().unwrap_or_default();
    if answer.status() == 200 {
        return files::print(&format!("{url}: {}\n", text.trim()));
    }
    let problem: Value = serde_json::from_str(&text).unwrap_or_default();
    let why = problem["detail"].as_str().unwrap_or_default();
    Err(failed(&format!("{}: {why}", answer.status()).trim_end_matches(": ")))
}

/// What is asked of a server at this address.
fn probe(url: &str) -> String {
    let url = url.trim_end_matches('/');
    match url.rsplit('/').next() {
        Some("healthz" | "readyz") => url.to_owned(),
        _ => format!("{url}/readyz"),
    }
}

/// The server that runs here by the settings in the environment, and in the file that it names.
fn own() -> Result<String, CliError> {
    let typed = ["densecloud", "serve"].map(OsString::from);
    match super::parse(&typed) {
        Ok((arguments, _)) => match arguments.command {
            Command::Serve(serve) => Ok(at_home(&serve)),
            // Cannot be: it was typed.
            _ => Err(CliError::Failed("no settings".to_owned())),
        },
        Err(Refused::Arguments(error, _)) => Err(CliError::Failed(error.to_string())),
        // Not this command's own arguments: the exit code is that of a server that does not answer.
        Err(Refused::File(error)) => Err(CliError::Failed(error.to_string())),
    }
}

/// How a server with these settings is reached from its own machine.
fn at_home(serve: &ServeArgs) -> String {
    let host = match serve.host.as_str() {
        "0.0.0.0" => "127.0.0.1".to_owned(),
        "::" => "[::1]".to_owned(),
        address if address.contains(':') => format!("[{address}]"),
        name => name.to_owned(),
    };
    format!("http://{host}:{}", serve.port)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        serve: ServeArgs,
    }

    #[test]
    fn an_address_is_asked_whether_it_is_ready() {
        for (url, asked) in [
            ("http://x:8080", "http://x:8080/readyz"),
            ("http://x/clouds/", "http://x/clouds/readyz"),
            ("http://x/healthz", "http://x/healthz"),
            ("http://x/clouds/readyz", "http://x/clouds/readyz"),
        ] {
            assert_eq!(probe(url), asked);
        }
    }

    #[test]
    fn a_server_that_listens_everywhere_is_at_home_too() {
        for (host, url) in [
            ("0.0.0.0", "http://127.0.0.1:9000"),
            ("::", "http://[::1]:9000"),
            ("::1", "http://[::1]:9000"),
            ("10.0.0.1", "http://10.0.0.1:9000"),
            ("clouds", "http://clouds:9000"),
        ] {
            let line = Line::try_parse_from(["serve", "--port", "9000", "--host", host]).expect("arguments");
            assert_eq!(at_home(&line.serve), url);
        }
    }
}
