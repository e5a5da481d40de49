//! From a cloud and options to all that is known before the work: the same behind every door.

use densecloud_backends::ModelName;
use densecloud_cloud::{Attribute, Cloud, Facts, Origin, Table};
use densecloud_formats::Format;
use densecloud_geometry::{TooManyPoints, check_count};

use crate::options::Options;
use crate::outline::{Outline, Outlined};
use crate::request::{Made, Request};
use crate::survey::{self, GoalError, Survey};

/// A request that can be worked on, and what its result will be.
#[derive(Debug, Clone)]
pub struct Prepared {
    /// What is to be computed.
    pub request: Request,
    /// What is told of the result.
    pub report: Report,
}

/// What is told of a result beside its points.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// The result's format: the one asked for or the input's, in 64 bits where 32 would be too coarse.
    pub format: Format,
    /// What the result's file tells of the whole, provenance among it.
    pub origin: Origin,
    /// Which program, model, settings and input make the result; see
    /// [`provenance::line`](crate::provenance::line).
    pub provenance: String,
    /// Points in the input, those that are not finite included.
    pub points_in: u64,
    /// Points in the result; before the work, as the options ask for them, and 0 where the cloud is too bad to tell.
    pub points_out: u64,
    /// What a person should know about how the cloud was read and made dense, a sentence each.
    pub warnings: Vec<String>,
}

/// Why a cloud cannot be worked on with these options.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PrepareError {
    /// There is no number of points for the goal.
    #[error(transparent)]
    Goal(#[from] GoalError),
    /// The cloud has more points than indices can tell apart.
    #[error(transparent)]
    TooManyPoints(#[from] TooManyPoints),
    /// An attribute has not one value for each point.
    #[error("attribute {name:?} has {values} values for {points} points")]
    AttributeLength {
        /// Its name.
        name: String,
        /// The values that it has.
        values: usize,
        /// The cloud's points.
        points: usize,
    },
    /// A rule names an attribute that the cloud does not have.
    #[error(
        "no attribute {name:?}; the input has {}", if known.is_empty() { "none".to_owned() } else { known.join(", ") }
    )]
    UnknownAttribute {
        /// The name in the rule.
        name: String,
        /// The names that there are.
        known: Vec<String>,
    },
}

impl Prepared {
    /// Checks the options against the cloud, and works out everything that does not need the cascade. `input` is the
    /// format that the cloud came in, `model` the one that will be used.
    ///
    /// Cost: a survey of a few thousand points, O(n log n); a larger one for a spacing or a density.
    ///
    /// # Errors
    /// [`PrepareError`]. Targets that are impossible for this cloud are found by the cascade.
    pub fn new(
        mut cloud: Cloud,
        input: Format,
        options: Options,
        model: &ModelName,
    ) -> Result<Self, PrepareError> {
        let points = cloud.positions.len();
        if let Some(odd) = cloud.attributes.iter().find(|attribute| attribute.values.len() != points) {
            let (name, values) = (odd.name.clone(), odd.values.len());
            return Err(PrepareError::AttributeLength { name, values, points });
        }
        check_rules(&options, &cloud.attributes)?;
        check_count(points)?;
        let outline = Outline {
            attributes: &cloud.attributes,
            facts: &|i| Facts::of(&cloud.attributes[i].values),
            origin: &cloud.origin,
            told: cloud.warnings(),
            points: points as u64,
            is_finite: cloud.positions.as_flattened().iter().all(|c| c.is_finite()),
            target: options.goal.target(&cloud.positions)?,
            survey: Survey::of(&cloud.positions, survey::GLANCE).ok(),
            tile_points: None,
        };
        let Outlined { report, adaptation, plan } = outline.outlined(input, &options, model);
        let target = outline.target;
        adaptation.apply(&mut cloud.attributes);
        let Options { cascade: settings, finish, .. } = options;
        let request = Request { cloud, target, settings, finish, plan };
        Ok(Self { request, report })
    }

    /// Bytes that each point of the result takes beside its position.
    #[must_use]
    pub fn attribute_bytes(&self) -> u64 {
        self.request.finish.bytes_a_point(&self.request.cloud.attributes)
    }

    /// Bytes of what the result takes over beside its points: tables such as faces.
    #[must_use]
    pub fn table_bytes(&self) -> u64 {
        self.report.origin.tables.iter().map(Table::bytes).sum()
    }
}

/// Checks that the rules of the options are for attributes that there are.
///
/// # Errors
/// [`PrepareError::UnknownAttribute`].
pub fn check_rules(options: &Options, attributes: &[Attribute]) -> Result<(), PrepareError> {
    let names: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
    let Some(name) = options.finish.rules.unknown(&names).next() else { return Ok(()) };
    let known = names.iter().map(|&name| name.to_owned()).collect();
    Err(PrepareError::UnknownAttribute { name: name.to_owned(), known })
}

impl Report {
    /// Adds what is known once the result is there: how many points it has, what was done to the input, what its format
    /// has no place for, and what has another name there.
    pub fn complete(&mut self, made: &Made) {
        self.points_out = made.positions.len() as u64;
        self.warnings.extend(made.warnings());
        let lost = self.format.cannot_hold(&made.attributes, &self.origin);
        self.tell_losses(&lost, &self.format.renamed(&made.attributes, &self.origin));
    }

