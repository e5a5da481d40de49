//! Scans to one cloud.

use std::io::Seek;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use ::e57::{E57Reader, PointCloud, Record, RecordName, Transform};

use super::super::columns::rounded;
use super::super::names::Apart;
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::spool::Spool;
use super::super::{Format, FormatError, Header, Limits, Place};
use super::check::{Refusal, check, check_columns, check_packets};
use super::column::{Column, flag_absent, whole};
use super::{NORMALS, SCAN, STANDARD, untag};
use densecloud_cloud::{Attribute, Cloud, Position, Sensors};

/// Bytes of the header of a file.
const HEADER: usize = 48;

/// What is known before the points are read: next to nothing, since the description is the last part of a
/// file.
pub(super) fn open(source: &mut Source<'_>) -> Result<Header, FormatError> {
    let found = source.peek(HEADER)?.len();
    if found < HEADER {
        return Err(FormatError::truncated(Place::Byte(found as u64), "the E57 header is incomplete"));
    }
    Ok(Header { format: Format::E57, points: None, attributes: Vec::new(), dropped_properties: Vec::new() })
}

/// The points of all scans, all at once: only the last of them tells how an attribute is best stored.
pub(super) struct E57Points {
    limits: Limits,
    /// Once they are read.
    ending: Option<Ending>,
}

impl E57Points {
    pub(super) fn new(limits: Limits) -> Self {
        Self { limits, ending: None }
    }
}

impl Points for E57Points {
    fn append(&mut self, source: &mut Source<'_>, _rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if self.ending.is_some() {
            return Ok(());
        }
        let cloud = read(source.stored()?, self.limits)?;
        let Cloud { positions, attributes, dropped_properties, notes, origin } = cloud;
        let (names, values): (Vec<String>, _) = attributes.into_iter().map(|a| (a.name, a.values)).unzip();
        *to = Block { positions, columns: values };
        let columns = names.into_iter().zip(&to.columns);
        let columns = columns.map(|(name, column)| Some(ColumnName { name, kind: column.kind() })).collect();
        self.ending = Some(Ending { columns, dropped_properties, notes, origin });
        Ok(())
    }

    fn finish(self: Box<Self>, _source: &mut Source<'_>) -> Result<Ending, FormatError> {
        Ok(self.ending.unwrap_or_else(|| Ending::of_text(std::iter::empty())))
    }
}

fn read(mut file: Spool, limits: Limits) -> Result<Cloud, FormatError> {
    let end = Place::Byte(file.len());
    // As much is reserved.
    if file.number::<8>(32)?.is_none_or(|length| length > file.len()) {
        return Err(FormatError::truncated(end, "the description should be longer than the file"));
    }
    // Files are made to break readers, and this one is not ours.
    catch_unwind(AssertUnwindSafe(|| decode(file, end, limits)))
        .unwrap_or_else(|_| Err(FormatError::malformed(end, "the E57 file contradicts itself")))
}

