//! A call's first message: what is wanted, and how the cloud comes.

use std::collections::HashSet;

use axum::http::{HeaderMap, HeaderValue, header};

use crate::app::App;
use crate::http::accepted::accepted;
use crate::http::query;
use crate::problem::Problem;
use crate::proto;
use crate::proto::NumberType;
use crate::proto::options::{Goal, Result as Wanted};
use densecloud::Options;
use densecloud_cloud::{Attribute, Kind, Values};
use densecloud_formats::{Format, Reading, Scalar, npy_header};

/// A first message that makes sense.
#[derive(Debug)]
pub(super) struct Start {
    pub(super) options: Options,
    /// Whether the result comes as columns of numbers, and not as a file.
    pub(super) as_points: bool,
    /// How the cloud comes, where it is no file.
    pub(super) columns: Option<Columns>,
}

/// The most attributes that a layout may have.
const MOST_FIELDS: usize = 1000;

/// How the numbers of a cloud's points come.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    /// A claim.
    pub(super) points: u64,
    /// The type of a coordinate.
    pub(super) scalar: Scalar,
    /// Names and types of what is beside the position.
    pub(super) fields: Vec<(String, Kind)>,
}

impl Start {
    /// Checks everything that the first message alone can have wrong.
    ///
    /// # Errors
    /// What `POST /upsample` gives for the same parameters; [`Problem::MalformedRequest`] for a layout that
    /// makes no sense; too many points, or too many bytes of them.
    pub(super) fn read(start: proto::Start, app: &App) -> Result<Self, Problem> {
        let options = start.options.unwrap_or_default();
        let columns = start.layout.map(Columns::read).transpose()?;
        let read = read_options(&options)?;
        let (format, as_points) = match &options.result {
            Some(Wanted::MediaType(media_type)) => (media_type_format(media_type)?, false),
            // The finest; a result is in the cloud's own type, of which there is one here.
            Some(Wanted::AsPoints(true)) => (Some(Format::Npy { scalar: Scalar::F64, fields: true }), true),
            Some(Wanted::AsPoints(false)) | None => (None, columns.is_some()),
        };
        if columns.is_some() && read.reading != Reading::default() {
            let why = "axes, separator, decimal, format and bounds say how a file is read; this cloud comes as columns";
            return Err(malformed(why));
        }
        if let Some(columns) = &columns {
            app.check_points(columns.points, read.points_out(columns.points))?;
            let limit = app.config.limits.body_bytes;
            if columns.points.saturating_mul(columns.stride() as u64) > limit {
                return Err(Problem::BodyTooLarge { limit });
            }
        }
        Ok(Self { options: Options { format, ..read }, as_points, columns })
    }
}

/// The options as the names and values of a query, of which the rules are known.
fn read_options(options: &proto::Options) -> Result<Options, Problem> {
    let mut pairs = Vec::new();
    let mut push = |name: &str, value: String| pairs.push((name.to_owned(), value));
    match options.goal {
        Some(Goal::Ratio(ratio)) => push("ratio", ratio.to_string()),
        Some(Goal::Points(points)) => push("points", points.to_string()),
        Some(Goal::Spacing(spacing)) => push("spacing", spacing.to_string()),
        Some(Goal::Density(density)) => push("density", density.to_string()),
        None => {}
    }
    if options.seed != 0 {
        push("seed", options.seed.to_string());
    }
    if !options.attributes.is_empty() {
        push("attributes", options.attributes.clone());
    }
    for (name, set) in [("keep_input", options.keep_input), ("source_fields", options.source_fields)] {
        if set {
            push(name, true.to_string());
        }
    }
    if options.estimate_normals {
        push("normals", "estimate".to_owned());
    }
    if let Some(proto::Position { x, y, z }) = options.sensor {
        push("sensor", format!("{x},{y},{z}"));
    }
    let mut others: Vec<_> =
        options.parameters.iter().map(|(name, value)| (name.clone(), value.clone())).collect();
    // A map comes in any order; errors do not.
    others.sort_unstable();
    pairs.extend(others);
    query::options_of(&pairs)
}

