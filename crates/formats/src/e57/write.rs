//! A cloud to scans.

use std::io::Seek;
use std::panic::{AssertUnwindSafe, catch_unwind};

use ::e57::{
    E57Writer, Extension, IntensityLimits, Record, RecordDataType, RecordName, RecordValue, Transform,
    Translation,
};
use sha2::{Digest, Sha256};

use super::super::FormatError;
use super::super::columns::MAX_COLUMNS;
use super::super::names::{NameRule, own_names};
use super::super::spool::Spool;
use super::{NORMALS, OURS, SCAN, STANDARD, tag};
use densecloud_cloud::{Attribute, Origin, Position, Role, Sensors, Values, each_kind};

/// A column of the file.
struct Column<'a> {
    record: Record,
    attribute: &'a Attribute,
    /// The attribute's name that it is read as, where it is one of the format's own.
    own: Option<&'static str>,
    /// What is added to whole numbers.
    shift: i64,
}

/// Names of the attributes that the format cannot hold: 64-bit integers too far apart for its own.
pub(super) fn not_held(attributes: &[Attribute]) -> Vec<String> {
    let cannot = |(i, a): &(usize, &Attribute)| *i >= MAX_COLUMNS || data_type(&a.values).is_none();
    attributes.iter().enumerate().filter(cannot).map(|(_, a)| a.name.clone()).collect()
}

/// Whether the places of sensors are lost: they stand with scans, and a cloud need not fall into those that it was of.
pub(super) fn loses_sensors(attributes: &[Attribute], origin: &Origin) -> bool {
    let is_kept = |sensors: &Sensors| sensors.attribute == SCAN && split(attributes).is_some();
    origin.sensors.as_deref().is_some_and(|sensors| !is_kept(sensors))
}

/// The attribute that splits the points into scans, and how many.
fn split(attributes: &[Attribute]) -> Option<(&Attribute, usize)> {
    let scan = attributes.iter().find(|attribute| attribute.name == SCAN)?;
    Some((scan, scans(&scan.values)?))
}

/// The points of each scan, in their order.
fn rows(points: usize, scan: Option<(&Attribute, usize)>) -> Vec<Vec<usize>> {
    let Some((scan, count)) = scan else { return vec![(0..points).collect()] };
    let mut rows = vec![Vec::new(); count];
    // All are whole numbers below the count.
    (0..points).for_each(|i| rows[scan.values.get(i) as usize].push(i));
    rows
}

