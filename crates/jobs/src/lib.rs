//! Jobs that outlive the program: kept on disk, run one after another, their results kept for a while.
//!
//! | file | holds |
//! |---|---|
//! | `record` | what is known of one job |
//! | `store` | the database of records, and the files beside it |
//! | `files` | files that are there whole or not at all |
//! | `worker` | the threads that run what is queued, and what is known of running jobs alone |
//!
//! What a job asks for is text to this module; [`Work`] understands it. It knows nothing of HTTP.

mod database;
mod files;
mod record;
mod store;
#[cfg(test)]
mod tests;
mod worker;

pub use files::Input;
pub use record::{Draft, Failure, NewJob, Record, ResultFile, State, Time};
pub use store::{Admitted, Bounds, Found, Load, Store, StoreError, Submitted};
pub use worker::{Deleted, Jobs, Settings, Stopped, Task, Work, now};
