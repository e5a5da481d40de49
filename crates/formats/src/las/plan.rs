//! What a cloud is as LAS: the point format, the steps of coordinates, and where each attribute goes.

use las::Transform;
use las::point::Format;
use rayon::prelude::*;

use super::super::FormatError;
use super::super::names::NameRule;
use super::extra::{ENTRY, KINDS, kind, scale};
use super::layout::{self, Field};
use super::records::{MOST, provenance};
use super::seen::{Seen, SeenColumn};
use super::{Form, LasOrigin, LasRecord, crs};
use densecloud_cloud::{Attribute, Kind, Position, Values, each_kind};

/// Steps from an offset that are surely written: the crate rounds the bounds outwards, by less than the rest.
const FARTHEST: f64 = 2_147_483_600.0;

/// Points whose rows are a task: enough to hide what a task costs.
const PIECE: usize = 4096;

/// What goes where.
pub(super) struct Plan {
    pub(super) las: LasOrigin,
    pub(super) format: Format,
    pub(super) minor: u8,
    pub(super) axes: [Transform; 3],
    /// The least and the greatest step along each axis.
    pub(super) reach: Option<[(i32, i32); 3]>,
    columns: Vec<Column>,
    pub(super) records: Vec<LasRecord>,
    /// How many points are each of the returns 1 to 15.
    pub(super) returns: [u64; 15],
    /// Attributes in extra bytes under another name, and that name.
    pub(super) renamed: Vec<(String, String)>,
}

/// Where an attribute's numbers go, and how.
enum Column {
    /// Into a field, multiplied by a factor.
    Field { attribute: usize, field: Field, factor: f64 },
    /// As they are, from this byte of the row on.
    Plain { attribute: usize, at: usize },
    /// As an entry of the record of extra bytes says, from this byte of the row on.
    Scaled { attribute: usize, at: usize, kind: Kind, scale: f64, shift: f64 },
    /// The number 1, whatever the point.
    One { field: Field },
}

impl Plan {
    /// Scale, offset, version and types, which depend on every point.
    ///
    /// # Errors
    /// The cloud is too large for 32-bit steps, or a point's attributes do not fit into 64 KiB.
    pub(super) fn new(seen: &Seen) -> Result<Self, FormatError> {
        let origin = &seen.origin;
        let mut las = LasOrigin::of(origin).cloned().unwrap_or_else(|| fresh(seen));
        if seen.form == Form::Indexed {
            las.point_format = indexed(las.point_format);
        }
        let mut format = Format::new(las.point_format).map_err(failed)?;
        format.has_waveform = false;
        let mut records = las.records.clone();
        let crs = match seen.form {
            Form::Indexed => origin.crs.as_ref().map(|crs| crs::as_text(crs, &records)),
            Form::Plain | Form::Packed => origin.crs.clone(),
        };
        if crs::read(&records) != crs {
            records.retain(|record| !record.is_crs());
            records.extend(crs.iter().flat_map(crs::write));
        }
        records.extend(provenance(origin));

        let fields = layout::fields(format);
        let mut free = fields.clone();
        let (mut columns, mut others) = (Vec::new(), Vec::new());
        let (mut returns, mut renamed) = ([0; 15], Vec::new());
        for (attribute, column) in seen.columns.iter().enumerate() {
            let Some(i) = free.iter().position(|field| column.fits(field.name)) else {
                others.push((attribute, column));
                continue;
            };
            let field = free.swap_remove(i);
            if field.name == "return_number" {
                returns = column.returns;
            }
            columns.push(Column::Field { attribute, field, factor: column.factor });
        }
        // A return that nothing is known of is the only one; there is no return 0.
        for field in free.into_iter().filter(|f| matches!(f.name, "return_number" | "number_of_returns")) {
            if field.name == "return_number" {
                returns[0] = seen.points;
            }
            columns.push(Column::One { field });
        }
        let mut at = usize::from(format.len());
        let mut entries: Vec<Vec<u8>> = Vec::new();
        let names = extra_names(&others, &fields);
        for ((attribute, column), name) in others.into_iter().zip(names) {
            let entry = described(column, &name);
            let kind = kind(&entry).unwrap_or(column.kind);
            columns.push(match scale(&entry) {
                None => Column::Plain { attribute, at },
                Some((scale, shift)) => Column::Scaled { attribute, at, kind, scale, shift },
            });
            entries.push(entry);
            renamed.extend((column.name != name).then(|| (column.name.clone(), name)));
            at += kind.size();
        }
        let extra = at - usize::from(format.len());
        if at > usize::from(u16::MAX) {
            return Err(FormatError::NotWritten(format!("{extra} bytes of attributes a point are too many")));
        }
        // `extra` is less than `at`.
        format.extra_bytes = extra as u16;
        if !entries.is_empty() {
            records.push(LasRecord {
                user_id: "LASF_Spec".to_owned(),
                id: 4,
                description: "extra bytes".to_owned(),
                data: entries.concat(),
                is_extended: false,
            });
        }
        let needs_latest = format.is_extended
            || records.iter().any(|record| record.data.len() > MOST)
            // Older headers count five returns, though three bits hold seven.
            || returns[5..].iter().any(|count| *count > 0);
        let minor = if needs_latest { 4 } else { las.version.1.clamp(2, 4) };
        let bounds = seen.bounds.unwrap_or_default();
        let axes = transforms(bounds, seen.points, &las)?;
        // Steps are the same order as coordinates.
        let reach = [0, 1, 2].map(|i| (steps(axes[i], bounds[i].0), steps(axes[i], bounds[i].1)));
        let reach = (seen.points > 0).then_some(reach);
        Ok(Self { las, format, minor, axes, reach, columns, records, returns, renamed })
    }

