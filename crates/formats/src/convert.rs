//! From one format to another: numbers in the types that the other has for what they mean.

use super::Format;
use super::names::Meanings;
use densecloud_cloud::{Attribute, Facts, Kind, Role, Values};

/// The parts of a colour; the first three make one.
const COLOUR: [Role; 4] = [Role::Red, Role::Green, Role::Blue, Role::Alpha];

impl Format {
    /// Makes a cloud from a file of this format ready for one of another: whole numbers that are stored as floats or in
    /// more bits than they need become integers where the other format has integers for what they mean, such as colours,
    /// intensities and classes in LAS, and colours in PLY. The parts of a colour have one type. Colours from 0 to 1 become such from 0 to
    /// 255, which is told.
    ///
    /// To be done before values are interpolated, so that the mean of whole numbers is one. Between files of one kind
    /// nothing changes. O(n).
    ///
    /// ```
    /// use densecloud_cloud::{Attribute, Values};
    /// use densecloud_formats::Format;
    ///
    /// let part = |name: &str, numbers: [f64; 2]| Attribute { name: name.into(), values: Values::F64(numbers.into()) };
    /// let mut attributes = vec![part("Red", [17.0, 255.0]), part("Green", [0.0, 1.0]), part("Blue", [7.0, 8.0])];
    /// let las = Format::from_extension("dense.las".as_ref()).expect("LAS");
    /// assert_eq!(Format::TEXT.adapt(&mut attributes, las), None);
    /// assert_eq!(attributes[0].values, Values::U8(vec![17, 255]));
    /// ```
    pub fn adapt(self, attributes: &mut [Attribute], to: Self) -> Option<String> {
        let adaptation = self.adaptation(attributes, &|i| Facts::of(&attributes[i].values), to);
        adaptation.apply(attributes);
        adaptation.told
    }

    /// What [`adapt`](Self::adapt) does, for attributes whose values are elsewhere: `facts` tells of each, by its place,
    /// what they are like. O(1) an attribute.
    #[must_use]
    pub fn adaptation(
        self,
        attributes: &[Attribute],
        facts: &dyn Fn(usize) -> Facts,
        to: Self,
    ) -> Adaptation {
        if self.is_like(to) {
            return Adaptation::default();
        }
        let whole = to.ask(|format| format.whole_numbers());
        let meanings = Meanings::of(attributes);
        // The places of whole numbers have this program's names in all formats.
        let place = |role: &&Role| meanings.usual(**role);
        let is_colour = |role: &&Role| COLOUR.contains(role);
        let is_whole = COLOUR[..3].iter().all(|role| whole.contains(role) && place(&role).is_some());
        let colour: Vec<usize> = whole.iter().filter(is_colour).filter_map(|role| place(&role)).collect();
        let others = whole.iter().filter(|role| !is_colour(role)).filter_map(|role| place(&role));
        let one = |place: usize| {
            let wide = is_wide(attributes[place].values.kind());
            Some((place, smallest(&[facts(place)]).filter(|_| wide)?, 1.0))
        };
        let columns: Vec<(usize, Kind, f64)> = others.filter_map(one).collect();
        let kind = |place: usize| attributes[place].values.kind();
        let colour = if is_whole { colour } else { Vec::new() };
        let mut adaptation = Adaptation { columns, told: None };
        adaptation.add_colour(&colour, &kind, facts);
        adaptation
    }
}

/// Columns that get other types in another format, and how.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Adaptation {
    /// The place of a column, its type there, and what its numbers are multiplied by.
    pub columns: Vec<(usize, Kind, f64)>,
    /// What a person should know about it, a sentence.
    pub told: Option<String>,
}

impl Adaptation {
    /// Gives columns their types: all values, or any part of them. O(n).
    pub fn apply(&self, attributes: &mut [Attribute]) {
        for (place, kind, factor) in &self.columns {
            convert(&mut attributes[*place].values, *kind, *factor);
        }
    }

    /// Gives the parts of a colour, at these places, one type of integers, if their numbers allow that.
    fn add_colour(&mut self, places: &[usize], kind: &dyn Fn(usize) -> Kind, facts: &dyn Fn(usize) -> Facts) {
        let kinds: Vec<Kind> = places.iter().map(|place| kind(*place)).collect();
        // All of none, too.
        if kinds.iter().all(|kind| *kind == kinds[0] && !is_wide(*kind)) {
            return;
        }
        let parts: Vec<Facts> = places.iter().map(|place| facts(*place)).collect();
        let is_share = kinds.iter().all(|kind| kind.is_float()) && is_share(&parts);
        let chosen =
            if is_share { Some((Kind::U8, 255.0)) } else { smallest(&parts).map(|kind| (kind, 1.0)) };
        let Some((kind, factor)) = chosen else { return };
        self.columns.extend(places.iter().map(|place| (*place, kind, factor)));
        self.told = is_share.then(|| "colours from 0 to 1 became such from 0 to 255".to_owned());
    }
}

/// Whether a column may become one of smaller numbers.
fn is_wide(kind: Kind) -> bool {
    kind.is_float() || kind.size() > 2
}

/// Whether all numbers are from 0 to 1, and not all are 0.
fn is_share(parts: &[Facts]) -> bool {
    let is_within = |part: &Facts| part.rows == part.numbers && part.least >= 0.0 && part.most <= 1.0;
    parts.iter().all(is_within) && parts.iter().any(|part| part.most > 0.0)
}

/// The smallest unsigned integer, of 8 or 16 bits, that holds the numbers of all columns; none where one of them has
/// a fraction, is negative or larger.
fn smallest(columns: &[Facts]) -> Option<Kind> {
    let is_held = |column: &Facts| {
        let is_within = column.least >= 0.0 && column.most <= f64::from(u16::MAX);
        column.rows == column.numbers && column.is_whole && is_within
    };
    let is_byte = |column: &Facts| column.most <= f64::from(u8::MAX);
    let kind = if columns.iter().all(is_byte) { Kind::U8 } else { Kind::U16 };
    columns.iter().all(is_held).then_some(kind)
}

/// Puts the numbers, multiplied by a factor, into a type that holds them.
fn convert(values: &mut Values, kind: Kind, factor: f64) {
    if values.kind() != kind || factor != 1.0 {
        *values = Values::from_f64(kind, (0..values.len()).map(|i| factor * values.get(i)));
    }
}
