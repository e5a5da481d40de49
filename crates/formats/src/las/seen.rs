//! What the header of a LAS file needs to know of all points, gathered a block at a time.

use std::ops::{Range, RangeInclusive};

use las::point::Format;
use rayon::prelude::*;

use super::super::FormatError;
use super::super::kind::{Begun, FirstPass};
use super::super::names::Meanings;
use super::extra::{self, scale};
use super::layout::{self, Field};
use super::plan::Plan;
use super::{Form, LasOrigin, crs, write};
use densecloud_cloud::{Attribute, Kind, Origin, Position, Role, Values};

/// The field of the time.
const TIME: &str = "gps_time";

/// The seconds of a week, in which older files tell the time.
const WEEK: RangeInclusive<f64> = 0.0..=604_800.0;

/// What is seen of a cloud.
pub(super) struct Seen {
    pub(super) form: Form,
    pub(super) origin: Origin,
    pub(super) points: u64,
    /// The least and the greatest coordinate along each axis.
    pub(super) bounds: Option<[(f64, f64); 3]>,
    pub(super) columns: Vec<SeenColumn>,
}

/// What is seen of an attribute.
pub(super) struct SeenColumn {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// The field that means the same, in the point formats that the file can have.
    field: Option<Field>,
    /// What the numbers are multiplied by there: colours of 8 bits are stretched to 16.
    pub(super) factor: f64,
    /// Whether the field holds all numbers.
    fits: bool,
    /// The entry of the source's extra bytes by that name, for as long as it holds all numbers.
    pub(super) entry: Option<Vec<u8>>,
    /// Whether a number is outside of the seconds of a week, where the attribute is a time.
    pub(super) leaves_week: bool,
    /// How many numbers are 1 to 15, where the attribute is the number of a return.
    pub(super) returns: [u64; 15],
}

impl Seen {
    /// Nothing, as yet, of a cloud with attributes of these names and types.
    pub(super) fn new(form: Form, attributes: &[Attribute], origin: &Origin) -> Self {
        let entry = |name: &str| {
            let extra = LasOrigin::of(origin)?.extra.iter().find(|extra| extra.name == name)?;
            Some(extra.entry.clone())
        };
        let fields = layout::fields(widest(form, origin));
        let roles: Vec<_> =
            fields.iter().filter_map(|field| Some((Role::of(field.name)?, field.name))).collect();
        let is_other_time = |name: &str, role| role == Role::Time && !is_gps_time(name, origin);
        let own = Meanings::in_kind(attributes, origin, "las").but_for(is_other_time).own_names(&roles);
        let is_colour = |own: Option<&str>| own.is_some_and(|own| ["red", "green", "blue"].contains(&own));
        let mut colours = attributes.iter().zip(&own).filter(|(_, own)| is_colour(**own));
        let has_bytes = colours.all(|(attribute, _)| attribute.values.kind() == Kind::U8);
        let column = |(attribute, own): (&Attribute, &Option<&str>)| SeenColumn {
            name: attribute.name.clone(),
            kind: attribute.values.kind(),
            field: fields.iter().find(|field| Some(field.name) == *own).copied(),
            factor: if has_bytes && is_colour(*own) { 257.0 } else { 1.0 },
            fits: true,
            entry: entry(&attribute.name),
            leaves_week: false,
            returns: [0; 15],
        };
        let columns = attributes.iter().zip(&own).map(column).collect();
        Self { form, origin: origin.clone(), points: 0, bounds: None, columns }
    }

    /// Takes note of attributes alone.
    pub(super) fn see_numbers(&mut self, attributes: &[Attribute], rows: Range<usize>) {
        let columns = self.columns.par_iter_mut().zip(attributes);
        columns.for_each(|(column, attribute)| column.see(&attribute.values, rows.clone()));
    }
}

impl FirstPass for Seen {
    fn see(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        self.points += positions.len() as u64;
        widen(&mut self.bounds, positions)?;
        self.see_numbers(attributes, from..from + positions.len());
        Ok(())
    }

    fn begin(self: Box<Self>) -> Result<Begun, FormatError> {
        write::begin(Plan::new(&self)?, self.form, self.points)
    }

    fn renamed(&self) -> Option<Vec<(String, String)>> {
        // Where there is no plan, nothing is written.
        Some(Plan::new(self).map(|plan| plan.renamed).unwrap_or_default())
    }
}

/// Makes room for further points, of which each coordinate must be a number.
fn widen(bounds: &mut Option<[(f64, f64); 3]>, positions: &[Position]) -> Result<(), FormatError> {
    if positions.is_empty() {
        return Ok(());
    }
    let mut wider = bounds.unwrap_or([(f64::INFINITY, f64::NEG_INFINITY); 3]);
    for (axis, (least, greatest)) in wider.iter_mut().enumerate() {
        for coordinate in positions.iter().map(|position| position[axis]) {
            if !coordinate.is_finite() {
                return Err(FormatError::NotWritten(format!("LAS has no coordinate {coordinate}")));
            }
            (*least, *greatest) = (least.min(coordinate), greatest.max(coordinate));
        }
    }
    *bounds = Some(wider);
    Ok(())
}

impl SeenColumn {
    fn see(&mut self, values: &Values, rows: Range<usize>) {
        let numbers = || rows.clone().map(|i| values.get(i));
        if let Some(entry) = &self.entry
            && !holds(entry, self.kind, numbers())
        {
            self.entry = None;
        }
        let Some(field) = self.field else { return };
        let factor = self.factor;
        self.fits = self.fits && field.holds(self.kind, numbers().map(|v| v * factor));
        match field.name {
            TIME => self.leaves_week = self.leaves_week || numbers().any(|v| !WEEK.contains(&v)),
            "return_number" => {
                for number in numbers() {
                    let count = (number as usize).checked_sub(1).and_then(|i| self.returns.get_mut(i));
                    count.into_iter().for_each(|count| *count += 1);
                }
            }
            _ => {}
        }
    }

    /// Whether the numbers go to the field of that name.
    pub(super) fn fits(&self, field: &str) -> bool {
        self.fits && self.field.is_some_and(|own| own.name == field)
    }
}

/// Whether an attribute that is a time is that of GPS, and not the system's clock or the time since the start: by its name,
/// or because E57 has no other for it.
fn is_gps_time(name: &str, origin: &Origin) -> bool {
    name.to_ascii_lowercase().contains("gps") || origin.is_named_in("e57")
}

/// A point format that has all fields that a cloud's file can have.
fn widest(form: Form, origin: &Origin) -> Format {
    let is_extended = match LasOrigin::of(origin) {
        _ if form == Form::Indexed => true,
        Some(las) => las.point_format >= 6,
        None => origin.crs.as_ref().is_none_or(crs::is_wkt),
    };
    // Both are formats.
    Format::new(if is_extended { 8 } else { 3 }).unwrap_or_default()
}

/// Whether numbers of a type can be stored as an entry of the record of extra bytes says, rounded to its steps.
fn holds(entry: &[u8], kind: Kind, mut numbers: impl Iterator<Item = f64>) -> bool {
    let Some(stored) = extra::kind(entry) else { return false };
    let Some((scale, shift)) = scale(entry) else { return kind == stored };
    let fits = |number: f64| {
        let step = (number - shift) / scale;
        (Values::from_f64(stored, std::iter::once(step)).get(0) - step).abs() <= 0.5
    };
    scale.is_normal() && (stored.is_float() || numbers.all(fits))
}
