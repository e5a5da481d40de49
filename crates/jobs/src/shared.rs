//! A store that programs on many machines share.

use std::io;
use std::sync::Arc;

use crate::clock::Clock;
use crate::error::{StoreError, Trouble};
use crate::postgres::{Address, Limits, Password, Postgres};
use crate::records::Bounds;
use crate::store::Store;

/// Opens a database and a store of blobs for programs of a kind, under the database's clock. Without a password it is in
/// the environment: see [`Password::from_environment`].
pub(crate) fn open(
    database: &str,
    password: Option<&Password>,
    store: &str,
    kind: &str,
    bounds: Bounds,
) -> Result<(Store, Arc<dyn Clock>), StoreError> {
    let of_database = |source| StoreError::Database { trouble: Trouble::Other, source };
    let address = Address::parse(database).map_err(|error| of_database(error.into()))?;
    let password = password.map_or_else(|| Password::from_environment(&address), |own| Ok(Some(own.clone())));
    let password = password.map_err(|error| of_database(format!("its password: {error}").into()))?;
    let blobs = densecloud_blobs::open(store, &densecloud_blobs::Settings::from_env());
    let blobs = blobs.map_err(|error| StoreError::Io(io::Error::other(error)))?;
    let records = Postgres::open(&address, password.as_ref(), Limits::default(), kind, bounds)?;
    let clock = records.clock();
    Ok((Store::new(Arc::new(records), blobs), clock))
}
