//! Which rule an attribute follows.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::str::FromStr;

use densecloud_cloud::{Facts, Kind, Role};

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

/// As it is set: `mean`, `nearest` or `drop`.
impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mean => "mean",
            Self::Nearest => "nearest",
            Self::Drop => "drop",
        })
    }
}

/// The rules that are set by name; all other attributes follow those by role, name and values: see
/// [`Plan`](super::Plan).
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

/// Words in the names of attributes that measure something: floats of such a name are means though all may be whole.
const MEASURES: [&str; 40] = [
    "temperature",
    "temp",
    "heat",
    "distance",
    "dist",
    "height",
    "depth",
    "elevation",
    "altitude",
    "density",
    "curvature",
    "roughness",
    "quality",
    "radius",
    "diameter",
    "width",
    "length",
    "size",
    "thickness",
    "area",
    "volume",
    "error",
    "deviation",
    "residual",
    "std",
    "sigma",
    "variance",
    "angle",
    "slope",
    "speed",
    "velocity",
    "pressure",
    "humidity",
    "moisture",
    "power",
    "energy",
    "strength",
    "score",
    "probability",
    "weight",
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
    /// The rule that is set for an attribute of this name.
    #[must_use]
    pub fn set_for(&self, name: &str) -> Option<Rule> {
        self.set.get(name).copied()
    }

    /// Names that have a rule and are none of `names`: misspelt ones, most likely.
    pub fn unknown<'a>(&'a self, names: &'a [&str]) -> impl Iterator<Item = &'a str> {
        let names: HashSet<&str> = names.iter().copied().collect();
        self.set.keys().map(String::as_str).filter(move |name| !names.contains(name))
    }
}

/// The rule of an attribute for which none is set.
///
/// A role decides first, then a word in the name, then the type: integers are from the nearest point. Of floats that do not
/// measure something by their name the values decide: whole numbers that [repeat](Facts::repeats) number something.
pub(super) fn usual(role: Option<Role>, name: &str, kind: Kind, facts: impl FnOnce() -> Facts) -> Rule {
    let nearest = match role {
        Some(role) => !varies(role),
        None => numbers_something(name) || !kind.is_float() || !measures(name) && facts().repeats,
    };
    if nearest { Rule::Nearest } else { Rule::Mean }
}

/// Whether a role's values vary along a surface, so that there are values between two others.
fn varies(role: Role) -> bool {
    matches!(
        role,
        Role::X
            | Role::Y
            | Role::Z
            | Role::Red
            | Role::Green
            | Role::Blue
            | Role::Alpha
            | Role::NearInfrared
            | Role::Grey
            | Role::NormalX
            | Role::NormalY
            | Role::NormalZ
            | Role::Intensity
            | Role::Reflectance
            | Role::Amplitude
            | Role::Ambient
            | Role::Range
            | Role::Confidence
            | Role::Error
            | Role::RotationW
            | Role::RotationX
            | Role::RotationY
            | Role::RotationZ
            | Role::LogScaleX
            | Role::LogScaleY
            | Role::LogScaleZ
            | Role::Opacity
            | Role::HarmonicRed
            | Role::HarmonicGreen
            | Role::HarmonicBlue
            | Role::Harmonic
    )
}

fn numbers_something(name: &str) -> bool {
    // Names without separators are in the list with their ends.
    has_word(name, |word| {
        NAMES.contains(&word)
            || ["classification", "number", "time", "returns", "label"].iter().any(|n| word.ends_with(n))
    })
}

fn measures(name: &str) -> bool {
    has_word(name, |word| MEASURES.iter().any(|measure| word.ends_with(measure)))
}

/// Whether one of a name's words is one, in lower case: `tree_id` and `treeID` have two each.
fn has_word(name: &str, is_one: impl Fn(&str) -> bool) -> bool {
    let mut word = String::new();
    let mut after_lower = false;
    for c in name.chars().chain(['_']) {
        let begins = c.is_ascii_uppercase() && after_lower;
        if (begins || !c.is_ascii_alphabetic()) && is_one(&std::mem::take(&mut word)) {
            return true;
        }
        word.extend(c.is_ascii_alphabetic().then(|| c.to_ascii_lowercase()));
        after_lower = c.is_ascii_lowercase();
    }
    false
}

/// As [`FromStr`] reads it, by names; nothing where no rule is set.
impl fmt::Display for Rules {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, (name, rule)) in self.set.iter().enumerate() {
            let comma = if i == 0 { "" } else { "," };
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
    use densecloud_cloud::Values;

    /// Numbers that say nothing.
    fn reals(kind: Kind) -> Values {
        Values::from_f64(kind, (0..100).map(|i| f64::from(i) * 1.37 + 0.5))
    }