/// The file, from its beginning. An attribute `scan` that numbers the points' scans from 0 splits them into scans
/// again; each stands where its sensor stood.
///
/// # Errors
/// None that a cloud can cause; but the file is made by a crate that has some.
pub(super) fn encode(
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<Spool, FormatError> {
    let made = catch_unwind(AssertUnwindSafe(|| write(positions, attributes, origin)));
    let why = match made {
        Ok(Ok(mut file)) => {
            file.rewind()?;
            return Ok(file);
        }
        Ok(Err(error)) => error.to_string(),
        Err(_) => "numbers that it has no place for".to_owned(),
    };
    Err(std::io::Error::other(format!("the cloud cannot be written as E57: {why}")).into())
}

fn write(positions: &[Position], attributes: &[Attribute], origin: &Origin) -> Result<Spool, ::e57::Error> {
    let scan = split(attributes);
    let mut columns = columns(attributes, origin);
    columns.retain(|column| scan.is_none_or(|(scan, _)| column.attribute.name != scan.name));
    let prototype: Vec<Record> = axes().into_iter().chain(columns.iter().map(|c| c.record.clone())).collect();

    let hash = content_hash(positions, attributes, origin);
    let mut file = Spool::new();
    let mut writer = E57Writer::new(&mut file, &guid(&hash, 0))?;
    writer.set_coordinate_metadata(origin.crs.as_ref().map(|crs| character_data(&crs.to_string())));
    for (namespace, url) in [NORMALS, OURS] {
        let used = |record: &Record| matches!(&record.name, RecordName::Unknown { namespace: n, .. } if n == namespace);
        if prototype.iter().any(used) {
            writer.register_extension(Extension::new(namespace, url))?;
        }
    }
    let rows = rows(positions.len(), scan);
    let places = origin.sensors.as_deref().filter(|sensors| sensors.attribute == SCAN && scan.is_some());
    let description = character_data(&origin.comments.join("\n"));
    let intensity = columns.iter().find(|c| c.record.name == RecordName::Intensity).map(limits);
    for (number, rows) in rows.iter().enumerate() {
        let mut points = writer.add_pointcloud(&guid(&hash, 1 + number as u64), prototype.clone())?;
        if scan.is_some() {
            points.set_name(Some(format!("scan {number}")));
        }
        points.set_description((!description.is_empty()).then(|| description.clone()));
        let sensor = places.map_or(origin.sensor, |places| places.of(number as f64));
        let [x, y, z] = sensor.unwrap_or_default();
        points.set_transform(
            sensor.map(|_| Transform { translation: Translation { x, y, z }, ..Transform::default() }),
        );
        if let Some(limits) = &intensity {
            points.set_intensity_limits(limits.clone());
        }
        for row in rows {
            let position = positions[*row];
            let local = [position[0] - x, position[1] - y, position[2] - z];
            let local = local.into_iter().map(RecordValue::Double);
            points.add_point(local.chain(columns.iter().map(|column| column.value(*row))).collect())?;
        }
        points.finalize()?;
    }
    writer.finalize()?;
    drop(writer);
    Ok(file)
}

fn axes() -> [Record; 3] {
    [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ]
        .map(|name| Record { name, data_type: RecordDataType::F64 })
}

/// How many scans an attribute numbers, if it numbers more than one, from 0 and without a gap.
fn scans(values: &Values) -> Option<usize> {
    /// More scans than any real file has.
    const MOST: usize = 10_000;
    if values.kind().is_float() {
        return None;
    }
    let mut seen = Vec::new();
    for i in 0..values.len() {
        let number = values.get(i);
        if !(0.0..MOST as f64).contains(&number) {
            return None;
        }
        let number = number as usize;
        if number >= seen.len() {
            seen.resize(number + 1, false);
        }
        seen[number] = true;
    }
    (seen.len() > 1 && seen.iter().all(|seen| *seen)).then_some(seen.len())
}

/// The attribute's name of each column that the format has, for those that mean such a one.
fn own(attributes: &[Attribute], origin: &Origin) -> Vec<Option<&'static str>> {
    const NORMAL: [(Role, &str); 3] = [(Role::NormalX, "nx"), (Role::NormalY, "ny"), (Role::NormalZ, "nz")];
    let all: Vec<(Role, &str)> =
        STANDARD.iter().map(|(_, role, name)| (*role, *name)).chain(NORMAL).collect();
    own_names(attributes, origin, "e57", &all)
}

/// A name of any characters.
const RULE: NameRule = NameRule { most: usize::MAX, allows: |_| true, is_taken: &|_| false };

/// As [`Choices::renamed`](super::super::kind::Choices::renamed).
pub(super) fn renamed(attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
    let columns = columns(attributes, origin);
    let pairs = columns.iter().filter_map(|column| match &column.record.name {
        RecordName::Unknown { namespace, name } if namespace == OURS.0 => {
            Some((column.attribute.name.clone(), name.clone()))
        }
        _ => None,
    });
    pairs.filter(|(from, to)| from != to).collect()
}

