//! What a file tells of the whole, on the disk, for programs that join what another one has planned.

use std::io::BufReader;
use std::sync::Arc;

use densecloud_cloud::{Column, Crs, Named, Origin, Sensors, Table, Values, each_kind};
use densecloud_formats::{Block, CloudReader, Format, Limits, encode};
use serde::{Deserialize, Serialize};

use crate::chunk::{kind_named, name_of};
use crate::disk::write_whole;
use crate::{Folder, TilesError};

/// An [`Origin`] as JSON has it, but for what only the input's format knows.
#[derive(Debug, Serialize, Deserialize)]
struct Stored {
    crs: Option<StoredCrs>,
    comments: Vec<String>,
    sensor: Option<[f64; 3]>,
    sensors: Option<(String, Vec<Option<[f64; 3]>>)>,
    orientation: Option<[f64; 4]>,
    /// The kind of the file, and the names that it gave.
    named_in: Option<(Format, Vec<String>)>,
    sha256: Option<[u8; 32]>,
    tables: Vec<StoredTable>,
    /// Whether an example of the input has what only its format knows.
    has_extra: bool,
    /// Whether the input has more of that than an example tells.
    lost: bool,
}

#[derive(Debug, Serialize, Deserialize)]
enum StoredCrs {
    Epsg(u32, Option<u32>),
    Wkt(String),
}

#[derive(Debug, Serialize, Deserialize)]
struct StoredTable {
    name: String,
    rows: usize,
    columns: Vec<(String, StoredColumn)>,
}

#[derive(Debug, Serialize, Deserialize)]
enum StoredColumn {
    Scalar(Numbers),
    List(Numbers, Numbers),
}

/// A type, and the numbers in hexadecimal, little-endian: JSON has no NaN.
#[derive(Debug, Serialize, Deserialize)]
struct Numbers(String, String);

/// Writes what is known of a cloud's file as a whole. `input` is its format, `example` some of its points, in the columns
/// that are attributes.
pub(crate) fn store(
    folder: &Folder,
    origin: &Origin,
    input: Format,
    example: (&Block, &[densecloud_cloud::Attribute]),
) -> Result<(), TilesError> {
    let has_extra = origin.extra.is_some() && store_example(folder, origin, input, example);
    let stored = Stored {
        crs: origin.crs.as_ref().map(|crs| match crs {
            Crs::Epsg { horizontal, vertical } => StoredCrs::Epsg(*horizontal, *vertical),
            Crs::Wkt(text) => StoredCrs::Wkt(text.clone()),
        }),
        comments: origin.comments.clone(),
        sensor: origin.sensor,
        sensors: origin.sensors.as_ref().map(|s| (s.attribute.clone(), s.places.clone())),
        orientation: origin.orientation,
        named_in: origin.named_in.as_ref().map(|named| (input, named.names.to_vec())),
        sha256: origin.sha256,
        tables: origin.tables.iter().map(stored_table).collect(),
        has_extra,
        lost: origin.extra.is_some() && !has_extra,
    };
    let path = folder.origin();
    let json = serde_json::to_vec(&stored).map_err(|why| TilesError::broken(&path, why.to_string()))?;
    write_whole(&path, &json)
}

/// Writes a small file of the input's format; false where what is read of it does not know what the input's file does.
fn store_example(
    folder: &Folder,
    origin: &Origin,
    input: Format,
    (block, attributes): (&Block, &[densecloud_cloud::Attribute]),
) -> bool {
    let write = || {
        let bytes = encode(Vec::new(), input, &block.positions, attributes, origin).ok()?;
        write_whole(&folder.example(), &bytes).ok()?;
        read_example(folder)
    };
    input.is_written() && write().is_some_and(|again| Some(again) == origin.extra)
}

fn read_example(folder: &Folder) -> Option<densecloud_cloud::Extra> {
    let file = std::fs::File::open(folder.example()).ok()?;
    CloudReader::open(BufReader::new(file), Limits::default()).ok()?.read().ok()?.origin.extra
}

