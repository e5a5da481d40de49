//! Jobs that outlive the program: kept on disk, run one after another, their results kept for a while.
//!
//! | file | holds |
//! |---|---|
//! | `record` | what is known of one job |
//! | `records` | the trait of whatever keeps records, with leases on the jobs that run |
//! | `sqlite` | the first implementation of it, for one program at a time |
//! | `postgres` | the second, for many programs on many machines |
//! | `store` | records, and blobs beside them: which is written first, and which is removed first |
//! | `counted` | how many bytes go to and from the blobs |
//! | `shared` | a store that programs on many machines share |
//! | `work` | what jobs are about, and one job while it runs |
//! | `worker` | the threads that run what is queued |
//! | `clock`, `settings`, `error` | what they say |
//!
//! What a job asks for is text to this crate; [`Work`] understands it. It knows nothing of HTTP, and outside `sqlite`
//! and `postgres` nothing of databases; clouds and results lie wherever [`Blobs`] keeps them.

mod clock;
mod columns;
mod counted;
mod error;
mod postgres;
mod record;
mod records;
mod settings;
mod shared;
mod sqlite;
mod store;
#[cfg(test)]
mod tests;
mod work;
mod worker;

pub use clock::{Clock, SystemClock};
pub use densecloud_blobs::{BlobReader, BlobWriter, Blobs, Folder};
pub use error::{StoreError, Trouble};
pub use postgres::{Address, AddressError, Limits, Password, Postgres};
pub use record::{CloudFile, Draft, Failure, NewJob, Record, ResultFile, State, Tiles, Time};
pub use records::{
    Admitted, Bounds, Change, Forgotten, Lapsed, Lease, Load, Promised, Records, Step, Submitted, Waiting,
};
pub use settings::{Keeping, Settings};
pub use sqlite::Sqlite;
pub use store::{Found, Input, Place, ResultWriter, Store};
pub use work::{Begun, How, Parts, Stopped, Task, Work};
pub use worker::{AtWork, Deleted, Jobs};
