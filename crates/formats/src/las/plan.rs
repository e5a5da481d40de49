//! What a cloud is as LAS: the point format, the steps of coordinates, and where each attribute goes.

use std::borrow::Cow;

use las::Transform;
use las::point::Format;

use super::super::FormatError;
use super::extra::{ENTRY, KINDS, scale};
use super::layout::{self, Field};
use super::records::{MOST, cut, provenance, text};
use super::{LasOrigin, LasRecord, crs};
use densecloud_cloud::{Attribute, Origin, Position, Values, each_kind};

/// Steps from an offset that are surely written: the crate rounds the bounds outwards, by less than the rest.
const FARTHEST: f64 = 2_147_483_600.0;

/// What goes where.
pub(super) struct Plan<'a> {
    pub(super) las: Cow<'a, LasOrigin>,
    pub(super) format: Format,
    pub(super) minor: u8,
    pub(super) axes: [Transform; 3],
    /// The least and the greatest step along each axis.
    pub(super) reach: Option<[(i32, i32); 3]>,
    pub(super) columns: Vec<Column<'a>>,
    pub(super) records: Vec<LasRecord>,
}

/// An attribute, and where its numbers go.
pub(super) struct Column<'a> {
    place: Spot,
    pub(super) values: Cow<'a, Values>,
}

enum Spot {
    Field(Field),
    /// From this byte of the row on.
    Extra(usize),
}

impl<'a> Plan<'a> {
    /// Makes a pass over all columns: scale, offset, version and types depend on every point.
    ///
    /// # Errors
    /// A coordinate is no number, or a point's attributes do not fit into 64 KiB.
    pub(super) fn new(
        positions: &[Position],
        attributes: &'a [Attribute],
        origin: &'a Origin,
    ) -> Result<Self, FormatError> {
        let las = match LasOrigin::of(origin) {
            Some(las) => Cow::Borrowed(las),
            None => Cow::Owned(fresh(attributes, origin)),
        };
        let mut format = Format::new(las.point_format).map_err(failed)?;
        format.has_waveform = false;
        let mut records = las.records.clone();
        if crs::read(&records) != origin.crs {
            records.retain(|record| !record.is_crs());
            records.extend(origin.crs.iter().flat_map(crs::write));
        }
        records.extend(provenance(origin));

        let fields = layout::fields(format);
        let mut free = fields.clone();
        let (mut columns, mut others) = (Vec::new(), Vec::new());
        for attribute in attributes {
            let values = widened(attribute);
            let field = free.iter().position(|f| f.name == attribute.name && f.holds(&values));
            match field {
                Some(i) => columns.push(Column { place: Spot::Field(free.swap_remove(i)), values }),
                None => others.push(attribute),
            }
        }
        // A return that nothing is known of is the only one; there is no return 0.
        for field in free.into_iter().filter(|f| matches!(f.name, "return_number" | "number_of_returns")) {
            let ones = Values::U8(vec![1; positions.len()]);
            columns.push(Column { place: Spot::Field(field), values: Cow::Owned(ones) });
        }
        let mut at = usize::from(format.len());
        let mut entries = Vec::new();
        for attribute in others {
            let (entry, values) = described(attribute, &las, &fields, &entries);
            entries.push(entry);
            let size = values.kind().size();
            columns.push(Column { place: Spot::Extra(at), values });
            at += size;
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
            || columns.iter().any(|c| c.is("return_number") && (0..c.values.len()).any(|i| c.values.get(i) > 5.0));
        let minor = if needs_latest { 4 } else { las.version.1.clamp(2, 4) };
        let bounds = bounds(positions)?;
        let axes = transforms(bounds, positions.len(), &las)?;
        // Steps are the same order as coordinates.
        let reach = [0, 1, 2].map(|i| (steps(axes[i], bounds[i].0), steps(axes[i], bounds[i].1)));
        let reach = (!positions.is_empty()).then_some(reach);
        Ok(Self { las, format, minor, axes, reach, columns, records })
    }

    /// Puts points into rows of `stride` bytes. The first point's attributes are at row `from`.
    pub(super) fn fill(&self, rows: &mut [u8], stride: usize, positions: &[Position], from: usize) {
        rows.fill(0);
        for (row, position) in rows.chunks_exact_mut(stride).zip(positions) {
            for ((place, axis), coordinate) in row[..12].chunks_exact_mut(4).zip(self.axes).zip(position) {
                place.copy_from_slice(&steps(axis, *coordinate).to_le_bytes());
            }
        }
        for column in &self.columns {
            column.put(rows, stride, from);
        }
    }

    /// How many points are each of the returns 1 to 15.
    pub(super) fn returns(&self) -> [u64; 15] {
        let mut returns = [0; 15];
        if let Some(column) = self.columns.iter().find(|column| column.is("return_number")) {
            for number in (0..column.values.len()).map(|i| column.values.get(i) as usize) {
                if let Some(count) = number.checked_sub(1).and_then(|i| returns.get_mut(i)) {
                    *count += 1;
                }
            }
        }
        returns
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

/// What the crate has against a cloud.
pub(super) fn failed(why: las::Error) -> FormatError {
    FormatError::NotWritten(why.to_string())
}

/// The header of a file that comes from no LAS.
fn fresh(attributes: &[Attribute], origin: &Origin) -> LasOrigin {
    let fits = |format: u8, name: &str| {
        let fields = Format::new(format).map(layout::fields).unwrap_or_default();
        let attribute = attributes.iter().find(|a| a.name == name);
        attribute.is_some_and(|a| fields.iter().any(|f| f.name == name && f.holds(&widened(a))))
    };
    let has_colour = ["red", "green", "blue"].iter().all(|name| fits(8, name));
    let point_format = match (origin.crs.as_ref().is_none_or(crs::is_wkt), has_colour, fits(8, "nir")) {
        (true, true, true) => 8,
        (true, true, false) => 7,
        (true, false, _) => 6,
        (false, true, _) => 3,
        (false, false, _) => 1,
    };
    let mut system_identifier = [0; 32];
    system_identifier[..5].copy_from_slice(b"OTHER");
    // Seconds of a week, or, beyond those, standard time.
    let week = 0.0..=604_800.0;
    let is_standard = |a: &Attribute| (0..a.values.len()).any(|i| !week.contains(&a.values.get(i)));
    let time = u16::from(attributes.iter().any(|a| a.name == "gps_time" && is_standard(a)));
    let wkt = if point_format >= 6 { 16 } else { 0 };
    LasOrigin {
        version: (1, 4),
        point_format,
        system_identifier,
        global_encoding: time | wkt,
        ..LasOrigin::default()
    }
}

/// An attribute's numbers as LAS has them: colours of 8 bits are stretched to 16.
fn widened(attribute: &Attribute) -> Cow<'_, Values> {
    match (attribute.name.as_str(), &attribute.values) {
        ("red" | "green" | "blue", Values::U8(column)) => {
            Cow::Owned(Values::U16(column.iter().map(|v| u16::from(*v) * 257).collect()))
        }
        (_, values) => Cow::Borrowed(values),
    }
}

/// The entry of an attribute in the record of extra bytes, and its numbers as they are stored: as in the
/// source's file if they fit into that, else in the attribute's own type.
fn described<'a>(
    attribute: &'a Attribute,
    las: &LasOrigin,
    fields: &[Field],
    others: &[Vec<u8>],
) -> (Vec<u8>, Cow<'a, Values>) {
    if let Some(extra) = las.extra.iter().find(|extra| extra.name == attribute.name)
        && let Some(values) = stored(&attribute.values, &extra.entry)
    {
        return (extra.entry.clone(), values);
    }
    let taken = |name: &str| {
        fields.iter().any(|f| f.name == name) || others.iter().any(|entry| text(&entry[4..36]) == name)
    };
    let mut name = cut(attribute.name.replace('\0', "_"), 32);
    let mut copies = 0;
    while taken(&name) {
        copies += 1;
        let end = "_".repeat(copies);
        name = cut(attribute.name.clone(), 32_usize.saturating_sub(copies)) + &end;
    }
    let kind = attribute.values.kind();
    let mut entry = vec![0; ENTRY];
    // There are ten types.
    entry[2] = KINDS.iter().position(|k| *k == kind).map_or(0, |i| i as u8 + 1);
    entry[4..4 + name.len()].copy_from_slice(name.as_bytes());
    (entry, Cow::Borrowed(&attribute.values))
}

/// An attribute's numbers as an entry says, rounded to its steps; none where they do not fit.
fn stored<'a>(values: &'a Values, entry: &[u8]) -> Option<Cow<'a, Values>> {
    let kind = *KINDS.get(usize::from(entry[2]).checked_sub(1)?)?;
    let Some((scale, shift)) = scale(entry) else {
        return (values.kind() == kind).then_some(Cow::Borrowed(values));
    };
    if !scale.is_normal() {
        return None;
    }
    let steps = || (0..values.len()).map(|i| (values.get(i) - shift) / scale);
    let stored = Values::from_f64(kind, steps());
    let fits = kind.is_float() || steps().enumerate().all(|(i, step)| (stored.get(i) - step).abs() <= 0.5);
    fits.then_some(Cow::Owned(stored))
}

