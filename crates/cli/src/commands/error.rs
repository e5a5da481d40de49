//! What a command can die of, and the exit code of each.

/// An error as the person at the command line sees it.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CliError {
    /// The arguments contradict each other or name something impossible.
    #[error("{0}")]
    Usage(String),
    /// The work failed.
    #[error("{0}")]
    Failed(String),
    /// The work failed while a file was being used.
    #[error("{path}: {why}")]
    File {
        /// The file, or `-` for a standard stream.
        path: String,
        /// What went wrong with it.
        why: String,
    },
}

impl CliError {
    /// `EX_USAGE` of sysexits.h.
    pub(crate) const USAGE: u8 = 64;

    /// An error about one file.
    pub(crate) fn file(path: impl AsRef<std::path::Path>, why: impl std::fmt::Display) -> Self {
        let (path, why) = (path.as_ref().display().to_string(), why.to_string());
        // A store's error names the address by itself.
        let why = why.strip_prefix(&format!("{path}: ")).unwrap_or(&why).to_owned();
        Self::File { path, why }
    }

    /// The program's exit code.
    #[must_use]
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => Self::USAGE,
            Self::Failed(_) | Self::File { .. } => 1,
        }
    }
}
