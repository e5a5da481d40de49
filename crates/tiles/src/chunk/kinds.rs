//! Types of numbers by name.

use densecloud_cloud::Kind;
use serde::{Deserialize, Serialize};

/// All types, and what they are called in our files.
pub(super) const KINDS: [(Kind, &str); 10] = [
    (Kind::I8, "i8"),
    (Kind::U8, "u8"),
    (Kind::I16, "i16"),
    (Kind::U16, "u16"),
    (Kind::I32, "i32"),
    (Kind::U32, "u32"),
    (Kind::I64, "i64"),
    (Kind::U64, "u64"),
    (Kind::F32, "f32"),
    (Kind::F64, "f64"),
];

/// A type of numbers as our files name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub(crate) struct KindName(pub(crate) Kind);

pub(crate) fn name_of(kind: Kind) -> &'static str {
    KINDS.iter().find(|known| known.0 == kind).map_or("", |known| known.1)
}

pub(crate) fn kind_named(name: &str) -> Option<Kind> {
    KINDS.iter().find(|known| known.1 == name).map(|known| known.0)
}

impl From<KindName> for String {
    fn from(kind: KindName) -> Self {
        name_of(kind.0).to_owned()
    }
}

impl TryFrom<String> for KindName {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        kind_named(&name).map(Self).ok_or_else(|| format!("{name:?} is no type of numbers"))
    }
}
