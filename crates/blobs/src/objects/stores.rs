//! The stores that there are, made of what the environment says.

use std::sync::Arc;
use std::time::Duration;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::list::PaginatedListStore;
use object_store::{BackoffConfig, ClientConfigKey, ObjectStore, Result, RetryConfig};

use super::fault;
use crate::address::{AddressError, Scheme};
use crate::settings::{Patience, Settings};

/// A store, and the same for lists.
type Both = (Arc<dyn ObjectStore>, Arc<dyn PaginatedListStore>);

pub(super) fn open(
    scheme: Scheme,
    bucket: String,
    settings: &Settings,
    address: &str,
) -> Result<Both, AddressError> {
    let made = match scheme {
        Scheme::S3 => s3(bucket, settings),
        #[cfg(feature = "gcs")]
        Scheme::Gs => gs(bucket, settings),
        #[cfg(not(feature = "gcs"))]
        Scheme::Gs => return Err(AddressError::NotBuilt { scheme: "gs", feature: "gcs" }),
        #[cfg(feature = "azure")]
        Scheme::Az => az(bucket, settings),
        #[cfg(not(feature = "azure"))]
        Scheme::Az => return Err(AddressError::NotBuilt { scheme: "az", feature: "azure" }),
    };
    let unusable = |why: object_store::Error| AddressError::Settings {
        address: address.to_owned(),
        why: fault::public(&why.to_string()),
    };
    made.map_err(unusable)
}

fn both<S: ObjectStore + PaginatedListStore>(store: S) -> Both {
    let store = Arc::new(store);
    (Arc::clone(&store) as Arc<dyn ObjectStore>, store)
}

/// Tries again for half of the time, so that the last try's error comes before the time is over.
fn retry(Patience { step, .. }: Patience) -> RetryConfig {
    let backoff = BackoffConfig { init_backoff: step / 1000, max_backoff: step / 8, base: 2.0 };
    RetryConfig { retry_timeout: step / 2, backoff, ..RetryConfig::default() }
}

fn milliseconds(time: Duration) -> String {
    format!("{}ms", time.as_millis())
}

fn s3(bucket: String, settings: &Settings) -> Result<Both> {
    let mut builder = AmazonS3Builder::new();
    for (name, value) in settings.of("AWS_") {
        if let Ok(key) = name.parse() {
            builder = builder.with_config(key, value);
        }
    }
    let timeout = AmazonS3ConfigKey::Client(ClientConfigKey::Timeout);
    let builder = builder
        .with_bucket_name(bucket)
        .with_config(timeout, milliseconds(settings.patience.request))
        // Not every store knows it, and blobs are deleted one by one.
        .with_config(AmazonS3ConfigKey::DisableBulkDelete, "true")
        .with_retry(retry(settings.patience));
    Ok(both(builder.build()?))
}

#[cfg(feature = "gcs")]
fn gs(bucket: String, settings: &Settings) -> Result<Both> {
    use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
    let mut builder = GoogleCloudStorageBuilder::new();
    for (name, value) in settings.of("GOOGLE_") {
        if let Ok(key) = name.parse() {
            builder = builder.with_config(key, value);
        }
    }
    let timeout = GoogleConfigKey::Client(ClientConfigKey::Timeout);
    let builder = builder
        .with_bucket_name(bucket)
        .with_config(timeout, milliseconds(settings.patience.request))
        .with_retry(retry(settings.patience));
    Ok(both(builder.build()?))
}

#[cfg(feature = "azure")]
fn az(container: String, settings: &Settings) -> Result<Both> {
    use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
    let mut builder = MicrosoftAzureBuilder::new();
    for (name, value) in settings.of("AZURE_") {
        if let Ok(key) = name.parse() {
            builder = builder.with_config(key, value);
        }
    }
    let timeout = AzureConfigKey::Client(ClientConfigKey::Timeout);
    let builder = builder
        .with_container_name(container)
        .with_config(timeout, milliseconds(settings.patience.request))
        .with_retry(retry(settings.patience));
    Ok(both(builder.build()?))
}