    fn by_name(name: &str, values: &Values) -> Rule {
        usual(Role::of(name), name, values.kind(), || Facts::of(values))
    }

    #[test]
    fn names_and_types_tell_the_rule() {
        for (name, kind) in [
            ("red", Kind::U8),
            ("Red", Kind::U16),
            ("diffuse_green", Kind::U8),
            ("Infrared", Kind::U16),
            ("Intensity", Kind::U16),
            ("scalar_Intensity", Kind::F32),
            ("reflectivity", Kind::U16),
            ("confidence", Kind::U8),
            ("curvature", Kind::F32),
            ("residual", Kind::F64),
            ("width", Kind::F32),
            ("fluid", Kind::F32),
            ("scalar_C2C_absolute_distances", Kind::F32),
            ("Elevation", Kind::I32),
        ] {
            assert_eq!(by_name(name, &reals(kind)), Rule::Mean, "{name}");
        }
        for (name, kind) in [
            ("label", Kind::I32),
            ("scalar_Classification", Kind::F32),
            ("GpsTime", Kind::F64),
            ("gps_time", Kind::F64),
            ("ReturnNumber", Kind::F32),
            ("point_id", Kind::F64),
            ("counts", Kind::U16),
            ("scalar_Original_cloud_index", Kind::F32),
            ("Point Source ID", Kind::F32),
            ("laser_id", Kind::F32),
            ("azimuth", Kind::F64),
            ("my class", Kind::F32),
            ("treeID", Kind::F32),
            ("OriginId", Kind::F64),
            ("LASCLASSIFICATION", Kind::F64),
            ("scalar_segment_of_tree", Kind::F32),
        ] {
            assert_eq!(by_name(name, &reals(kind)), Rule::Nearest, "{name}");
        }
    }

    #[test]
    fn floats_that_are_whole_and_repeat_name_something() {
        let of = |numbers: Vec<f64>| by_name("tree", &Values::F64(numbers));
        assert_eq!(of((0..100).map(|i| f64::from(i % 7)).collect()), Rule::Nearest);
        assert_eq!(of(vec![3.0; 4]), Rule::Nearest);
        assert_eq!(of(vec![0.0, -0.0, f64::NAN, f64::NAN]), Rule::Nearest);
        assert_eq!(of((0..100).map(|i| f64::from(i / 2)).collect()), Rule::Nearest, "twice each");
        assert_eq!(of((0..100).map(f64::from).collect()), Rule::Mean, "once each");
        assert_eq!(of((0..100).map(|i| f64::from(i * 2 / 3)).collect()), Rule::Mean, "once or twice");
        assert_eq!(of((0..100).map(|i| f64::from(i % 7) + 0.5).collect()), Rule::Mean);
        assert_eq!(of(vec![1.0, 1.0, f64::INFINITY]), Rule::Mean);
        assert_eq!(of(vec![f64::NAN; 9]), Rule::Mean);
        assert_eq!(of(Vec::new()), Rule::Mean);
        let many =
            |count: u32| by_name("tree", &Values::F32((0..2 * count).map(|i| (i / 2) as f32).collect()));
        assert_eq!(many(Facts::MOST_DIFFERENT as u32), Rule::Nearest);
        assert_eq!(many(Facts::MOST_DIFFERENT as u32 + 1), Rule::Mean);
        // What the name says is not up to the numbers.
        for name in
            ["intensity", "Red", "elevation", "temperature", "CanopyHeight", "scalar_C2C_dist", "signal"]
        {
            assert_eq!(by_name(name, &Values::F64(vec![400.0; 9])), Rule::Mean, "{name}");
        }
    }

    /// The rows of the table of roles, as documented.
    fn documented() -> String {
        let row = |role: Role| {
            let rule = usual(Some(role), "", Kind::F32, || Facts::of(&reals(Kind::F32)));
            let others: Vec<String> = role.others().iter().map(|name| format!("`{name}`")).collect();
            let number = if role == Role::Harmonic { "_0` and so on" } else { "`" };
            format!("| `{}{number} | {} | {rule} |\n", role.name(), others.join(", "))
        };
        Role::all().map(row).collect()
    }

    #[test]
    fn the_table_of_roles_is_documented() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/attributes.md");
        let text = std::fs::read_to_string(file).expect("the page");
        let table = documented();
        assert!(text.contains(&table), "docs/attributes.md should have:\n{table}");
    }

    #[test]
    fn rules_are_set_by_name() {
        let rules: Rules = "red:nearest,a:b:drop,label:mean".parse().expect("rules");
        assert_eq!(rules.set_for("red"), Some(Rule::Nearest));
        assert_eq!(rules.set_for("a:b"), Some(Rule::Drop));
        assert_eq!(rules.set_for("label"), Some(Rule::Mean));
        assert_eq!(rules.set_for("Red"), None);
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
