//! Addresses of where files are kept, as people write them.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use crate::{Blobs, Folder, Objects, Settings};

/// Opens what keeps files at an address: `s3://bucket/prefix`, `gs://bucket/prefix`, `az://container/prefix`,
/// `file:///path`, or a path, whose folder is made where it is missing. No store is asked yet. What it takes to reach
/// one is in the environment ([`Settings`]).
///
/// # Errors
/// [`AddressError`].
pub fn open(address: &str, settings: &Settings) -> Result<Arc<dyn Blobs>, AddressError> {
    match Address::parse(address)? {
        Address::Path(path) => match Folder::open(path.clone()) {
            Ok(folder) => Ok(Arc::new(folder)),
            Err(why) => Err(AddressError::Folder { path, why }),
        },
        Address::Object { scheme, bucket, key } => {
            Ok(Arc::new(Objects::open(scheme, bucket, &key, settings)?))
        }
    }
}

/// Opens the store of one object, and gives the object's name there. Such a name may have other characters than ours.
///
/// # Errors
/// [`AddressError`]; [`AddressError::NoObject`] for a path, or where a bucket alone is named.
pub fn open_object(address: &str, settings: &Settings) -> Result<(Objects, String), AddressError> {
    let Address::Object { scheme, bucket, key } = Address::parse(address)? else {
        return Err(AddressError::NoObject(address.to_owned()));
    };
    let (prefix, name) = key.rsplit_once('/').unwrap_or(("", &key));
    if name.is_empty() {
        return Err(AddressError::NoObject(address.to_owned()));
    }
    Ok((Objects::open(scheme, bucket, prefix, settings)?, name.to_owned()))
}

/// Where something is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// On a disk.
    Path(PathBuf),
    /// In an object store.
    Object {
        /// Which kind of store.
        scheme: Scheme,
        /// The bucket, or the container.
        bucket: String,
        /// What follows, without a slash before it. Empty for the bucket alone.
        key: String,
    },
}

/// A kind of object store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheme {
    /// S3, and what speaks its protocol.
    S3,
    /// Google Cloud Storage.
    Gs,
    /// Azure Blob Storage.
    Az,
}

impl Scheme {
    /// As addresses have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::S3 => "s3",
            Self::Gs => "gs",
            Self::Az => "az",
        }
    }
}

impl Address {
    /// Reads an address. What has no `://` is a path.
    ///
    /// # Errors
    /// [`AddressError`].
    pub fn parse(address: &str) -> Result<Self, AddressError> {
        let Some((scheme, rest)) = address.split_once("://") else {
            return Ok(Self::Path(address.into()));
        };
        let (bucket, key) = rest.split_once('/').unwrap_or((rest, ""));
        // Before anything that repeats the address.
        if bucket.contains('@') || rest.contains(['?', '#']) {
            return Err(AddressError::Credentials);
        }
        let scheme = match scheme.to_ascii_lowercase().as_str() {
            "file" => return file(address),
            "s3" => Scheme::S3,
            "gs" => Scheme::Gs,
            "az" => Scheme::Az,
            _ => return Err(AddressError::Scheme(scheme.to_owned())),
        };
        if bucket.is_empty() {
            return Err(AddressError::NoBucket(address.to_owned()));
        }
        Ok(Self::Object { scheme, bucket: bucket.to_owned(), key: key.to_owned() })
    }
}

fn file(address: &str) -> Result<Address, AddressError> {
    let path = url::Url::parse(address).ok().and_then(|url| url.to_file_path().ok());
    path.map(Address::Path).ok_or_else(|| AddressError::NoPath(address.to_owned()))
}

/// Why an address cannot be used. No text has credentials.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AddressError {
    /// It has a user, a password or parameters.
    #[error(
        "an address has a store, a bucket and a path, and neither credentials nor parameters: those belong in the environment, \
         such as AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_ENDPOINT_URL"
    )]
    Credentials,
    /// It begins with another scheme.
    #[error("{0}:// is no address of files; there are s3://, gs://, az:// and file://")]
    Scheme(String),
    /// It begins with a scheme that this build has not.
    #[error("this build has no {scheme}://; build it with the cargo feature `{feature}`")]
    NotBuilt {
        /// The scheme.
        scheme: &'static str,
        /// The feature.
        feature: &'static str,
    },
    /// It names no bucket.
    #[error("{0}: a bucket is missing")]
    NoBucket(String),
    /// It names no object.
    #[error("{0}: the name of an object is missing")]
    NoObject(String),
    /// It is a `file://` that is no path here.
    #[error("{0}: write file:///path, or the path alone")]
    NoPath(String),
    /// The environment has something that cannot be used.
    #[error("{address}: {why}")]
    Settings {
        /// The bucket.
        address: String,
        /// What is wrong.
        why: String,
    },
    /// A folder cannot be made.
    #[error("{}: {why}", path.display())]
    Folder {
        /// Which one.
        path: PathBuf,
        /// What the disk says.
        why: io::Error,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(scheme: Scheme, bucket: &str, key: &str) -> Address {
        Address::Object { scheme, bucket: bucket.into(), key: key.into() }
    }

    #[test]
    fn addresses_are_read_as_they_are_written() {
        let parsed = |address| Address::parse(address).expect(address);
        assert_eq!(parsed("s3://bucket/a/b c~%20.laz"), object(Scheme::S3, "bucket", "a/b c~%20.laz"));
        assert_eq!(parsed("S3://bucket"), object(Scheme::S3, "bucket", ""));
        assert_eq!(parsed("gs://b/x/"), object(Scheme::Gs, "b", "x/"));
        assert_eq!(parsed("az://c/x"), object(Scheme::Az, "c", "x"));
        assert_eq!(parsed("work/tiles"), Address::Path("work/tiles".into()));
        #[cfg(unix)]
        assert_eq!(parsed("file:///tmp/a%20b"), Address::Path("/tmp/a b".into()));
    }

    #[test]
    fn what_is_no_address_is_refused_without_repeating_a_secret() {
        let told = |address| Address::parse(address).expect_err(address).to_string();
        for address in ["s3://key:hunter2@bucket/x", "s3://bucket/x?sig=hunter2", "ftp://me:hunter2@host/x"] {
            let told = told(address);
            assert!(told.contains("belong in the environment") && !told.contains("hunter2"), "{told}");
        }
        assert_eq!(
            told("ftp://host/x"),
            "ftp:// is no address of files; there are s3://, gs://, az:// and file://"
        );
        assert_eq!(told("s3:///x"), "s3:///x: a bucket is missing");
        assert_eq!(told("file://host/x"), "file://host/x: write file:///path, or the path alone");
    }

    #[test]
    fn an_object_has_a_name() {
        let settings = Settings::new([], Default::default());
        let none = open_object("s3://bucket/x/", &settings).err().expect("no name").to_string();
        assert_eq!(none, "s3://bucket/x/: the name of an object is missing");
    }

    #[cfg(not(feature = "gcs"))]
    #[test]
    fn what_is_not_built_in_names_the_feature() {
        let settings = Settings::new([], Default::default());
        let told = open("gs://bucket/x", &settings).err().expect("not built").to_string();
        assert_eq!(told, "this build has no gs://; build it with the cargo feature `gcs`");
    }
}