/// Reads what [`store`] wrote, and whether there was more than that.
pub(crate) fn load(folder: &Folder) -> Result<(Origin, bool), TilesError> {
    let path = folder.origin();
    let bytes = std::fs::read(&path).map_err(TilesError::file(&path))?;
    let broken = |why: String| TilesError::broken(&path, why);
    let stored: Stored = serde_json::from_slice(&bytes).map_err(|why| broken(why.to_string()))?;
    let table = |table: StoredTable| loaded_table(table).ok_or_else(|| broken("a table is not one".into()));
    let extra = if stored.has_extra { read_example(folder) } else { None };
    if stored.has_extra != extra.is_some() {
        return Err(TilesError::broken(&folder.example(), "it is not as it was written"));
    }
    let origin = Origin {
        crs: stored.crs.map(|crs| match crs {
            StoredCrs::Epsg(horizontal, vertical) => Crs::Epsg { horizontal, vertical },
            StoredCrs::Wkt(text) => Crs::Wkt(text),
        }),
        comments: stored.comments,
        sensor: stored.sensor,
        sensors: stored.sensors.map(|(attribute, places)| Arc::new(Sensors { attribute, places })),
        orientation: stored.orientation,
        named_in: stored.named_in.map(|(format, names)| Named { kind: format.kind(), names: names.into() }),
        sha256: stored.sha256,
        tables: Arc::new(stored.tables.into_iter().map(table).collect::<Result<_, _>>()?),
        extra,
    };
    Ok((origin, stored.lost))
}

fn stored_table(table: &Table) -> StoredTable {
    let column = |(name, column): &(String, Column)| {
        let stored = match column {
            Column::Scalar(values) => StoredColumn::Scalar(numbers(values)),
            Column::List { lengths, items } => StoredColumn::List(numbers(lengths), numbers(items)),
        };
        (name.clone(), stored)
    };
    StoredTable {
        name: table.name.clone(),
        rows: table.rows,
        columns: table.columns.iter().map(column).collect(),
    }
}

fn loaded_table(table: StoredTable) -> Option<Table> {
    let column = |(name, column): (String, StoredColumn)| {
        let loaded = match column {
            StoredColumn::Scalar(values) => Column::Scalar(values_of(&values)?),
            StoredColumn::List(lengths, items) => {
                Column::List { lengths: values_of(&lengths)?, items: values_of(&items)? }
            }
        };
        Some((name, loaded))
    };
    let columns = table.columns.into_iter().map(column).collect::<Option<_>>()?;
    Some(Table { name: table.name, rows: table.rows, columns })
}

fn numbers(values: &Values) -> Numbers {
    let mut bytes = Vec::new();
    each_kind!(values, column => column.iter().for_each(|number| bytes.extend(number.to_le_bytes())));
    Numbers(name_of(values.kind()).to_owned(), hex::encode(bytes))
}

fn values_of(Numbers(kind, text): &Numbers) -> Option<Values> {
    let (kind, bytes) = (kind_named(kind)?, hex::decode(text).ok()?);
    let mut values = Values::new(kind);
    values.extend_from_bytes(bytes.chunks_exact(kind.size()), false);
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_stored_is_loaded() {
        let parent = tempfile::tempdir().expect("a folder");
        let folder = Folder::new(&parent.path().join("work")).expect("a folder");
        let column =
            Column::List { lengths: Values::U8(vec![2, 0]), items: Values::F32(vec![f32::NAN, 0.1]) };
        let table = Table {
            name: "camera".into(),
            rows: 2,
            columns: vec![
                ("a".into(), Column::Scalar(Values::I64(vec![i64::MAX, -1]))),
                ("b".into(), column),
            ],
        };
        let format = Format::from_extension("a.ply".as_ref()).expect("PLY");
        let origin = Origin {
            crs: Some(Crs::Wkt("A[\"b\",\r\n C]".into())),
            comments: vec!["made by \"x\"".into()],
            sensor: Some([0.1, -0.0, 1e300]),
            sensors: Some(Arc::new(Sensors { attribute: "scan".into(), places: vec![None, Some([1.0; 3])] })),
            orientation: Some([1.0, 0.0, 0.0, 0.0]),
            named_in: Some(Named { kind: format.kind(), names: ["a".to_owned()].into() }),
            sha256: Some([7; 32]),
            tables: Arc::new(vec![table]),
            extra: None,
        };
        store(&folder, &origin, format, (&Block::default(), &[])).expect("stored");
        let (loaded, lost) = load(&folder).expect("an origin");
        // NaN is not itself.
        assert_eq!((format!("{loaded:?}"), lost), (format!("{origin:?}"), false));
    }

    #[test]
    fn what_an_example_does_not_tell_is_known_to_be_lost() {
        let parent = tempfile::tempdir().expect("a folder");
        let folder = Folder::new(&parent.path().join("work")).expect("a folder");
        // Keys of other points than the example's.
        let text = "7 0 0 0 1 2 3 0.5\n9 1 0 0 1 2 3 0.5\n";
        let path = parent.path().join("points3D.txt");
        std::fs::write(&path, text).expect("a file");
        let (cloud, header) = densecloud_formats::read_cloud_file(&path).expect("a cloud");
        assert!(cloud.origin.extra.is_some());
        store(&folder, &cloud.origin, header.format, (&Block::default(), &[])).expect("stored");
        assert!(load(&folder).expect("an origin").1);
    }
}
