//! The table of options that every door reads.
//!
//! A new option is two edits: its row here (with the field that it sets), and the place where it takes effect
//! (`provenance.rs` asks for each that decides points or values; tests ask for it in `docs/openapi.json`). The command line, queries, forms, tensors, gRPC and jobs take it from the table.

use std::fmt;
use std::str::FromStr;

use densecloud_cascade::{MAX_RATIO, Target};
use densecloud_cloud::Position;
use densecloud_formats::UnknownName;
use serde::{Deserialize, Serialize};

use crate::attributes::RulesError;
use crate::options::Options;
use crate::survey::Goal;

/// What a parameter is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topic {
    /// How dense the result shall be: a request has one of these.
    Goal,
    /// Which points the result has.
    Points,
    /// What is known of each point beside its position.
    Attributes,
    /// How the cascade is run.
    Cascade,
    /// How a large cloud is cut into tiles.
    Tiles,
    /// How the file is read.
    Reading,
}

/// One option: its name, its help, how it is read and told.
#[derive(Clone, Copy)]
pub struct Parameter {
    /// `keep_input`, in a query, a form and a map; with hyphens, an option of the command line.
    pub name: &'static str,
    /// One letter for the command line.
    pub short: Option<char>,
    /// What its value is called in a help text; a switch has none.
    pub value: Option<&'static str>,
    /// What it does, a sentence.
    pub help: &'static str,
    /// What it is about.
    pub topic: Topic,
    pub(crate) read: fn(&mut Options, &str) -> Result<(), String>,
    pub(crate) tell: fn(&Options) -> Option<Value>,
}

impl fmt::Debug for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// A parameter's value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// On or off.
    Switch(bool),
    /// A whole number.
    Whole(u64),
    /// Any number.
    Number(f64),
    /// Anything else.
    Text(String),
}

/// As [`Options::parse`] reads it.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Switch(on) => on.fmt(f),
            Self::Whole(number) => number.fmt(f),
            Self::Number(number) => number.fmt(f),
            Self::Text(text) => text.fmt(f),
        }
    }
}