    /// Adds what the result's format has no place for, and which names become others.
    pub fn tell_losses(&mut self, lost: &[String], renamed: &[(String, String)]) {
        if !lost.is_empty() {
            self.warnings.push(format!("the result's format has no place for {}", lost.join(", ")));
        }
        if !renamed.is_empty() {
            let pairs: Vec<String> = renamed.iter().map(|(from, to)| format!("{from:?} as {to:?}")).collect();
            self.warnings.push(format!("in the result's file, names are others: {}", pairs.join(", ")));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::{Kind, Values};
    use densecloud_formats::{PlyEncoding, Scalar};

    fn prepare(cloud: Cloud, options: &[(&str, &str)]) -> Result<Prepared, PrepareError> {
        let input = Format::Ply { encoding: PlyEncoding::Ascii, scalar: Scalar::F32 };
        let options = Options::parse(options).expect("options");
        Prepared::new(cloud, input, options, &ModelName::default())
    }

    fn grid(offset: f64) -> Vec<[f64; 3]> {
        (0..100).map(|i| [offset + f64::from(i % 10), f64::from(i / 10), 0.0]).collect()
    }

    #[test]
    fn points_that_are_not_finite_count_for_nothing() {
        let clean = prepare(Cloud::from(grid(0.0)), &[("ratio", "4")]).expect("a request");
        let mut positions = grid(0.0);
        positions.extend([[f64::NAN; 3]; 100]);
        let spoilt = prepare(Cloud::from(positions), &[("ratio", "4")]).expect("a request");
        assert_eq!((clean.report.points_out, spoilt.report.points_out), (400, 400));
        assert_eq!(clean.report.format, spoilt.report.format);
        assert_eq!(spoilt.report.points_in, 200);
    }

    #[test]
    fn a_format_too_coarse_for_the_result_becomes_finer() {
        for (offset, scalar) in [(0.0, Scalar::F32), (1e7, Scalar::F64)] {
            let prepared = prepare(Cloud::from(grid(offset)), &[]).expect("a request");
            let ply = Format::Ply { encoding: PlyEncoding::Ascii, scalar };
            assert_eq!(prepared.report.format, ply, "{offset}");
        }
    }

    #[test]
    fn attributes_have_a_value_for_each_point() {
        for values in [0, 99, 101] {
            let attributes = vec![Attribute { name: "red".into(), values: Values::U8(vec![0; values]) }];
            let why = prepare(Cloud { attributes, ..Cloud::from(grid(0.0)) }, &[]).expect_err("a length");
            assert_eq!(why.to_string(), format!("attribute \"red\" has {values} values for 100 points"));
        }
    }

    #[test]
    fn rules_for_what_is_not_there_are_refused() {
        let values = Values::U8(vec![0; 100]);
        let attributes = vec![Attribute { name: "red".into(), values }];
        let cloud = Cloud { attributes, ..Cloud::from(grid(0.0)) };
        assert!(prepare(cloud.clone(), &[("attributes", "red:drop")]).is_ok());
        let why = prepare(cloud, &[("attributes", "blue:drop")]).expect_err("no blue").to_string();
        assert_eq!(why, "no attribute \"blue\"; the input has red");
        let why = prepare(Cloud::from(grid(0.0)), &[("attributes", "blue:drop")]).expect_err("no blue");
        assert!(why.to_string().ends_with("the input has none"), "{why}");
    }

    #[test]
    fn a_confidence_of_the_input_keeps_its_name_and_a_warning_tells() {
        let attributes = vec![Attribute { name: "Confidence".into(), values: Values::F32(vec![0.5; 100]) }];
        let cloud = Cloud { attributes, ..Cloud::from(grid(0.0)) };
        let told = |options: &[(&str, &str)]| {
            let report = prepare(cloud.clone(), options).expect("a request").report;
            report.warnings.iter().filter(|told| told.contains("confidence_")).count()
        };
        assert_eq!(told(&[("confidence", "true")]), 1);
        assert_eq!(told(&[]) + told(&[("min_confidence", "0.5")]), 0, "there is no other");
        assert_eq!(told(&[("confidence", "true"), ("attributes", "Confidence:drop")]), 0, "its name is free");
    }

    #[test]
    fn columns_from_text_have_the_types_of_their_places() {
        let column =
            |name: &str, number: f64| Attribute { name: name.into(), values: Values::F64(vec![number; 100]) };
        let attributes =
            vec![column("Red", 17.0), column("Green", 255.0), column("Blue", 0.0), column("width", 2.0)];
        let cloud = Cloud { attributes, ..Cloud::from(grid(0.0)) };
        let kinds = |wanted: &str| {
            let options = Options::parse(&[("ratio", "4")]).expect("options");
            let options = Options { format: Format::from_extension(wanted.as_ref()), ..options };
            let prepared = Prepared::new(cloud.clone(), Format::TEXT, options, &ModelName::default())
                .expect("a request");
            let kinds = prepared.request.cloud.attributes.iter().map(|a| a.values.kind());
            kinds.collect::<Vec<_>>()
        };
        let wide = Kind::F64;
        assert_eq!(kinds("a.ply"), [Kind::U8, Kind::U8, Kind::U8, wide]);
        assert_eq!(kinds("a.las"), [Kind::U8, Kind::U8, Kind::U8, wide]);
        assert_eq!(kinds("a.csv"), [wide; 4]);
    }

    #[test]
    fn names_that_become_others_are_told() {
        let attribute = |name: &str| Attribute { name: name.into(), values: Values::U16(vec![7; 100]) };
        let attributes = ["a b", "red", "red"].map(attribute).to_vec();
        let cloud = Cloud { attributes: attributes.clone(), ..Cloud::from(grid(0.0)) };
        let Prepared { mut report, .. } = prepare(cloud, &[]).expect("a request");
        report.complete(&Made {
            positions: grid(0.0),
            attributes,
            dropped_non_finite: 0,
            duplicates: 0,
            apart: 0,
            unsure: 0,
        });
        let told = report.warnings.last().expect("a warning");
        assert_eq!(told, "in the result's file, names are others: \"a b\" as \"a_b\", \"red\" as \"red_\"");
    }
}