/// As the header `Accept` would name it.
fn media_type_format(media_type: &str) -> Result<Option<Format>, Problem> {
    let wrong = |_| Problem::NotAcceptable { wanted: media_type.escape_debug().to_string() };
    let value = HeaderValue::from_str(media_type).map_err(wrong)?;
    accepted(&HeaderMap::from_iter([(header::ACCEPT, value)]))
}

fn malformed(why: impl Into<String>) -> Problem {
    Problem::MalformedRequest(why.into())
}

impl Columns {
    fn read(layout: proto::Layout) -> Result<Self, Problem> {
        let scalar = match layout.position_type() {
            NumberType::Float32 => Scalar::F32,
            NumberType::Float64 => Scalar::F64,
            other => {
                return Err(malformed(format!(
                    "the layout's position_type is {}; it may be NUMBER_TYPE_FLOAT32 or NUMBER_TYPE_FLOAT64",
                    other.as_str_name()
                )));
            }
        };
        if layout.fields.len() > MOST_FIELDS {
            let found = layout.fields.len();
            return Err(malformed(format!("the layout has {found} fields; there may be {MOST_FIELDS}")));
        }
        let mut names = HashSet::new();
        let mut fields = Vec::new();
        for field in layout.fields {
            let named = field.name.escape_debug().to_string();
            if ["", "x", "y", "z"].contains(&field.name.to_ascii_lowercase().as_str())
                || field.name.contains(char::is_control)
            {
                return Err(malformed(format!(
                    "a field of the layout cannot have the name \"{named}\"; x, y and z are in `positions`"
                )));
            }
            if !names.insert(field.name.clone()) {
                return Err(malformed(format!("the layout has two fields \"{named}\"")));
            }
            let kind = kind(field.r#type())
                .ok_or_else(|| malformed(format!("the layout's field \"{named}\" has no type")))?;
            fields.push((field.name, kind));
        }
        Ok(Self { points: layout.points, scalar, fields })
    }

    /// What a result of these attributes looks like.
    pub(super) fn of(points: u64, scalar: Scalar, attributes: &[Attribute]) -> Self {
        let fields = attributes.iter().map(|a| (a.name.clone(), a.values.kind())).collect();
        Self { points, scalar, fields }
    }

    pub(super) fn layout(&self) -> proto::Layout {
        let position_type = match self.scalar {
            Scalar::F32 => NumberType::Float32,
            Scalar::F64 => NumberType::Float64,
        };
        let field = |(name, kind): &(String, Kind)| proto::Field {
            name: name.clone(),
            r#type: number_type(*kind).into(),
        };
        proto::Layout {
            points: self.points,
            position_type: position_type.into(),
            fields: self.fields.iter().map(field).collect(),
        }
    }

    /// Bytes of a position.
    pub(super) fn position(&self) -> usize {
        match self.scalar {
            Scalar::F32 => 3 * size_of::<f32>(),
            Scalar::F64 => 3 * size_of::<f64>(),
        }
    }

    /// Bytes of a point.
    pub(super) fn stride(&self) -> usize {
        self.position() + self.fields.iter().map(|(_, kind)| kind.size()).sum::<usize>()
    }

    /// The beginning of a NumPy file whose rows are these points.
    pub(super) fn npy_header(&self) -> Vec<u8> {
        let attribute =
            |(name, kind): &(String, Kind)| Attribute { name: name.clone(), values: Values::new(*kind) };
        npy_header(self.scalar, true, self.points, &self.fields.iter().map(attribute).collect::<Vec<_>>())
    }
}

/// Both names of each type of number.
const TYPES: [(NumberType, Kind); 10] = [
    (NumberType::Float32, Kind::F32),
    (NumberType::Float64, Kind::F64),
    (NumberType::Int8, Kind::I8),
    (NumberType::Uint8, Kind::U8),
    (NumberType::Int16, Kind::I16),
    (NumberType::Uint16, Kind::U16),
    (NumberType::Int32, Kind::I32),
    (NumberType::Uint32, Kind::U32),
    (NumberType::Int64, Kind::I64),
    (NumberType::Uint64, Kind::U64),
];

fn kind(wanted: NumberType) -> Option<Kind> {
    TYPES.iter().find(|(name, _)| *name == wanted).map(|(_, kind)| *kind)
}

fn number_type(wanted: Kind) -> NumberType {
    TYPES.iter().find(|(_, kind)| *kind == wanted).map_or(NumberType::Unspecified, |(name, _)| *name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud::survey::Goal as Density;
    use densecloud_cascade::Target;

    fn options(goal: Goal) -> proto::Options {
        proto::Options { goal: Some(goal), ..proto::Options::default() }
    }

    #[test]
    fn options_are_the_parameters_of_the_query() {
        let all = proto::Options {
            seed: u64::MAX,
            attributes: "red:drop,label:mean".into(),
            keep_input: true,
            source_fields: true,
            estimate_normals: true,
            sensor: Some(proto::Position { x: 0.1, y: -1e300, z: 3.0 }),
            parameters: [("overlap".into(), "3".into()), ("no_polish".into(), "true".into())].into(),
            ..options(Goal::Ratio(2.5))
        };
        let query = "?ratio=2.5&seed=18446744073709551615&attributes=red:drop,label:mean&keep_input=true\
                     &source_fields=true&normals=estimate&sensor=0.1,-1e300,3&overlap=3&no_polish=true";
        let uri = format!("/upsample{query}").parse().expect("a URI");
        assert_eq!(read_options(&all), query::options(&uri));
        for (goal, expected) in [
            (Goal::Points(7), Density::Target(Target::Points(7))),
            (Goal::Spacing(0.1), Density::Spacing(0.1)),
            (Goal::Density(1e-9), Density::Density(1e-9)),
        ] {
            assert_eq!(read_options(&options(goal)).expect("parameters").goal, expected);
        }
        for goal in [Goal::Ratio(f64::NAN), Goal::Ratio(65.0), Goal::Points(0), Goal::Spacing(-1.0)] {
            assert!(matches!(read_options(&options(goal)), Err(Problem::Parameter { .. })), "{goal:?}");
        }
        assert!(read_options(&proto::Options::default()).is_err(), "a goal is needed");
        let twice = [("seed".to_owned(), "1".to_owned())].into();
        let twice = proto::Options { seed: 2, parameters: twice, ..options(Goal::Ratio(2.0)) };
        assert!(matches!(read_options(&twice), Err(Problem::Parameter { name, .. }) if name == "seed"));
    }

    #[test]
    fn a_layout_survives_both_ways_and_a_senseless_one_is_refused() {
        let columns = Columns {
            points: 5,
            scalar: Scalar::F64,
            fields: TYPES.iter().map(|(name, kind)| (name.as_str_name().to_owned(), *kind)).collect(),
        };
        assert_eq!(Columns::read(columns.layout()), Ok(columns.clone()));
        assert_eq!(columns.stride(), 24 + 4 + 8 + 2 * (1 + 2 + 4 + 8));
        let field = |name: &str, kind: NumberType| proto::Field { name: name.into(), r#type: kind.into() };
        let layout = |position: NumberType, fields| proto::Layout {
            points: 5,
            position_type: position.into(),
            fields,
        };
        let float = NumberType::Float32;
        for (layout, part) in [
            (layout(NumberType::Unspecified, vec![]), "position_type"),
            (layout(NumberType::Int8, vec![]), "NUMBER_TYPE_FLOAT32"),
            (proto::Layout { position_type: 99, ..layout(float, vec![]) }, "position_type"),
            (layout(float, vec![field("", float)]), "name"),
            (layout(float, vec![field("X", float)]), "name"),
            (layout(float, vec![field("a\nb", float)]), "a\\nb"),
            (layout(float, vec![field("a", float), field("a", float)]), "two fields"),
            (layout(float, vec![field("a", NumberType::Unspecified)]), "no type"),
            (layout(float, vec![field("a", float); MOST_FIELDS + 1]), "1001 fields"),
        ] {
            let why = Columns::read(layout).expect_err(part).to_string();
            assert!(why.contains(part), "{why}");
        }
    }
}