/// Every option, in the order of help texts.
pub static PARAMETERS: [Parameter; 25] = [
    Parameter {
        name: "ratio",
        short: Some('r'),
        value: Some("R"),
        help: "Points out for each point in, any number from 1 to 64",
        topic: Topic::Goal,
        read: |options, text| {
            let ratio = parse_in(text, 1.0..=f64::from(MAX_RATIO))
                .ok_or_else(|| format!("{text:?} is not a number from 1 to {MAX_RATIO}"))?;
            options.goal = Goal::Target(Target::Ratio(ratio));
            Ok(())
        },
        tell: |options| match options.goal {
            Goal::Target(Target::Ratio(ratio)) => Some(Value::Number(ratio)),
            _ => None,
        },
    },
    Parameter {
        name: "points",
        short: Some('n'),
        value: Some("N"),
        help: "Points out, exactly: 1 to 64 times the points in",
        topic: Topic::Goal,
        read: |options, text| {
            let points = text.parse().ok().filter(|points| *points > 0);
            let points = points.ok_or_else(|| format!("{text:?} is not a positive whole number"))?;
            options.goal = Goal::Target(Target::Points(points));
            Ok(())
        },
        tell: |options| match options.goal {
            Goal::Target(Target::Points(points)) => Some(Value::Whole(points)),
            _ => None,
        },
    },
    Parameter {
        name: "spacing",
        short: None,
        value: Some("D"),
        help: "Mean distance from a point to its nearest neighbour, in the cloud's units",
        topic: Topic::Goal,
        read: |options, text| {
            options.goal = Goal::Spacing(positive(text)?);
            Ok(())
        },
        tell: |options| match options.goal {
            Goal::Spacing(spacing) => Some(Value::Number(spacing)),
            _ => None,
        },
    },
    Parameter {
        name: "density",
        short: None,
        value: Some("N"),
        help: "Points a square unit of surface",
        topic: Topic::Goal,
        read: |options, text| {
            options.goal = Goal::Density(positive(text)?);
            Ok(())
        },
        tell: |options| match options.goal {
            Goal::Density(density) => Some(Value::Number(density)),
            _ => None,
        },
    },
    Parameter {
        name: "keep_input",
        short: None,
        value: None,
        help: "Keep the input's points exactly, before the new ones; each takes the place of one of these",
        topic: Topic::Points,
        read: |options, text| {
            options.finish.keep_input = switch(text)?;
            Ok(())
        },
        tell: |options| Some(Value::Switch(options.finish.keep_input)),
    },
    Parameter {
        name: "source_fields",
        short: None,
        value: None,
        help: "Add `source_index` (the row of the input's point that is nearest) and `is_generated` to each point",
        topic: Topic::Attributes,
        read: |options, text| {
            options.finish.source_fields = switch(text)?;
            Ok(())
        },
        tell: |options| Some(Value::Switch(options.finish.source_fields)),
    },
    Parameter {
        name: "confidence",
        short: None,
        value: None,
        help: "Add `confidence`, from 0 to 1, to each point: how likely it lies within one spacing of the surface",
        topic: Topic::Attributes,
        read: |options, text| {
            options.finish.confidence = switch(text)?;
            Ok(())
        },
        tell: |options| Some(Value::Switch(options.finish.confidence)),
    },
    Parameter {
        name: "min_confidence",
        short: None,
        value: Some("X"),
        help: "Leave out points whose confidence is below this, from 0 to 1, but for the input's own: the result is \
               smaller than asked for",
        topic: Topic::Points,
        read: |options, text| {
            let least = parse_in(text, 0.0..=1.0);
            options.finish.min_confidence =
                least.ok_or_else(|| format!("{text:?} is not a number from 0 to 1"))?;
            Ok(())
        },
        tell: |options| Some(Value::Number(options.finish.min_confidence)),
    },
    Parameter {
        name: "normals",
        short: None,
        value: Some("HOW"),
        help: "`estimate`: normals from the dense cloud itself, on the side of the input's, or of the sensor",
        topic: Topic::Attributes,
        read: |options, text| {
            if text != "estimate" {
                return Err(format!("{text:?}; there is `estimate`"));
            }
            options.finish.estimate_normals = true;
            Ok(())
        },
        tell: |options| options.finish.estimate_normals.then(|| Value::Text("estimate".into())),
    },
    Parameter {
        name: "sensor",
        short: None,
        value: Some("X,Y,Z"),
        help: "Where the sensor stood, for the side of estimated normals [default: as the file says]",
        topic: Topic::Attributes,
        read: |options, text| {
            options.finish.sensor = Some(position(text)?);
            Ok(())
        },
        tell: |options| options.finish.sensor.map(|[x, y, z]| Value::Text(format!("{x},{y},{z}"))),
    },
    Parameter {
        name: "seed",
        short: None,
        value: Some("SEED"),
        help: "Chooses among equally good results; the same seed gives the same bytes",
        topic: Topic::Points,
        read: |options, text| {
            let wrong = |_| format!("{text:?} is not a whole number from 0 to {}", u64::MAX);
            options.cascade.seed = text.parse().map_err(wrong)?;
            Ok(())
        },
        tell: |options| Some(Value::Whole(options.cascade.seed)),
    },
    Parameter {
        name: "overlap",
        short: None,
        value: Some("X"),
        help: "How many patches each point lies in, on average: more is slower",
        topic: Topic::Cascade,
        read: |options, text| {
            options.cascade.overlap = within(text, MOST_OVERLAP)?;
            Ok(())
        },
        tell: |options| Some(Value::Number(options.cascade.overlap)),
    },
    Parameter {
        name: "inner",
        short: None,
        value: Some("X"),
        help: "Share of each patch, around its centre, whose points are kept: 1 keeps all",
        topic: Topic::Cascade,
        read: |options, text| {
            let inner = parse_in(text, 0.0..=1.0);
            options.cascade.inner = inner.ok_or_else(|| format!("{text:?} is not a number from 0 to 1"))?;
            Ok(())
        },
        tell: |options| Some(Value::Number(options.cascade.inner)),
    },
    Parameter {
        name: "max_displacement",
        short: None,
        value: Some("X"),
        help: "Leave out points moved further than this many spacings from their source; `inf` keeps all",
        topic: Topic::Cascade,
        read: |options, text| {
            options.cascade.max_displacement = limit(text)?;
            Ok(())
        },
        tell: |options| Some(Value::Number(options.cascade.max_displacement)),
    },
    Parameter {
        name: "max_distance",
        short: None,
        value: Some("X"),
        help: "Leave out points further from the input than this many times what nine in ten keep to, and points \
               beyond its open borders; `inf` keeps all",
        topic: Topic::Cascade,
        read: |options, text| {
            options.cascade.max_distance = limit(text)?;
            Ok(())
        },
        tell: |options| Some(Value::Number(options.cascade.max_distance)),
    },
    Parameter {
        name: "no_polish",
        short: None,
        value: None,
        help: "Keep what the network made as it is: less even, less smooth, and each point an output of the network",
        topic: Topic::Cascade,
        read: |options, text| {
            options.cascade.polish = !switch(text)?;
            Ok(())
        },
        tell: |options| Some(Value::Switch(!options.cascade.polish)),
    },
    Parameter {
        name: "spread",
        short: None,
        value: Some("HOW"),
        help: "`neighbourhood`: every place becomes denser by the same factor; `area`: the whole becomes equally dense, \
               and dense places may lose points",
        topic: Topic::Cascade,
        read: |options, text| {
            options.cascade.spread = text.parse()?;
            Ok(())
        },
        tell: |options| Some(Value::Text(options.cascade.spread.to_string())),
    },
    Parameter {
        name: "quality",
        short: None,
        value: Some("HOW"),
        help: "`best` makes twice as many points as are wanted and chooses among them: better coverage, about twice the \
               work; `standard` does not",
        topic: Topic::Cascade,
        read: |options, text| {
            options.cascade.quality = text.parse()?;
            Ok(())
        },
        tell: |options| Some(Value::Text(options.cascade.quality.to_string())),
    },
    Parameter {
        name: "tile_points",
        short: None,
        value: Some("N"),
        help: "Work on a cloud of more points than that in tiles of about as many, one after another, in memory that does \
               not grow with the cloud [default: 400000, fewer at more than 18 points for each]",
        topic: Topic::Tiles,
        read: |options, text| {
            let (least, most) = (LEAST_TILE, u64::from(u32::MAX));
            let points = text.parse().ok().filter(|points| (least..=most).contains(points));
            let wrong = || format!("{text:?} is not a whole number from {least} to {most}");
            options.tile_points = Some(points.ok_or_else(wrong)?);
            Ok(())
        },
        tell: |options| options.tile_points.map(Value::Whole),
    },
    Parameter {
        name: "attributes",
        short: None,
        value: Some("NAME:RULE,..."),
        help: "How new points come by their attributes, by name: mean (of the nearest), nearest or drop, such as \
               `label:nearest,curvature:drop` [default: by name and type]",
        topic: Topic::Attributes,
        read: |options, text| {
            options.finish.rules = text.parse().map_err(|why: RulesError| why.to_string())?;
            Ok(())
        },
        tell: |options| {
            Some(options.finish.rules.to_string()).filter(|rules| !rules.is_empty()).map(Value::Text)
        },
    },
    Parameter {
        name: "axes",
        short: None,
        value: Some("A,B,C"),
        help: "The columns of text that are x, y and z: their names, or their numbers from 1 [default: by their names, \
               else the first three]",
        topic: Topic::Reading,
        read: |options, text| {
            options.reading.axes = Some(text.parse()?);
            Ok(())
        },
        tell: |options| options.reading.axes.as_ref().map(|axes| Value::Text(axes.to_string())),
    },
    Parameter {
        name: "separator",
        short: None,
        value: Some("NAME"),
        help: "What stands between columns of text: comma, semicolon, tab, space (any white space) or bar [default: as \
               the first thousand lines say]",
        topic: Topic::Reading,
        read: |options, text| {
            options.reading.separator = Some(named(text)?);
            Ok(())
        },
        tell: |options| options.reading.separator.map(|separator| Value::Text(separator.to_string())),
    },
    Parameter {
        name: "decimal",
        short: None,
        value: Some("NAME"),
        help: "What stands before the fractions of numbers in text: point or comma [default: as the first thousand lines \
               say]",
        topic: Topic::Reading,
        read: |options, text| {
            options.reading.decimal = Some(named(text)?);
            Ok(())
        },
        tell: |options| options.reading.decimal.map(|decimal| Value::Text(decimal.to_string())),
    },
    Parameter {
        name: "format",
        short: None,
        value: Some("NAME"),
        help: "The input's format, where its content does not tell [default: by its content]",
        topic: Topic::Reading,
        read: |options, text| {
            options.reading.format = Some(named(text)?);
            Ok(())
        },
        tell: |options| options.reading.format.map(|format| Value::Text(format.to_string())),
    },
    Parameter {
        name: "bounds",
        short: None,
        value: Some("MINX,MINY,MAXX,MAXY"),
        help: "Take only the points in this box, the least corner included and the greatest not; with heights,                MINX,MINY,MINZ,MAXX,MAXY,MAXZ. Of COPC only the parts that reach into it are decompressed",
        topic: Topic::Reading,
        read: |options, text| {
            options.reading.bounds = Some(text.parse()?);
            Ok(())
        },
        tell: |options| options.reading.bounds.map(|bounds| Value::Text(bounds.to_string())),
    },
];

