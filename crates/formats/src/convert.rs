//! From one format to another: numbers in the types that the other has for what they mean.

use super::Format;
use super::names::Meanings;
use densecloud_cloud::{Attribute, Kind, Role, Values};

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
        if self.is_like(to) {
            return None;
        }
        let whole = to.ask(|format| format.whole_numbers());
        let (colour, others) = {
            let meanings = Meanings::of(attributes);
            // The places of whole numbers have this program's names in all formats.
            let place = |role: &&Role| meanings.usual(**role);
            let is_colour = |role: &&Role| COLOUR.contains(role);
            let is_whole = COLOUR[..3].iter().all(|role| whole.contains(role) && place(&role).is_some());
            let colour: Vec<usize> = whole.iter().filter(is_colour).filter_map(|role| place(&role)).collect();
            let others: Vec<usize> =
                whole.iter().filter(|role| !is_colour(role)).filter_map(|role| place(&role)).collect();
            (if is_whole { colour } else { Vec::new() }, others)
        };
        for place in others {
            let values = &mut attributes[place].values;
            if is_wide(values.kind())
                && let Some(kind) = smallest(&[&*values])
            {
                convert(values, kind, 1.0);
            }
        }
        adapt_colour(attributes, &colour)
    }
}

/// Gives the parts of a colour, at these places, one type of integers, if their numbers allow that.
fn adapt_colour(attributes: &mut [Attribute], places: &[usize]) -> Option<String> {
    let parts: Vec<&Values> = places.iter().map(|place| &attributes[*place].values).collect();
    let kinds: Vec<Kind> = parts.iter().map(|part| part.kind()).collect();
    // All of none, too.
    if kinds.iter().all(|kind| *kind == kinds[0] && !is_wide(*kind)) {
        return None;
    }
    let is_share = kinds.iter().all(|kind| kind.is_float()) && is_share(&parts);
    let (kind, factor) = if is_share { (Kind::U8, 255.0) } else { (smallest(&parts)?, 1.0) };
    for place in places {
        convert(&mut attributes[*place].values, kind, factor);
    }
    is_share.then(|| "colours from 0 to 1 became such from 0 to 255".to_owned())
}

/// Whether a column may become one of smaller numbers.
fn is_wide(kind: Kind) -> bool {
    kind.is_float() || kind.size() > 2
}

/// Whether all numbers are from 0 to 1, and not all are 0.
fn is_share(parts: &[&Values]) -> bool {
    let numbers = || parts.iter().flat_map(|part| (0..part.len()).map(|i| part.get(i)));
    numbers().all(|number| (0.0..=1.0).contains(&number)) && numbers().any(|number| number > 0.0)
}

/// The smallest unsigned integer, of 8 or 16 bits, that holds the numbers of all columns; none where one of them has
/// a fraction, is negative or larger.
fn smallest(columns: &[&Values]) -> Option<Kind> {
    let mut largest = 0.0_f64;
    for column in columns {
        for number in (0..column.len()).map(|i| column.get(i)) {
            if number.fract() != 0.0 || !(0.0..=f64::from(u16::MAX)).contains(&number) {
                return None;
            }
            largest = largest.max(number);
        }
    }
    Some(if largest <= f64::from(u8::MAX) { Kind::U8 } else { Kind::U16 })
}

/// Puts the numbers, multiplied by a factor, into a type that holds them.
fn convert(values: &mut Values, kind: Kind, factor: f64) {
    if values.kind() != kind || factor != 1.0 {
        *values = Values::from_f64(kind, (0..values.len()).map(|i| factor * values.get(i)));
    }
}