/// The least and the greatest coordinate along each axis, 0 where there is no point.
fn bounds(positions: &[Position]) -> Result<[(f64, f64); 3], FormatError> {
    let mut bounds = [(0.0, 0.0); 3];
    for (axis, bounds) in bounds.iter_mut().enumerate() {
        let along = || positions.iter().map(|p| p[axis]);
        if let Some(bad) = along().find(|v| !v.is_finite()) {
            return Err(FormatError::NotWritten(format!("LAS has no coordinate {bad}")));
        }
        if !positions.is_empty() {
            *bounds = (along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max));
        }
    }
    Ok(bounds)
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
fn transforms(
    bounds: [(f64, f64); 3],
    points: usize,
    las: &LasOrigin,
) -> Result<[Transform; 3], FormatError> {
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
fn resolution(extent: f64, farthest: f64, points: usize) -> f64 {
    let spacing = extent / (points as f64).sqrt();
    let step = (1e-4 * spacing).min(1e-3).max(1e-15 * farthest);
    if step == 0.0 {
        return 1e-3;
    }
    // Decimals are parsed exactly; powers are not.
    format!("1e{}", step.log10().floor()).parse().unwrap_or(1e-3)
}

impl Column<'_> {
    fn is(&self, name: &str) -> bool {
        matches!(&self.place, Spot::Field(field) if field.name == name)
    }

    /// Puts the numbers from row `from` on into rows that are zero.
    fn put(&self, rows: &mut [u8], stride: usize, from: usize) {
        match self.place {
            Spot::Field(field) => {
                field.put(rows, stride, (from..self.values.len()).map(|i| self.values.get(i)));
            }
            Spot::Extra(at) => each_kind!(self.values.as_ref(), column => {
                for (row, number) in rows.chunks_exact_mut(stride).zip(&column[from..]) {
                    let bytes = number.to_le_bytes();
                    row[at..at + bytes.len()].copy_from_slice(&bytes);
                }
            }),
        }
    }
}
