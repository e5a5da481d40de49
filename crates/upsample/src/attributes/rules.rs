//! Which rule an attribute follows.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::str::FromStr;

use densecloud_cloud::Kind;

/// How a new point comes by its value of an attribute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// The distance-weighted mean of the nearest source points: for what varies along a surface.
    Mean,
    /// The value of the nearest source point: for what has no values between two others.
    Nearest,
    /// Left out.
    Drop,
}

/// A rule for every attribute: those set by name, and for all others one by name and type.
///
/// | | |
/// |---|---|
/// | [`Rule::Mean`] | colours and intensity of any type, and every other float |
/// | [`Rule::Nearest`] | integers other than those; and floats whose name has a word like `class`, `label`, `time`, `return` or `id` in it |
///
/// Three attributes that are a normal (`nx`, `ny`, `nz` or `normal_x` and so on) are interpolated as one
/// vector; see [`super::carry()`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Rules {
    set: BTreeMap<String, Rule>,
}

/// Rules that are taken at most: a server's clients send them, and each is compared with a file's names.
const MOST: usize = 1000;

/// Why text is no list of rules.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RulesError {
    /// Not a name, a colon and a rule.
    #[error("{0:?} is not NAME:mean, NAME:nearest or NAME:drop")]
    Malformed(String),
    /// A name comes twice.
    #[error("{0:?} has two rules")]
    Twice(String),
    /// More than anybody types.
    #[error("more than {MOST} rules")]
    TooMany,
}

/// Names of attributes that are colours or intensities, in lower case.
const SMOOTH: [&str; 20] = [
    "red",
    "green",
    "blue",
    "alpha",
    "r",
    "g",
    "b",
    "a",
    "diffuse_red",
    "diffuse_green",
    "diffuse_blue",
    "intensity",
    "reflectance",
    "reflectivity",
    "amplitude",
    "nir",
    "infrared",
    "scalar_intensity",
    "scalar_reflectance",
    "gray",
];

/// Words in the names of attributes whose values name something, rather than measure it.
const NAMES: [&str; 21] = [
    "class",
    "classification",
    "category",
    "label",
    "labels",
    "id",
    "ids",
    "index",
    "time",
    "timestamp",
    "gps",
    "return",
    "returns",
    "number",
    "segment",
    "segmentation",
    "cluster",
    "instance",
    "source",
    "flag",
    "scan",
];

impl Rules {
    /// The rule of an attribute.
    #[must_use]
    pub fn of(&self, name: &str, kind: Kind) -> Rule {
        if let Some(rule) = self.set.get(name) {
            return *rule;
        }
        let name = name.to_ascii_lowercase();
        if SMOOTH.contains(&name.as_str()) {
            return Rule::Mean;
        }
        // `ReturnNumber` has no separator; its words are in the list with one of them at an end.
        let names = name.split(|c: char| !c.is_ascii_alphabetic()).any(|word| {
            NAMES.contains(&word)
                || ["classification", "number", "time", "returns", "label"].iter().any(|n| word.ends_with(n))
        });
        if kind.is_float() && !names { Rule::Mean } else { Rule::Nearest }
    }

    /// Names that have a rule and are none of `names`: misspelt ones, most likely.
    pub fn unknown<'a>(&'a self, names: &'a [&str]) -> impl Iterator<Item = &'a str> {
        let names: HashSet<&str> = names.iter().copied().collect();
        self.set.keys().map(String::as_str).filter(move |name| !names.contains(name))
    }
}

/// As [`FromStr`] reads it, by names; nothing where no rule is set.
impl fmt::Display for Rules {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, (name, rule)) in self.set.iter().enumerate() {
            let comma = if i == 0 { "" } else { "," };
            let rule = match rule {
                Rule::Mean => "mean",
                Rule::Nearest => "nearest",
                Rule::Drop => "drop",
            };
            write!(f, "{comma}{name}:{rule}")?;
        }
        Ok(())
    }
}

/// `NAME:RULE` with commas between: `label:nearest,temperature:drop`.
impl FromStr for Rules {
    type Err = RulesError;

    fn from_str(text: &str) -> Result<Self, RulesError> {
        let mut set = BTreeMap::new();
        for part in text.split(',') {
            let bad = || RulesError::Malformed(part.to_owned());
            let (name, rule) = part.rsplit_once(':').ok_or_else(bad)?;
            let rule = match rule {
                "mean" => Rule::Mean,
                "nearest" => Rule::Nearest,
                "drop" => Rule::Drop,
                _ => return Err(bad()),
            };
            if name.is_empty() {
                return Err(bad());
            }
            if set.insert(name.to_owned(), rule).is_some() {
                return Err(RulesError::Twice(name.to_owned()));
            }
            if set.len() > MOST {
                return Err(RulesError::TooMany);
            }
        }
        Ok(Self { set })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_types_tell_the_rule() {
        let rules = Rules::default();
        for (name, kind) in [
            ("red", Kind::U8),
            ("Intensity", Kind::U16),
            ("scalar_Intensity", Kind::F32),
            ("curvature", Kind::F32),
            ("residual", Kind::F64),
            ("width", Kind::F32),
        ] {
            assert_eq!(rules.of(name, kind), Rule::Mean, "{name}");
        }
        for (name, kind) in [
            ("label", Kind::I32),
            ("scalar_Classification", Kind::F32),
            ("GpsTime", Kind::F64),
            ("gps_time", Kind::F64),
            ("ReturnNumber", Kind::F32),
            ("point_id", Kind::F64),
            ("counts", Kind::U16),
        ] {
            assert_eq!(rules.of(name, kind), Rule::Nearest, "{name}");
        }
    }

    #[test]
    fn rules_are_set_by_name() {
        let rules: Rules = "red:nearest,a:b:drop,label:mean".parse().expect("rules");
        assert_eq!(rules.of("red", Kind::U8), Rule::Nearest);
        assert_eq!(rules.of("a:b", Kind::U8), Rule::Drop);
        assert_eq!(rules.of("label", Kind::U8), Rule::Mean);
        assert_eq!(rules.unknown(&["red", "label"]).collect::<Vec<_>>(), ["a:b"]);
        for bad in ["", "red", "red:", ":mean", "red:Mean", "red:mean,"] {
            assert!(matches!(bad.parse::<Rules>(), Err(RulesError::Malformed(_))), "{bad}");
        }
        assert_eq!("a:mean,a:drop".parse::<Rules>(), Err(RulesError::Twice("a".into())));
        let many = |count| (0..count).map(|i| format!("a{i}:drop")).collect::<Vec<_>>().join(",");
        assert!(many(MOST).parse::<Rules>().is_ok());
        assert_eq!(many(MOST + 1).parse::<Rules>(), Err(RulesError::TooMany));
    }
}