    /// Puts points into rows of `stride` bytes, on the threads of the current pool. The first point's attributes are at row
    /// `from`.
    pub(super) fn fill(
        &self,
        rows: &mut [u8],
        stride: usize,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) {
        let pieces = rows.par_chunks_mut(PIECE * stride).zip(positions.par_chunks(PIECE)).enumerate();
        pieces.for_each(|(piece, (rows, positions))| {
            rows.fill(0);
            self.put_positions(rows, stride, positions);
            let from = from + piece * PIECE;
            self.columns.iter().for_each(|column| column.put(rows, stride, attributes, from));
        });
    }

    fn put_positions(&self, rows: &mut [u8], stride: usize, positions: &[Position]) {
        for (row, position) in rows.chunks_exact_mut(stride).zip(positions) {
            for ((place, axis), coordinate) in row[..12].chunks_exact_mut(4).zip(self.axes).zip(position) {
                place.copy_from_slice(&steps(axis, *coordinate).to_le_bytes());
            }
        }
    }

    /// The source's global encoding, where that is still true.
    pub(super) fn encoding(&self) -> u16 {
        const WKT: u16 = 16;
        /// Where waveforms are.
        const WAVEFORMS: u16 = 2 | 4;
        let [had, has] = [&self.las.records, &self.records].map(|r| r.iter().any(crs::is_wkt_record));
        let encoding = self.las.global_encoding & !WAVEFORMS;
        match (had, has) {
            (true, false) => encoding & !WKT,
            (_, true) if self.minor == 4 && (!had || self.format.is_extended) => encoding | WKT,
            _ => encoding,
        }
    }
}

/// The point format that COPC has for what another one has.
fn indexed(point_format: u8) -> u8 {
    match point_format {
        2 | 3 | 5 | 7 => 7,
        8 | 10 => 8,
        _ => 6,
    }
}

/// What the crate has against a cloud.
pub(super) fn failed(why: las::Error) -> FormatError {
    FormatError::NotWritten(why.to_string())
}

/// The header of a file that comes from no LAS.
fn fresh(seen: &Seen) -> LasOrigin {
    let fits = |field: &str| seen.columns.iter().any(|column| column.fits(field));
    let has_colour = ["red", "green", "blue"].into_iter().all(fits);
    let takes_text = seen.origin.crs.as_ref().is_none_or(crs::is_wkt);
    let point_format = match (takes_text || seen.form == Form::Indexed, has_colour, fits("nir")) {
        (true, true, true) => 8,
        (true, true, false) => 7,
        (true, false, _) => 6,
        (false, true, _) => 3,
        (false, false, _) => 1,
    };
    let mut system_identifier = [0; 32];
    system_identifier[..5].copy_from_slice(b"OTHER");
    // Seconds of a week, or, beyond those, standard time.
    let time = u16::from(seen.columns.iter().any(|column| column.leaves_week));
    let wkt = if takes_text { 16 } else { 0 };
    LasOrigin {
        version: (1, 4),
        point_format,
        system_identifier,
        global_encoding: time | wkt,
        ..LasOrigin::default()
    }
}

/// The names of attributes in extra bytes: no other program should take one for a field.
fn extra_names(others: &[(usize, &SeenColumn)], fields: &[Field]) -> Vec<String> {
    /// What programs call coordinates, and bytes that several fields share, if not by a field's name.
    const OTHERS: [&str; 11] = [
        "x",
        "y",
        "z",
        "bit_fields",
        "raw_classification",
        "classification_flags",
        "classflags",
        "scan_angle_rank",
        "scananglerank",
        "scanchannel",
        "infrared",
    ];
    let is_field = |name: &str| fields.iter().any(|f| f.name == name || f.name.replace('_', "") == name);
    let is_taken = |name: &str| {
        let name = name.to_ascii_lowercase();
        OTHERS.contains(&name.as_str()) || is_field(&name)
    };
    let allows = |c: char| !c.is_control() && c != char::REPLACEMENT_CHARACTER;
    let rule = NameRule { most: 32, allows, is_taken: &is_taken };
    rule.apply_to(&others.iter().map(|(i, column)| (*i, column.name.as_str())).collect::<Vec<_>>())
}

