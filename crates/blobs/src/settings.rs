//! What it takes to reach an object store.

use std::time::Duration;

/// What the environment says of object stores, and for how long one is tried. It may hold secrets, so it cannot be
/// printed.
#[derive(Clone)]
pub struct Settings {
    variables: Vec<(String, String)>,
    pub(crate) patience: Patience,
}

/// How long a store may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patience {
    /// For one request, its bytes included: up to 8 MiB, and 64 MiB beyond the first 42 GB of a blob.
    pub request: Duration,
    /// For one step, with all that is tried again: what takes longer ends in [`std::io::ErrorKind::TimedOut`]. A step
    /// is a piece that is read or written, a page of a list, or whatever else needs one answer.
    pub step: Duration,
}

impl Default for Patience {
    /// A minute for a request, three for a step.
    fn default() -> Self {
        Self { request: Duration::from_secs(60), step: Duration::from_secs(180) }
    }
}

impl Settings {
    /// Those of the program: `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_SESSION_TOKEN`, `AWS_REGION`,
    /// `AWS_ENDPOINT_URL`, `AWS_ALLOW_HTTP`, or `AWS_WEB_IDENTITY_TOKEN_FILE` with `AWS_ROLE_ARN`, and all else of
    /// `AWS_`, `GOOGLE_` and `AZURE_` that the crate `object_store` knows. A file of profiles is not read.
    #[must_use]
    pub fn from_env() -> Self {
        let text = |(name, value): (std::ffi::OsString, std::ffi::OsString)| {
            Some((name.into_string().ok()?, value.into_string().ok()?))
        };
        Self::new(std::env::vars_os().filter_map(text), Patience::default())
    }

    /// These variables instead of the program's.
    #[must_use]
    pub fn new(variables: impl IntoIterator<Item = (String, String)>, patience: Patience) -> Self {
        Self { variables: variables.into_iter().collect(), patience }
    }

    /// The variables whose names begin with `prefix`: names in small letters, and values.
    pub(crate) fn of(&self, prefix: &str) -> impl Iterator<Item = (String, &str)> {
        let ours = self.variables.iter().filter(move |(name, _)| name.starts_with(prefix));
        ours.map(|(name, value)| (name.to_ascii_lowercase(), value.as_str()))
    }
}
