//! Parts of a request's JSON of which there may be only a few: read without keeping what is too much.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};

/// The most entries of a [`Few`] and of [`Parameters`]: more than any request needs.
const MOST: usize = 32;

/// A short list.
#[derive(Debug)]
pub(super) struct Few<T>(pub(super) Vec<T>);

/// The members of an object of plain values, in their order. Numbers and booleans are text, as in a query.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Parameters(pub(super) Vec<(String, String)>);

impl<T> Default for Few<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl Parameters {
    /// Takes the one of this name out.
    pub(super) fn take(&mut self, name: &str) -> Option<String> {
        let at = self.0.iter().position(|(n, _)| n == name)?;
        Some(self.0.remove(at).1)
    }
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
                let mut members = Vec::new();
                while let Some((name, Plain(value))) = map.next_entry()? {
                    if members.len() == MOST {
                        return Err(A::Error::invalid_length(MOST + 1, &self));
                    }
                    members.push((name, value));
                }
                Ok(Parameters(members))
            }
        }
        deserializer.deserialize_map(Members)
    }
}

/// A number, a boolean or a string, as text.
struct Plain(String);

impl<'de> Deserialize<'de> for Plain {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Value;
        impl Visitor<'_> for Value {
            type Value = Plain;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, a string, true or false")
            }

            fn visit_bool<E>(self, value: bool) -> Result<Plain, E> {
                Ok(Plain(value.to_string()))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Plain, E> {
                Ok(Plain(value.to_string()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Plain, E> {
                Ok(Plain(value.to_string()))
            }

            fn visit_f64<E>(self, value: f64) -> Result<Plain, E> {
                Ok(Plain(value.to_string()))
            }

            fn visit_str<E>(self, value: &str) -> Result<Plain, E> {
                Ok(Plain(value.to_owned()))
            }
        }
        deserializer.deserialize_any(Value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_values_are_read_as_text() {
        let text =
            r#"{"ratio": 2.5, "points": 4.0, "seed": 18446744073709551615, "a": -1, "b": true, "c": "é"}"#;
        let Parameters(members) = serde_json::from_str(text).expect("parameters");
        let values: Vec<&str> = members.iter().map(|(_, value)| value.as_str()).collect();
        assert_eq!(values, ["2.5", "4", "18446744073709551615", "-1", "true", "é"]);
        for bad in [r#"{"a": [1]}"#, r#"{"a": {}}"#, r#"{"a": null}"#, "[]"] {
            assert!(serde_json::from_str::<Parameters>(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn too_many_are_refused() {
        let list = |n: usize| serde_json::from_str::<Few<u8>>(&format!("[{}]", vec!["1"; n].join(",")));
        assert_eq!(list(MOST).expect("a list").0.len(), MOST);
        assert!(list(MOST + 1).is_err());
        let map =
            |n: usize| serde_json::from_str::<Parameters>(&format!("{{{}}}", vec![r#""a":1"#; n].join(",")));
        assert_eq!(map(MOST).expect("parameters").0.len(), MOST);
        assert!(map(MOST + 1).is_err());
    }
}