/// The entry of an attribute in the record of extra bytes: that of the source's file, or one of the attribute's own type.
fn described(column: &SeenColumn, name: &str) -> Vec<u8> {
    let mut entry = column.entry.clone().unwrap_or_else(|| {
        let mut entry = vec![0; ENTRY];
        // There are ten types.
        entry[2] = KINDS.iter().position(|kind| *kind == column.kind).map_or(0, |i| i as u8 + 1);
        entry
    });
    let place = &mut entry[4..36];
    let end = place.iter().position(|byte| *byte == 0).unwrap_or(place.len());
    if std::str::from_utf8(&place[..end]).map(str::trim) != Ok(name) {
        place.fill(0);
        place[..name.len()].copy_from_slice(name.as_bytes());
    }
    entry
}

/// A coordinate as it is stored.
fn steps(axis: Transform, coordinate: f64) -> i32 {
    // `as` saturates; the offset was chosen so that it need not.
    ((coordinate - axis.offset) / axis.scale).round() as i32
}

/// Scale and offset of each axis: the source's where all fits. If not, the same scale about another offset;
/// and for what does not come from LAS, 0.001 or the power of ten that is at most 1e-4 of the points'
/// distance (the extent over the root of their number), whichever is finer. Coarser, only if 32 bits
/// cannot hold the extent.
fn transforms(bounds: [(f64, f64); 3], points: u64, las: &LasOrigin) -> Result<[Transform; 3], FormatError> {
    let extents = bounds.map(|(min, max)| max - min);
    let largest = extents.into_iter().fold(0.0, f64::max);
    if !largest.is_finite() {
        return Err(FormatError::NotWritten("the cloud is too large for LAS".into()));
    }
    let mut chosen = [Transform::default(); 3];
    for (axis, transform) in chosen.iter_mut().enumerate() {
        let (min, max) = bounds[axis];
        let fits = |t: Transform| [min, max].iter().all(|v| ((v - t.offset) / t.scale).abs() < FARTHEST);
        let (mut scale, offset) = (las.scale[axis], las.offset[axis]);
        let is_usable = scale.is_normal() && scale > 0.0;
        if is_usable && offset.is_finite() && fits(Transform { scale, offset }) {
            *transform = Transform { scale, offset };
            continue;
        }
        if !is_usable {
            // A flat cloud lies at a height that is worth as much as its breadth.
            let extent = if extents[axis] > 0.0 { extents[axis] } else { largest };
            scale = resolution(extent, min.abs().max(max.abs()), points);
        }
        let centre = min / 2.0 + max / 2.0;
        *transform = std::iter::successors(Some(scale), |scale| Some(scale * 10.0))
            .take_while(|scale| scale.is_finite())
            .flat_map(|scale| {
                [1.0, scale].map(|unit| Transform { scale, offset: (centre / unit).floor() * unit })
            })
            .find(|t| fits(*t))
            .ok_or_else(|| FormatError::NotWritten("the cloud is too large for LAS".into()))?;
    }
    Ok(chosen)
}

/// The step for coordinates of this extent, not finer than doubles are about `farthest`.
fn resolution(extent: f64, farthest: f64, points: u64) -> f64 {
    let spacing = extent / (points as f64).sqrt();
    let step = (1e-4 * spacing).min(1e-3).max(1e-15 * farthest);
    if step == 0.0 {
        return 1e-3;
    }
    // Decimals are parsed exactly; powers are not.
    format!("1e{}", step.log10().floor()).parse().unwrap_or(1e-3)
}

impl Column {
    /// Puts the numbers from row `from` on into rows that are zero.
    fn put(&self, rows: &mut [u8], stride: usize, attributes: &[Attribute], from: usize) {
        let count = rows.len() / stride;
        match *self {
            Self::One { field } => field.put(rows, stride, std::iter::repeat_n(1.0, count)),
            Self::Field { attribute, field, factor } => {
                let values = &attributes[attribute].values;
                field.put(rows, stride, (from..from + count).map(|i| factor * values.get(i)));
            }
            Self::Plain { attribute, at } => {
                put_numbers(rows, stride, at, &attributes[attribute].values, from);
            }
            Self::Scaled { attribute, at, kind, scale, shift } => {
                let values = &attributes[attribute].values;
                let steps = (from..from + count).map(|i| (values.get(i) - shift) / scale);
                put_numbers(rows, stride, at, &Values::from_f64(kind, steps), 0);
            }
        }
    }
}

/// Puts the numbers from row `from` on at byte `at` of each row.
fn put_numbers(rows: &mut [u8], stride: usize, at: usize, values: &Values, from: usize) {
    each_kind!(values, column => {
        for (row, number) in rows.chunks_exact_mut(stride).zip(&column[from..]) {
            let bytes = number.to_le_bytes();
            row[at..at + bytes.len()].copy_from_slice(&bytes);
        }
    });
}
