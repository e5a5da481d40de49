//! Whose work it is.

use std::fmt;
use std::sync::Arc;
use std::time::Instant;

/// Who a request comes from, by a name that the edge chooses: of a key, or an address. Work is shared
/// fairly among clients; the engine makes nothing else of the name. Cheap to clone.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Client(Arc<str>);

impl Client {
    /// The client of this name.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self(name.into())
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0
    }
}

impl Default for Client {
    /// The only one there is, at a command line.
    fn default() -> Self {
        Self::new("")
    }
}

impl fmt::Display for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Whose work it is, and until when it is of use.
#[derive(Debug, Clone, Default)]
pub struct Caller {
    /// Whose share it takes.
    pub client: Client,
    /// A moment of the engine's [`Clock`](crate::Clock): work that is not done by then is stopped, and none is begun after
    /// it; none is no limit.
    pub deadline: Option<Instant>,
}
