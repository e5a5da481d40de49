//! What a person can ask of an upsampling, as one value; [`PARAMETERS`] has its names, and how each is read.

use std::fmt;

use densecloud_cascade::{CascadeOptions, Target};
use densecloud_formats::{Format, Reading};
use serde::de::Error as _;
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::attributes::Finish;
use crate::parameters::{PARAMETERS, Parameter, Topic, Value};
use crate::survey::Goal;

/// All that decides a result beside its input and the model. Values may be set field by field, too:
///
/// ```
/// use densecloud::{Options, cascade::Target, survey::Goal};
///
/// let options = Options { goal: Goal::Target(Target::Points(700)), ..Options::default() };
/// ```
///
/// As text it is a list of names and values ([`Options::parse`], [`Options::pairs`]); with serde, a map of the same
/// names, to which `media_type` is added: that of [`Options::format`], the result's. (`format` is the input's.)
///
/// ```
/// let options = densecloud::Options::parse(&[("ratio", "8"), ("keep_input", "true")])?;
/// assert!(options.finish.keep_input);
/// assert_eq!(options.pairs(), [("ratio", "8".to_owned()), ("keep_input", "true".to_owned())]);
/// # Ok::<(), densecloud::OptionError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// How dense the result shall be; four times the input where nobody says.
    pub goal: Goal,
    /// How the cascade is run.
    pub cascade: CascadeOptions,
    /// What is done with the cascade's points.
    pub finish: Finish,
    /// How the input is read, where its content does not tell.
    pub reading: Reading,
    /// The most points of a cloud that is worked on as a whole; of a larger one those of a tile, about. None is the usual
    /// number. The library works on every cloud as a whole: its tiles are in a crate of their own.
    pub tile_points: Option<u64>,
    /// The format of the result; that of the input where there is none.
    pub format: Option<Format>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            goal: Goal::Target(Target::Ratio(4.0)),
            cascade: CascadeOptions::default(),
            finish: Finish::default(),
            reading: Reading::default(),
            tile_points: None,
            format: None,
        }
    }
}

/// A parameter that cannot be understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name}: {why}")]
pub struct OptionError {
    /// Its name, as it was given.
    pub name: String,
    /// What is wrong with it, and what it may be.
    pub why: String,
}

/// The key of [`Options::format`] in a map.
const MEDIA_TYPE: &str = "media_type";

/// What that key was before: a job from then may still wait. No name of an input's format has a slash.
const BEFORE: &str = "format";

impl Options {
    /// Reads names and values strictly: what is unknown or comes twice is an error, so that a misspelt name is not
    /// silently ignored. Without a goal, it is the default's.
    ///
    /// # Errors
    /// [`OptionError`] naming the parameter and what it may be.
    pub fn parse(pairs: &[(impl AsRef<str>, impl AsRef<str>)]) -> Result<Self, OptionError> {
        let mut options = Self::default();
        let mut goal = None;
        for (i, (name, value)) in pairs.iter().enumerate() {
            let (name, value) = (name.as_ref(), value.as_ref());
            let wrong = |why: String| OptionError { name: name.to_owned(), why };
            if pairs[..i].iter().any(|(earlier, _)| earlier.as_ref() == name) {
                return Err(wrong("given twice".into()));
            }
            let parameter = Parameter::named(name).ok_or_else(|| {
                let names: Vec<&str> = PARAMETERS.iter().map(|parameter| parameter.name).collect();
                wrong(format!("unknown; there are {}", names.join(", ")))
            })?;
            (parameter.read)(&mut options, value).map_err(wrong)?;
            if parameter.topic == Topic::Goal && goal.replace(name).is_some() {
                return Err(wrong("give one of ratio, points, spacing and density".into()));
            }
        }
        Ok(options)
    }

    /// Work and memory for each point: [`Request::effort`](crate::Request::effort).
    #[must_use]
    pub fn effort(&self) -> f64 {
        crate::request::effort(&self.cascade)
    }

