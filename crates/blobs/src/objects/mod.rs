//! Blobs as the objects of a bucket whose keys begin alike.

mod calls;
mod fault;
mod reader;
mod stores;
mod writer;

use std::io;
use std::sync::Arc;

use object_store::list::{PaginatedListOptions, PaginatedListStore};
use object_store::path::Path;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt};

use crate::address::{AddressError, Scheme};
use crate::blobs::{BlobReader, BlobWriter, Blobs, Listed, check};
use crate::settings::{Patience, Settings};
use reader::Reader;
use writer::Writer;

/// Blobs as objects of a bucket: a blob's key is the prefix, a slash, and its name.
///
/// Each call blocks until the store has answered, or for as long as [`Patience`] says; it may be made from any
/// thread. All stores of a program share one thread. A writer takes up to two parts of memory, 8 MiB each (64 MiB
/// beyond the first 42 GB), and a reader as much.
///
/// A program that is killed while it writes leaves parts that no list shows and that are paid for: give the bucket a
/// rule that aborts incomplete multipart uploads after a day.
#[derive(Clone)]
pub struct Objects(Arc<Place>);

/// A bucket, the beginning of the keys, and how to reach it.
struct Place {
    store: Arc<dyn ObjectStore>,
    pages: Arc<dyn PaginatedListStore>,
    /// Empty, or with a slash at its end.
    prefix: String,
    /// As people write it, without the prefix.
    bucket: String,
    patience: Patience,
    runtime: tokio::runtime::Handle,
}

impl Objects {
    /// The objects of a bucket below a prefix. Asks nobody yet.
    ///
    /// # Errors
    /// [`AddressError::NotBuilt`], [`AddressError::Settings`].
    pub fn open(
        scheme: Scheme,
        bucket: String,
        prefix: &str,
        settings: &Settings,
    ) -> Result<Self, AddressError> {
        let address = format!("{}://{bucket}", scheme.name());
        let unusable = |why: String| AddressError::Settings { address: address.clone(), why };
        let prefix = Path::parse(prefix).map_err(|why| unusable(why.to_string()))?;
        let prefix = if prefix.as_ref().is_empty() { String::new() } else { format!("{prefix}/") };
        let runtime = calls::runtime().map_err(|why| unusable(why.to_string()))?;
        let (store, pages) = stores::open(scheme, bucket, settings, &address)?;
        let patience = settings.patience;
        Ok(Self(Arc::new(Place { store, pages, prefix, bucket: address, patience, runtime })))
    }

    /// The address of a blob, for people.
    #[must_use]
    pub fn address(&self, name: &str) -> String {
        format!("{}/{}{name}", self.0.bucket, self.0.prefix)
    }
}

impl Blobs for Objects {
    fn create(&self, name: &str) -> io::Result<Box<dyn BlobWriter>> {
        let path = self.0.path(name)?;
        Ok(Box::new(Writer::new(Arc::clone(&self.0), path)))
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn BlobReader>> {
        let path = self.0.path(name)?;
        let (store, asked) = (Arc::clone(&self.0.store), path.clone());
        let about = self.0.call(path.as_ref(), async move { store.head(&asked).await })?;
        Ok(Box::new(Reader::new(Arc::clone(&self.0), about)))
    }

    fn delete(&self, name: &str) -> io::Result<()> {
        let path = self.0.path(name)?;
        let (store, asked) = (Arc::clone(&self.0.store), path.clone());
        match self.0.call(path.as_ref(), async move { store.delete(&asked).await }) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            done => done,
        }
    }

    fn list(&self, prefix: &str) -> io::Result<Vec<Listed>> {
        let mut listed = Vec::new();
        let mut next = None;
        loop {
            let (objects, more) = self.0.page(prefix, next)?;
            listed.extend(objects.into_iter().filter_map(|object| self.0.listed(object)));
            next = more;
            if next.is_none() {
                return Ok(listed);
            }
        }
    }
}

impl Place {
    fn path(&self, name: &str) -> io::Result<Path> {
        check(name)?;
        let path = Path::parse(format!("{}{name}", self.prefix));
        path.map_err(|why| io::Error::new(io::ErrorKind::InvalidInput, why))
    }

    /// Some of the objects whose names begin with `prefix`, and where the next ones begin.
    fn page(&self, prefix: &str, token: Option<String>) -> io::Result<(Vec<ObjectMeta>, Option<String>)> {
        let (pages, prefix) = (Arc::clone(&self.pages), format!("{}{prefix}", self.prefix));
        // What lies deeper is another's.
        let options =
            PaginatedListOptions { delimiter: Some("/".into()), page_token: token, ..Default::default() };
        let asked = prefix.clone();
        let page = self.call(&prefix, async move {
            pages
                .list_paginated(Some(&asked).filter(|asked| !asked.is_empty()).map(String::as_str), options)
                .await
        })?;
        Ok((page.result.objects, page.page_token))
    }

    fn listed(&self, object: ObjectMeta) -> Option<Listed> {
        let name = object.location.as_ref().strip_prefix(&self.prefix)?;
        Some(Listed { name: name.to_owned(), modified: object.last_modified.into() })
    }
}
