//! Options of who may ask, and for what.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use densecloud_server::{Access, Keys};

use super::super::CliError;

/// Who may ask.
#[derive(Debug, Args)]
pub(super) struct AccessArgs {
    /// File of keys, one of which each request must show; a line is a name, a space and a key, or
    /// sha256: and the key's SHA-256
    #[arg(long, env = "DENSECLOUD_KEYS", value_name = "FILE")]
    keys: Option<PathBuf>,

    /// What needs no key, with commas between
    #[arg(
        long,
        env = "DENSECLOUD_OPEN",
        value_name = "WHAT,...",
        value_delimiter = ',',
        default_value = "health,metrics,docs"
    )]
    open: Vec<Open>,

    /// Take the last hop of X-Forwarded-For as the client's address, and X-Forwarded-Prefix as --base-path: only
    /// behind a proxy that sets them
    #[arg(long, env = "DENSECLOUD_TRUST_FORWARDED")]
    trust_forwarded: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Open {
    /// /healthz, /readyz, and the like of the Open Inference Protocol
    Health,
    /// /metrics
    Metrics,
    /// The page at /, /openapi.json and /docs
    Docs,
    /// Nothing
    None,
}

impl AccessArgs {
    /// But for the keys, which are in a file.
    pub(super) fn access(&self) -> Access {
        let open = |what| self.open.contains(&what);
        Access {
            keys: None,
            open_health: open(Open::Health),
            open_metrics: open(Open::Metrics),
            open_docs: open(Open::Docs),
            trust_forwarded: self.trust_forwarded,
        }
    }

    pub(super) fn check(&self) -> Result<(), CliError> {
        if self.open.contains(&Open::None) && self.open.iter().any(|what| *what != Open::None) {
            return Err(CliError::Usage("--open: none goes with nothing else; leave one of them out".into()));
        }
        Ok(())
    }

    pub(super) fn keys(&self) -> Result<Option<Arc<Keys>>, CliError> {
        let Some(path) = &self.keys else { return Ok(None) };
        let keys =
            Keys::read(path).map_err(|e| CliError::Usage(format!("--keys {}: {e}", path.display())))?;
        Ok(Some(Arc::new(keys)))
    }
}