    /// Whether one of these names is a goal's.
    #[must_use]
    pub fn names_goal<'a>(mut names: impl Iterator<Item = &'a str>) -> bool {
        names.any(|name| Parameter::named(name).is_some_and(|parameter| parameter.topic == Topic::Goal))
    }

    /// What [`Options::parse`] reads as the same options, the format aside: the goal, and all that is not as by default.
    #[must_use]
    pub fn pairs(&self) -> Vec<(&'static str, String)> {
        self.values().map(|(name, value)| (name, value.to_string())).collect()
    }

    fn values(&self) -> impl Iterator<Item = (&'static str, Value)> {
        let default = Self::default();
        PARAMETERS.iter().filter_map(move |parameter| {
            let value = (parameter.tell)(self)?;
            let told = parameter.topic == Topic::Goal || (parameter.tell)(&default).as_ref() != Some(&value);
            told.then_some((parameter.name, value))
        })
    }

    /// Points in the result for so many points in; unlike [`Target::points_out`], also for a claim that no cloud could
    /// meet. For a spacing or a density, which only the points themselves decide, the least that it can be.
    #[must_use]
    pub fn points_out(&self, points_in: u64) -> u64 {
        match self.goal {
            // Saturates, so a claim of 2^64 points is just a number that is too large.
            Goal::Target(Target::Ratio(ratio)) => (points_in as f64 * ratio).round() as u64,
            Goal::Target(Target::Points(points)) => points,
            Goal::Spacing(_) | Goal::Density(_) => points_in,
        }
    }
}

impl Serialize for Options {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (name, value) in self.values() {
            match value {
                // JSON has no such number.
                Value::Number(number) if !number.is_finite() => {
                    map.serialize_entry(name, &number.to_string())?
                }
                value => map.serialize_entry(name, &value)?,
            }
        }
        if let Some(format) = self.format {
            map.serialize_entry(MEDIA_TYPE, format.media_type())?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Options {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut map = Map::deserialize(deserializer)?.0;
        let is_media_type =
            |(name, value): &(String, String)| name == MEDIA_TYPE || name == BEFORE && value.contains('/');
        let format = map.iter().position(is_media_type).map(|at| map.remove(at).1);
        let mut options = Self::parse(&map).map_err(D::Error::custom)?;
        if let Some(media_type) = format {
            let essence = media_type.split(';').next().unwrap_or_default().trim();
            let found = Format::from_media_type(essence);
            let wrong = || {
                D::Error::custom(format!("{MEDIA_TYPE}: {media_type:?} is not the media type of a format"))
            };
            options.format = Some(found.ok_or_else(wrong)?);
        }
        Ok(options)
    }
}

/// A map's entries in their order, also those that come twice.
struct Map(Vec<(String, String)>);

impl<'de> Deserialize<'de> for Map {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> serde::de::Visitor<'de> for Entries {
            type Value = Map;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a map of options")
            }

            fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<Map, A::Error> {
                let mut entries = Vec::new();
                while let Some((name, value)) = map.next_entry::<String, Value>()? {
                    entries.push((name, value.to_string()));
                }
                Ok(Map(entries))
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(query: &str) -> Result<Options, OptionError> {
        let pairs: Vec<(&str, &str)> = query
            .split('&')
            .filter(|p| !p.is_empty())
            .map(|p| p.split_once('=').unwrap_or((p, "")))
            .collect();
        Options::parse(&pairs)
    }

    #[test]
    fn what_is_told_is_read_as_the_same() {
        for query in [
            "",
            "ratio=2.5",
            "points=1000&seed=18446744073709551615",
            "spacing=0.1&keep_input&source_fields=true&normals=estimate&sensor=1,-2,0.5",
            "ratio=2&confidence&min_confidence=0.9",
            "density=7&overlap=3&inner=1&max_displacement=inf&max_distance=2.5&no_polish=1",
            "ratio=1&attributes=a b:drop,c:mean",
            "ratio=2&axes=\"a,b\",3,c d&separator=semicolon&decimal=comma&format=text",
            "ratio=2&bounds=-1e-9,0,0.1,20000000.5",
            "ratio=2&bounds=-3,-2,-1,0,1,2",
        ] {
            let options = parse(query).unwrap_or_else(|why| panic!("{query}: {why}"));
            assert_eq!(Options::parse(&options.pairs()), Ok(options.clone()), "{query}");
            for format in [None, Some(Format::TEXT), Format::from_media_type("application/vnd.laszip")] {
                let options = Options { format, ..options.clone() };
                let json = serde_json::to_string(&options).expect("JSON");
                assert_eq!(serde_json::from_str::<Options>(&json).expect(&json), options);
            }
        }
        assert_eq!(parse(""), Ok(Options::default()));
        assert_eq!(parse("no_polish=false&seed=0&overlap=2"), Ok(Options::default()));
    }

    #[test]
    fn json_takes_numbers_switches_and_text() {
        let json = r#"{"points": 9, "keep_input": true, "seed": "7", "inner": 1, "format": "text/csv; charset=utf-8"}"#;
        let options: Options = serde_json::from_str(json).expect("options");
        assert_eq!(options.pairs().len(), 4);
        assert_eq!(options.format, Format::from_media_type("text/csv"));
        let both: Options =
            serde_json::from_str(r#"{"media_type": "text/csv", "format": "text", "separator": ";"}"#)
                .expect("options");
        assert_eq!(both.format, options.format);
        assert_eq!(both.pairs()[1..], [("separator", "semicolon".to_owned()), ("format", "text".to_owned())]);
        for (json, part) in [
            (r#"{"ratio": 0.5}"#, "ratio: \"0.5\" is not a number from 1 to 64"),
            (r#"{"ratio": 2, "ratio": 3}"#, "given twice"),
            (r#"{"ratoi": 2}"#, "unknown"),
            (r#"{"format": "text/html"}"#, "text/html"),
        ] {
            let why = serde_json::from_str::<Options>(json).expect_err(json).to_string();
            assert!(why.contains(part), "{why}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (query, name) in [
            ("ratio=", "ratio"),
            ("ratio=64.1", "ratio"),
            ("ratio=nan", "ratio"),
            ("ratio=4&ratio=4", "ratio"),
            ("points=0", "points"),
            ("points=1e3", "points"),
            ("ratio=4&points=8", "points"),
            ("seed=-1", "seed"),
            ("ration=4", "ration"),
            ("Ratio=4", "Ratio"),
            ("attributes=red", "attributes"),
            ("attributes=red:drop,red:mean", "attributes"),
            ("spacing=0", "spacing"),
            ("density=inf", "density"),
            ("keep_input=maybe", "keep_input"),
            ("confidence=0.9", "confidence"),
            ("min_confidence=1.1", "min_confidence"),
            ("min_confidence=-0.1", "min_confidence"),
            ("min_confidence=nan", "min_confidence"),
            ("normals=yes", "normals"),
            ("sensor=1,2", "sensor"),
            ("sensor=1,2,nan", "sensor"),
            ("overlap=0.5", "overlap"),
            ("overlap=101", "overlap"),
            ("inner=1.1", "inner"),
            ("max_distance=0", "max_distance"),
            ("max_displacement=nan", "max_displacement"),
            ("no_polish=no", "no_polish"),
            ("axes=1,2", "axes"),
            ("separator=colon", "separator"),
            ("decimal=;", "decimal"),
            ("format=docx", "format"),
            ("bounds=0,0,0,1", "bounds"),
            ("bounds=1,2,3", "bounds"),
        ] {
            assert_eq!(parse(query).expect_err(query).name, name, "{query}");
        }
    }

    #[test]
    fn points_out_are_the_cascades_own_and_saturate() {
        let out = |query: &str, points| parse(query).expect("options").points_out(points);
        for points_in in 1..200 {
            let expected = Target::Ratio(1.37).points_out(points_in).expect("a size");
            assert_eq!(out("ratio=1.37", points_in), expected);
        }
        assert_eq!(out("ratio=64", u64::MAX), u64::MAX);
        assert_eq!(out("points=9", 3), 9);
        assert_eq!(out("spacing=0.5", 3), 3);
    }
}