/// The columns of all attributes that the format holds.
fn columns<'a>(attributes: &'a [Attribute], origin: &Origin) -> Vec<Column<'a>> {
    let own = own(attributes, origin);
    let held = |name: &str| {
        let place = own.iter().position(|own| *own == Some(name))?;
        Some(&attributes[place].values).filter(|values| data_type(values).is_some())
    };
    let mut columns: Vec<Column> = Vec::new();
    for (attribute, own) in attributes.iter().zip(&own).take(MAX_COLUMNS) {
        let Some(mut data_type) = data_type(&attribute.values) else { continue };
        let own = own.and_then(|own| Some((own, own_column(own, &attribute.values, held)?)));
        let mut shift = 0;
        match (own.as_ref().map(|(_, record)| record), &mut data_type) {
            (Some(RecordName::ReturnIndex), RecordDataType::Integer { min, max }) => {
                (shift, *min, *max) = (-1, 0, max.saturating_sub(1));
            }
            (Some(record), _) if is_flag(record) => data_type = RecordDataType::Integer { min: 0, max: 1 },
            _ => {}
        }
        let (own, name) = own.map_or((None, unknown(OURS.0, "")), |(own, record)| (Some(own), record));
        columns.push(Column { record: Record { name, data_type }, attribute, own, shift });
    }
    // The others have no name that one of the format's own columns is read as.
    let names: Vec<&str> =
        columns.iter().map(|column| column.own.unwrap_or(&column.attribute.name)).collect();
    let names = RULE.apply(&names);
    for (column, name) in columns.iter_mut().zip(names).filter(|(column, _)| column.own.is_none()) {
        column.record.name = unknown(OURS.0, &tag(&name));
    }
    columns
}

/// The column of the format's own that is read as an attribute of this name, if it takes these values beside others that are
/// `held`.
fn own_column<'a>(
    own: &str,
    values: &Values,
    held: impl Fn(&str) -> Option<&'a Values>,
) -> Option<RecordName> {
    if let Some((record, ..)) = STANDARD.iter().find(|(.., name)| *name == own) {
        return fits(record, values, held).then(|| record.clone());
    }
    let has_normals = ["nx", "ny", "nz"].iter().all(|name| held(name).is_some());
    has_normals.then(|| unknown(NORMALS.0, &format!("normal{}", own[1..].to_uppercase())))
}

/// A column of an extension.
fn unknown(namespace: &str, name: &str) -> RecordName {
    RecordName::Unknown { namespace: namespace.to_owned(), name: name.to_owned() }
}

/// Whether these values can stand in a column of the format's own, beside others that are `held`.
fn fits<'a>(record: &RecordName, values: &Values, held: impl Fn(&str) -> Option<&'a Values>) -> bool {
    let whole = |values: &Values, lowest: f64, highest: f64| {
        let within = |i| (lowest..=highest).contains(&values.get(i));
        !values.kind().is_float() && (0..values.len()).all(within)
    };
    let any = |values: &Values| whole(values, f64::MIN, f64::MAX);
    let flag = whole(values, 0.0, 1.0);
    let colours = || ["red", "green", "blue"].iter().all(|name| held(name).is_some());
    match record {
        RecordName::ColorRed | RecordName::ColorGreen | RecordName::ColorBlue => colours(),
        RecordName::IsColorInvalid => flag && colours(),
        RecordName::IsIntensityInvalid => flag && held("intensity").is_some(),
        RecordName::IsTimeStampInvalid => flag && held("timestamp").is_some(),
        RecordName::RowIndex | RecordName::ColumnIndex => any(values),
        RecordName::ReturnIndex | RecordName::ReturnCount => {
            held("return_number").is_some_and(|numbers| whole(numbers, 1.0, f64::MAX))
                && held("number_of_returns").is_some_and(any)
        }
        _ => true,
    }
}

fn is_flag(record: &RecordName) -> bool {
    matches!(
        record,
        RecordName::IsColorInvalid | RecordName::IsIntensityInvalid | RecordName::IsTimeStampInvalid
    )
}