fn decode(mut file: Spool, end: Place, limits: Limits) -> Result<Cloud, FormatError> {
    let bad = |why: ::e57::Error| {
        FormatError::malformed(end, format!("not a readable E57 file: {}", reasons(&why)))
    };
    file.rewind()?;
    let scans = E57Reader::new(&mut file).map_err(bad)?.pointclouds();
    check(&scans, file.len(), limits).map_err(|why| match why {
        Refusal::TooMany(error) => error,
        Refusal::Contradiction(why) => FormatError::malformed(end, why),
    })?;
    for scan in &scans {
        check_packets(&mut file, scan)?.map_err(|why| FormatError::malformed(end, why))?;
    }
    let layouts: Result<Vec<Layout>, String> = scans.iter().map(Layout::of).collect();
    let layouts = layouts.map_err(|why| FormatError::malformed(end, why))?;
    check_columns(&scans, &layouts, file.len()).map_err(|why| FormatError::malformed(end, why))?;
    file.rewind()?;
    let mut reader = E57Reader::new(file).map_err(bad)?;
    let mut cloud = Cloud::default();
    let mut columns: Vec<Column> = Vec::new();
    let mut invalid = 0_u64;
    let mut scan_numbers = Vec::new();
    for ((scan_number, scan), layout) in (0..).zip(&scans).zip(&layouts) {
        let from = cloud.positions.len();
        let mut places = Vec::new();
        for (record, name) in &layout.columns {
            let Record { name: standard, data_type } = &scan.prototype[*record];
            // Counted from 0 in the file.
            let shift = i64::from(*standard == RecordName::ReturnIndex);
            places.push((*record, Column::place(&mut columns, name, data_type, shift, from), shift));
        }
        let pose = Pose::of(scan.transform.as_ref());
        for point in reader.pointcloud_raw(scan).map_err(bad)? {
            let point = point.map_err(bad)?;
            let number = |record: usize| point[record].to_f64(&scan.prototype[record].data_type);
            if let Some(state) = layout.invalid
                && number(state).map_err(bad)? != 0.0
            {
                invalid += 1;
                continue;
            }
            let [a, b, c] = layout.position;
            let local = [number(a).map_err(bad)?, number(b).map_err(bad)?, number(c).map_err(bad)?];
            let local = if layout.spherical { from_spherical(local) } else { local };
            cloud.positions.push(pose.apply(local));
            for (record, column, shift) in &places {
                columns[*column].push(&point[*record], number(*record).map_err(bad)?, *shift);
            }
        }
        let to = cloud.positions.len();
        for column in &mut columns {
            column.fill(to);
        }
        pose.turn_normals(&mut columns, from);
        if let Some(text) = &scan.description {
            for line in text.lines() {
                let known = cloud.origin.comments.iter().any(|comment| comment == line.trim());
                if !known {
                    cloud.origin.comment(line);
                }
            }
        }
        scan_numbers.resize(to, scan_number);
    }
    let place = |scan: &PointCloud| {
        scan.transform.as_ref().map(|t| [t.translation.x, t.translation.y, t.translation.z])
    };
    let places: Vec<Option<Position>> = scans.iter().map(place).collect();
    let text = reader.coordinate_metadata().map(str::trim).filter(|text| !text.is_empty());
    // Parsing cannot fail.
    cloud.origin.crs = text.and_then(|text| text.parse().ok());
    let mut apart = Apart::default();
    columns.iter().for_each(|column| _ = apart.keep(&column.name));
    let scan_name = apart.another(SCAN);
    match places.as_slice() {
        [place] => cloud.origin.sensor = *place,
        _ if places.iter().all(Option::is_none) => {}
        _ => cloud.origin.sensors = Some(Arc::new(Sensors { attribute: scan_name.clone(), places })),
    }
    flag_absent(&mut columns, cloud.positions.len());
    for column in columns {
        if column.scans < scans.len() && !column.is_flag() {
            let fill = match column.flag() {
                Some(flag) => format!("{flag} is 1"),
                None => "nan".to_owned(),
            };
            let (name, has, all) = (&column.name, column.scans, scans.len());
            cloud.origin.comment(&format!("{name}: told by {has} of {all} scans, {fill} in the others"));
        }
        if column.rounded {
            cloud.notes.push(rounded(&column.name));
        }
        if !column.is_unused_flag() {
            cloud.attributes.push(column.into_attribute());
        }
    }
    if scans.len() > 1 {
        let values = whole(scan_numbers, 0, scans.len() as i64 - 1);
        cloud.attributes.push(Attribute { name: scan_name, values });
    }
    if invalid > 0 {
        cloud.dropped_properties.push(format!("{invalid} points that the file calls invalid"));
    }
    if !reader.images().is_empty() {
        cloud.dropped_properties.push("images".to_owned());
    }
    Ok(cloud)
}

