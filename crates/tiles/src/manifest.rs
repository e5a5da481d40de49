//! What is written of a plan, so that other programs can go on with it.

use densecloud::attributes::Plan;
use densecloud::{Options, Report};
use densecloud_cloud::{Attribute, Facts, Origin, Values};
use densecloud_formats::{Adaptation, Format};
use densecloud_geometry::{NoPartition, Partition, Split};
use serde::{Deserialize, Serialize};

use crate::chunk::KindName;

/// All that decides a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Causes {
    /// The version of the program.
    pub(crate) version: String,
    /// The model's name and hash.
    pub(crate) model: [String; 2],
    /// All that decides the result, but for the format.
    pub(crate) options: Options,
    /// The format that was asked for.
    pub(crate) wanted: Option<Format>,
    pub(crate) tile_points: u64,
    /// SHA-256 of the input, in hexadecimal.
    pub(crate) input: Option<String>,
}

/// A plan as JSON has it. What is told of the result's file as a whole is beside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Manifest {
    pub(crate) causes: Causes,
    /// The input's points, those that are not finite included.
    pub(crate) points: u64,
    pub(crate) finite: u64,
    /// The attributes as they were read.
    pub(crate) columns: Vec<Column>,
    /// Those that get other types: their places, types and factors.
    pub(crate) adapted: Vec<(usize, KindName, f64)>,
    pub(crate) cells: Vec<Node>,
    pub(crate) tiles: Vec<Tile>,
    /// That of the result.
    pub(crate) format: Format,
    pub(crate) provenance: String,
    pub(crate) warnings: Vec<String>,
}

/// An attribute of the input.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Column {
    pub(crate) name: String,
    pub(crate) kind: KindName,
    /// As [`Facts::repeats`].
    pub(crate) repeats: bool,
    /// As [`Facts::is_flag`].
    pub(crate) is_flag: bool,
}

/// One tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Tile {
    /// Points of the input that are in it.
    pub(crate) own: u64,
    /// Points of the input around it.
    pub(crate) around: u64,
    /// Points of the result.
    pub(crate) size: u64,
}

/// A node of the partition.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum Node {
    /// Axis, place, and the node of the upper half.
    At(u8, f64, u32),
    /// The number of a tile.
    Cell(u32),
}

impl Causes {
    /// The first that is not as in `other`: what it is, here and there.
    pub(crate) fn differs(&self, other: &Self) -> Option<(&'static str, String, String)> {
        let told = |options: &Options| {
            let pairs = options.pairs().into_iter().map(|(name, value)| format!("{name}={value}"));
            pairs.collect::<Vec<_>>().join(" ")
        };
        let text = |what: &Self| {
            [
                ("version of this program", what.version.clone()),
                ("model", what.model[1].clone()),
                ("set of options", told(&what.options)),
                (
                    "format of the result",
                    what.wanted.map_or_else(|| "that of the input".to_owned(), |f| f.to_string()),
                ),
                ("number of points a tile", what.tile_points.to_string()),
                ("input", what.input.clone().unwrap_or_default()),
            ]
        };
        let mut pairs = text(self).into_iter().zip(text(other));
        pairs
            .find(|((_, there), (_, here))| there != here)
            .map(|((what, there), (_, here))| (what, there, here))
    }
}

impl Manifest {
    /// The attributes as they were read, without values.
    pub(crate) fn attributes(&self) -> Vec<Attribute> {
        let attribute =
            |column: &Column| Attribute { name: column.name.clone(), values: Values::new(column.kind.0) };
        self.columns.iter().map(attribute).collect()
    }

    pub(crate) fn adaptation(&self) -> Adaptation {
        let columns = self.adapted.iter().map(|(place, kind, factor)| (*place, kind.0, *factor)).collect();
        Adaptation { columns, told: None }
    }

    /// What becomes of the attributes.
    pub(crate) fn plan(&self) -> Plan {
        let mut attributes = self.attributes();
        self.adaptation().apply(&mut attributes);
        let facts = |i: usize| {
            let Column { repeats, is_flag, .. } = &self.columns[i];
            Facts { repeats: *repeats, is_flag: *is_flag, ..Facts::of(&Values::F64(Vec::new())) }
        };
        Plan::by_facts(&attributes, &self.causes.options.finish.rules, &facts)
    }

    pub(crate) fn partition(&self) -> Result<Partition, NoPartition> {
        let split = |node: &Node| match *node {
            Node::At(axis, at, upper) => Split::At { axis, at, upper },
            Node::Cell(cell) => Split::Cell(cell),
        };
        Partition::from_splits(self.cells.iter().map(split).collect())
    }

    /// What is told of the result's file as a whole, by what is of the input's.
    pub(crate) fn origin(&self, input: &Origin) -> Origin {
        let (mut origin, _) = self.causes.options.finish.origin(input, self.points == self.finite);
        if self.tiles.len() > 1 {
            origin.drop_references();
        }
        origin.comments.push(self.provenance.clone());
        origin
    }

    /// What is told of the result, before the work.
    pub(crate) fn report(&self, origin: Origin) -> Report {
        Report {
            format: self.format,
            origin,
            provenance: self.provenance.clone(),
            points_in: self.points,
            points_out: self.tiles.iter().map(|tile| tile.size).sum(),
            warnings: self.warnings.clone(),
        }
    }
}

pub(crate) fn nodes(partition: &Partition) -> Vec<Node> {
    let node = |split: &Split| match *split {
        Split::At { axis, at, upper } => Node::At(axis, at, upper),
        Split::Cell(cell) => Node::Cell(cell),
    };
    partition.splits().iter().map(node).collect()
}