/// The fewest points of a tile: of fewer, most would lie at a border.
pub const LEAST_TILE: u64 = 1000;

/// The highest overlap: the cascade's own limit.
const MOST_OVERLAP: f64 = 100.0;

impl Parameter {
    /// The parameter of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        PARAMETERS.iter().find(|parameter| parameter.name == name)
    }

    /// Whether a value can be understood.
    ///
    /// # Errors
    /// What is wrong with it, and what it may be.
    pub fn check(&self, text: &str) -> Result<(), String> {
        (self.read)(&mut Options::default(), text)
    }

    /// The value where nobody gives one; nothing where there is none then.
    #[must_use]
    pub fn default_value(&self) -> Option<Value> {
        (self.tell)(&Options::default())
    }
}

fn parse_in(text: &str, range: std::ops::RangeInclusive<f64>) -> Option<f64> {
    text.parse().ok().filter(|number| range.contains(number))
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| f64::is_finite(*number) && *number > 0.0);
    number.ok_or_else(|| format!("{text:?} is not a positive number"))
}

fn within(text: &str, most: f64) -> Result<f64, String> {
    parse_in(text, 1.0..=most).ok_or_else(|| format!("{text:?} is not a number from 1 to {most}"))
}

fn limit(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| *number > 0.0);
    number.ok_or_else(|| format!("{text:?} is not a number above 0, nor `inf`"))
}

fn switch(text: &str) -> Result<bool, String> {
    match text {
        "true" | "1" | "" => Ok(true),
        "false" | "0" => Ok(false),
        _ => Err(format!("{text:?} is neither true nor false")),
    }
}

fn named<T: FromStr<Err = UnknownName>>(text: &str) -> Result<T, String> {
    text.parse().map_err(|why: UnknownName| why.to_string())
}

/// A place of a cloud's coordinates as options have it: `X,Y,Z`.
///
/// # Errors
/// They are not three finite numbers, in words for whoever typed them.
pub fn position(text: &str) -> Result<Position, String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|n| n.trim().parse().ok().filter(|n: &f64| n.is_finite())).collect();
    let position = numbers.and_then(|numbers| numbers.try_into().ok());
    position.ok_or_else(|| format!("{text:?} is not three numbers X,Y,Z"))
}