/// All that the crate tells.
fn reasons(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(error) = source {
        text += &format!(": {error}");
        source = error.source();
    }
    text.chars().take(400).collect()
}

/// What the columns of a scan are.
pub(super) struct Layout {
    /// Places of x, y and z, or of range, azimuth and elevation.
    position: [usize; 3],
    spherical: bool,
    /// The place of what tells that a point has no position.
    invalid: Option<usize>,
    /// Places of the attributes, and their names.
    pub(super) columns: Vec<(usize, String)>,
}

impl Layout {
    fn of(scan: &PointCloud) -> Result<Self, String> {
        let find = |name: &RecordName| scan.prototype.iter().position(|record| record.name == *name);
        let all = |names: [RecordName; 3]| {
            let [a, b, c] = names.map(|name| find(&name));
            Some([a?, b?, c?])
        };
        let cartesian = all([RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ]);
        let polar =
            [RecordName::SphericalRange, RecordName::SphericalAzimuth, RecordName::SphericalElevation];
        let (position, state) = match cartesian {
            Some(position) => (position, RecordName::CartesianInvalidState),
            None => (all(polar).ok_or("a scan has no coordinates")?, RecordName::SphericalInvalidState),
        };
        let (mut places, mut names) = (Vec::new(), Vec::new());
        for (place, record) in scan.prototype.iter().enumerate() {
            let name = match &record.name {
                RecordName::Unknown { namespace, name } if namespace == NORMALS.0 => match name.as_str() {
                    "normalX" => "nx".to_owned(),
                    "normalY" => "ny".to_owned(),
                    "normalZ" => "nz".to_owned(),
                    other => other.to_owned(),
                },
                RecordName::Unknown { name, .. } => untag(name),
                standard => match STANDARD.iter().find(|(known, ..)| known == standard) {
                    Some((.., name)) => (*name).to_owned(),
                    // Coordinates, and what tells of them.
                    None => continue,
                },
            };
            places.push(place);
            names.push(name);
        }
        let columns = places.into_iter().zip(Apart::all(&names)).collect();
        Ok(Self { position, spherical: cartesian.is_none(), invalid: find(&state), columns })
    }
}

fn from_spherical([range, azimuth, elevation]: [f64; 3]) -> Position {
    let flat = range * elevation.cos();
    [flat * azimuth.cos(), flat * azimuth.sin(), range * elevation.sin()]
}

/// Where a scan stands: a rotation's rows, and a translation.
struct Pose(Option<([[f64; 3]; 3], [f64; 3])>);

impl Pose {
    fn of(transform: Option<&Transform>) -> Self {
        Self(transform.map(|Transform { rotation: q, translation: t }| {
            let norm = (q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z).sqrt();
            // A rotation of no length, or of none that can be computed with, is none.
            let usable = norm.is_finite() && norm > 0.0;
            let [w, x, y, z] =
                if usable { [q.w, q.x, q.y, q.z].map(|c| c / norm) } else { [1.0, 0.0, 0.0, 0.0] };
            let rows = [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
                [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
                [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
            ];
            (rows, [t.x, t.y, t.z])
        }))
    }

    fn apply(&self, p: Position) -> Position {
        let Some((rows, shift)) = &self.0 else { return p };
        let [x, y, z] = turn(rows, p);
        [x + shift[0], y + shift[1], z + shift[2]]
    }

    /// Turns the normals of the points from `from` on.
    fn turn_normals(&self, columns: &mut [Column], from: usize) {
        let Some((rows, _)) = &self.0 else { return };
        let places = ["nx", "ny", "nz"].map(|name| columns.iter().position(|column| column.name == name));
        let [Some(x), Some(y), Some(z)] = places else { return };
        for i in from..columns[x].len() {
            let turned = turn(rows, [x, y, z].map(|column| columns[column].get(i)));
            for (column, value) in [x, y, z].into_iter().zip(turned) {
                columns[column].set(i, value);
            }
        }
    }
}

fn turn(rows: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    rows.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}
