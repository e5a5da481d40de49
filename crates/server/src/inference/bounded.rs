//! Parts of a request's JSON of which there may be only a few: read without keeping what is too much.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use crate::problem::Problem;

/// The most entries of a [`Few`] and of [`Parameters`]: more than any request needs.
const MOST: usize = 32;

/// A short list.
#[derive(Debug)]
pub(super) struct Few<T>(pub(super) Vec<T>);

/// The members of an object of plain values, in their order. Numbers and booleans are text, as in a query; null is as
/// good as absent.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Parameters {
    pub(super) pairs: Vec<(String, String)>,
    /// Names of those that are lists or objects: none of ours are, and of others' nothing is kept.
    pub(super) nested: Vec<String>,
}

impl<T> Default for Few<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl Parameters {
    /// The value of this name, where it is there.
    ///
    /// # Errors
    /// [`Problem::MalformedRequest`] where that is a list or an object.
    pub(super) fn find(&self, name: &str) -> Result<Option<&str>, Problem> {
        if self.nested.iter().any(|nested| nested == name) {
            let why = format!("{name} is a list or an object; it must be a number, a string, true or false");
            return Err(Problem::MalformedRequest(why));
        }
        let found = self.pairs.iter().find(|(known, _)| known == name);
        Ok(found.map(|(_, value)| value.as_str()))
    }

    /// Drops those of these names.
    pub(super) fn ignore(&mut self, ignored: impl Fn(&str) -> bool) {
        self.pairs.retain(|(name, _)| !ignored(name));
        self.nested.retain(|name| !ignored(name));
    }

    /// All names.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.pairs.iter().map(|(name, _)| name).chain(&self.nested).map(String::as_str)
    }
}

/// Reads a member for which null is as good as absent.
pub(super) fn or_null<'de, D: Deserializer<'de>, T: Deserialize<'de> + Default>(
    deserializer: D,
) -> Result<T, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or_default())
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Few<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for List<T> {
            type Value = Few<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a list of at most {MOST}")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Few<T>, A::Error> {
                let mut items = Vec::new();
                while let Some(item) = sequence.next_element()? {
                    if items.len() == MOST {
                        return Err(A::Error::invalid_length(MOST + 1, &self));
                    }
                    items.push(item);
                }
                Ok(Few(items))
            }
        }
        deserializer.deserialize_seq(List(PhantomData))
    }
}

impl<'de> Deserialize<'de> for Parameters {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Members;
        impl<'de> Visitor<'de> for Members {
            type Value = Parameters;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "an object of at most {MOST} parameters")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Parameters, A::Error> {
                let (mut members, mut count) = (Parameters::default(), 0);
                while let Some((name, value)) = map.next_entry()? {
                    if count == MOST {
                        return Err(A::Error::invalid_length(MOST + 1, &self));
                    }
                    count += 1;
                    match value {
                        Value::Absent => {}
                        Value::Plain(text) => members.pairs.push((name, text)),
                        Value::Nested => members.nested.push(name),
                    }
                }
                Ok(members)
            }
        }
        deserializer.deserialize_map(Members)
    }
}

/// A parameter's value.
enum Value {
    /// Null.
    Absent,
    /// A number, a boolean or a string, as text.
    Plain(String),
    /// A list or an object.
    Nested,
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;
        impl<'de> Visitor<'de> for Any {
            type Value = Value;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a value")
            }

            fn visit_unit<E>(self) -> Result<Value, E> {
                Ok(Value::Absent)
            }

            fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
                Ok(Value::Plain(value.to_string()))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
                Ok(Value::Plain(value.to_string()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
                Ok(Value::Plain(value.to_string()))
            }

            fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
                Ok(Value::Plain(value.to_string()))
            }

            fn visit_str<E>(self, value: &str) -> Result<Value, E> {
                Ok(Value::Plain(value.to_owned()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Value, A::Error> {
                while sequence.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Value::Nested)
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(Value::Nested)
            }
        }
        deserializer.deserialize_any(Any)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_values_are_read_as_text() {
        let text = r#"{"ratio": 2.5, "points": 4.0, "seed": 18446744073709551615, "a": -1, "b": true, "c": "é",
                       "none": null, "list": [1, [2]], "map": {"a": {"b": null}}}"#;
        let mut members: Parameters = serde_json::from_str(text).expect("parameters");
        let values: Vec<&str> = members.pairs.iter().map(|(_, value)| value.as_str()).collect();
        assert_eq!(values, ["2.5", "4", "18446744073709551615", "-1", "true", "é"]);
        assert_eq!(members.nested, ["list", "map"]);
        assert_eq!((members.find("b"), members.find("none")), (Ok(Some("true")), Ok(None)));
        assert!(members.find("list").is_err() && members.find("map").is_err());
        members.ignore(|name| name.len() < 4);
        assert_eq!(members.names().collect::<Vec<_>>(), ["ratio", "points", "seed", "list"]);
        assert!(serde_json::from_str::<Parameters>("[]").is_err());
    }

    #[test]
    fn too_many_are_refused() {
        let list = |n: usize| serde_json::from_str::<Few<u8>>(&format!("[{}]", vec!["1"; n].join(",")));
        assert_eq!(list(MOST).expect("a list").0.len(), MOST);
        assert!(list(MOST + 1).is_err());
        let map =
            |n: usize| serde_json::from_str::<Parameters>(&format!("{{{}}}", vec![r#""a":1"#; n].join(",")));
        assert_eq!(map(MOST).expect("parameters").pairs.len(), MOST);
        assert!(map(MOST + 1).is_err());
    }
}
