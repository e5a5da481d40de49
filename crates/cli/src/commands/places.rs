//! Names of files on the command line that are addresses of objects.

use std::path::{Path, PathBuf};

use densecloud_blobs::{Address, AddressError, Objects, Settings, open_object};

use super::CliError;

/// Where the name of a file leads.
pub(super) enum Place {
    /// To a file of this path.
    Path(PathBuf),
    /// To an object of this name.
    Object(Objects, String),
}

impl Place {
    pub(super) fn of(name: &Path) -> Result<Self, CliError> {
        let Some(address) = name.to_str() else { return Ok(Self::Path(name.to_owned())) };
        match Address::parse(address).map_err(refused)? {
            Address::Path(path) => Ok(Self::Path(path)),
            Address::Object { .. } => {
                let (objects, name) = open_object(address, &Settings::from_env()).map_err(refused)?;
                Ok(Self::Object(objects, name))
            }
        }
    }
}

/// Refuses names that lead nowhere, before any of them is repeated: it may have a secret.
pub(super) fn check(names: &[&Path]) -> Result<(), CliError> {
    names.iter().try_for_each(|name| Place::of(name).map(drop))
}

/// An address that cannot be used.
pub(super) fn refused(why: AddressError) -> CliError {
    match why {
        AddressError::Settings { .. } | AddressError::Folder { .. } => CliError::Failed(why.to_string()),
        why => CliError::Usage(why.to_string()),
    }
}