/// The type of a column that reads back as the same; none where the numbers span more than 63 bits.
fn data_type(values: &Values) -> Option<RecordDataType> {
    let (min, max) = match values {
        Values::F32(_) => return Some(RecordDataType::F32),
        Values::F64(_) => return Some(RecordDataType::F64),
        Values::I8(_) => (i8::MIN.into(), i8::MAX.into()),
        Values::U8(_) => (0, u8::MAX.into()),
        Values::I16(_) => (i16::MIN.into(), i16::MAX.into()),
        Values::U16(_) => (0, u16::MAX.into()),
        Values::I32(_) => (i32::MIN.into(), i32::MAX.into()),
        Values::U32(_) => (0, u32::MAX.into()),
        // A range beyond that of 32 bits, and no wider than the numbers need.
        Values::I64(v) => {
            (v.iter().copied().fold(i64::from(i32::MIN) - 1, i64::min), v.iter().copied().fold(0, i64::max))
        }
        Values::U64(v) => {
            let most = v.iter().copied().fold(u64::from(u32::MAX) + 1, u64::max);
            (0, i64::try_from(most).ok()?)
        }
    };
    i64::checked_sub(max, min)?;
    Some(RecordDataType::Integer { min, max })
}

impl Column<'_> {
    fn value(&self, i: usize) -> RecordValue {
        match &self.attribute.values {
            Values::F32(v) => RecordValue::Single(v[i]),
            Values::F64(v) => RecordValue::Double(v[i]),
            Values::I64(v) => RecordValue::Integer(v[i] + self.shift),
            // Within the range of signed ones, as `data_type` says.
            Values::U64(v) => RecordValue::Integer(v[i] as i64 + self.shift),
            // Exact: 32 bits at most.
            other => RecordValue::Integer(other.get(i) as i64 + self.shift),
        }
    }
}

/// The range of the numbers, which viewers need for shades of grey.
fn limits(column: &Column) -> Option<IntensityLimits> {
    let number = |i: usize| column.attribute.values.get(i);
    let all = || (0..column.attribute.values.len()).filter(|i| number(*i).is_finite());
    let lowest = all().min_by(|a, b| number(*a).total_cmp(&number(*b)))?;
    let highest = all().max_by(|a, b| number(*a).total_cmp(&number(*b)))?;
    let (lowest, highest) = (column.value(lowest), column.value(highest));
    Some(IntensityLimits { intensity_min: Some(lowest), intensity_max: Some(highest) })
}

/// Text without what would end it in XML, or what XML does not allow.
fn character_data(text: &str) -> String {
    let allowed = |c: &char| !c.is_control() && !matches!(c, '\u{FFFE}' | '\u{FFFF}') || *c == '\n';
    text.chars().filter(allowed).collect::<String>().replace("]]>", "]] >")
}

/// A hash of all that is written: the same cloud has the same identifiers.
fn content_hash(positions: &[Position], attributes: &[Attribute], origin: &Origin) -> [u8; 32] {
    let mut hash = Sha256::new();
    for coordinate in positions.as_flattened() {
        hash.update(coordinate.to_le_bytes());
    }
    for attribute in attributes {
        hash.update(attribute.name.as_bytes());
        each_kind!(&attribute.values, column => column.iter().for_each(|v| hash.update(v.to_le_bytes())));
    }
    hash.update(format!("{:?} {:?} {:?}", origin.crs, origin.comments, origin.sensor));
    if let Some(sensors) = &origin.sensors {
        hash.update(format!("{sensors:?}"));
    }
    hash.finalize().into()
}

/// An identifier of version 8 (RFC 9562), which is for those made by rules of one's own.
fn guid(content: &[u8; 32], part: u64) -> String {
    let mut bytes: [u8; 32] =
        Sha256::new().chain_update(content).chain_update(part.to_le_bytes()).finalize().into();
    bytes[6] = bytes[6] & 0x0F | 0x80;
    bytes[8] = bytes[8] & 0x3F | 0x80;
    let hex =
        |range: std::ops::Range<usize>| bytes[range].iter().map(|b| format!("{b:02x}")).collect::<String>();
    format!("{{{}-{}-{}-{}-{}}}", hex(0..4), hex(4..6), hex(6..8), hex(8..10), hex(10..16))
}
