//! A column's name without what programs put about it.

/// A name in comparable forms.
pub(crate) struct Name {
    /// What it may be looked up as, in this order.
    keys: Vec<Key>,
}

/// A form of a name.
#[derive(Debug, PartialEq, Eq)]
struct Key {
    /// In lower case, without separators.
    text: String,
    /// Whether words that programs put before names are left out.
    is_shortened: bool,
    /// What the unit that is left out measures.
    measure: Measure,
}

/// What a unit is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Measure {
    /// Of a length, or there is none.
    Length,
    Angle,
    Other,
}

/// The longest name that programs give to what is known here, with all that they put about it. Others mean nothing, so
/// that a hostile one costs nothing.
const LONGEST: usize = 64;

/// The most words that are left out before a name.
const MOST_PREFIXES: usize = 3;

/// Words that programs put before every name, or every name of a kind.
const PREFIXES: [&str; 15] = [
    "scalar",
    "field",
    "sf",
    "properties",
    "property",
    "vertex",
    "vertices",
    "point",
    "points",
    "pointdata",
    "attribute",
    "attributes",
    "dimension",
    "gps",
    "riegl",
];

/// Units, where they stand as a word at the end, by what they measure.
const UNITS: [(Measure, &[&str]); 3] = [
    (
        Measure::Length,
        &["m", "mm", "cm", "km", "meter", "meters", "metre", "metres", "ft", "feet", "usft", "ftus"],
    ),
    (Measure::Angle, &["deg", "degree", "degrees", "rad", "radians"]),
    (Measure::Other, &["s", "sec", "seconds", "ms", "us", "ns", "db", "dn", "nm"]),
];

impl Name {
    /// Whole, without unit, the same without each word that is a prefix; then the same without what stands in brackets at its end.
    /// Only the number or the letter of a component counts there: not `m` in `X (m)`.
    pub(crate) fn of(name: &str) -> Self {
        let name = name.trim().trim_matches(['"', '\'']).trim_end();
        if name.len() > LONGEST {
            return Self { keys: Vec::new() };
        }
        let name = name.to_lowercase();
        let mut keys = Vec::new();
        match split_remark(&name) {
            Some((before, remark)) => {
                if remark.parse::<u16>().is_ok() || ["x", "y", "z"].contains(&remark) {
                    add_keys(&name, None, &mut keys);
                }
                add_keys(before, measure(remark), &mut keys);
            }
            None => add_keys(&name, None, &mut keys),
        }
        Self { keys }
    }

    /// What it may be looked up as, the likeliest first.
    pub(crate) fn keys(&self) -> impl Iterator<Item = &str> {
        self.keys.iter().map(|key| key.text.as_str())
    }

    /// Whether it may be looked up as this.
    pub(crate) fn is(&self, key: &str) -> bool {
        self.keys.iter().any(|own| own.text == key)
    }

    /// Whether it may be looked up as this coordinate: in no unit of anything but a length (or, where coordinates are
    /// `angles`, an angle), and whole, unless it may be `shortened`.
    pub(crate) fn is_axis(&self, key: &str, angles: bool, shortened: bool) -> bool {
        self.keys.iter().any(|own| {
            let fits = own.measure == Measure::Length || angles && own.measure == Measure::Angle;
            own.text == key && fits && (shortened || !own.is_shortened)
        })
    }
}

/// Adds the forms of a name, of which a unit is left out already, if there is one `outside`.
fn add_keys(name: &str, outside: Option<Measure>, keys: &mut Vec<Key>) {
    let words: Vec<&str> =
        name.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
    let count = words.len();
    let leading = words.iter().take(count.saturating_sub(1).min(MOST_PREFIXES));
    let prefix = leading.take_while(|word| PREFIXES.contains(word)).count();
    for from in 0..=prefix {
        let unit = words.last().and_then(|word| measure(word)).filter(|_| count > from + 1);
        for (to, unit) in [(count, None), (count - usize::from(unit.is_some()), unit)] {
            let text = words[from..to].concat();
            if !keys.iter().any(|key| key.text == text) {
                let measure = unit.or(outside).unwrap_or(Measure::Length);
                keys.push(Key { text, is_shortened: from > 0, measure });
            }
        }
    }
}

/// What this unit measures, if it is one.
fn measure(unit: &str) -> Option<Measure> {
    UNITS.iter().find(|(_, units)| units.contains(&unit)).map(|(measure, _)| *measure)
}

/// What stands before the brackets at a name's end, and in them.
fn split_remark(name: &str) -> Option<(&str, &str)> {
    let (open, inner) = match name.strip_suffix(')') {
        Some(inner) => ('(', inner),
        None => ('[', name.strip_suffix(']')?),
    };
    let (before, remark) = inner.rsplit_once(open)?;
    (!before.trim().is_empty()).then_some((before, remark.trim()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_looked_up_whole_first_and_then_without_what_is_about_it() {
        let keys = |name: &str| Name::of(name).keys().map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(keys("scalar_Gps-Time [s]"), ["scalargpstime", "gpstime", "time"]);
        assert_eq!(keys("vertex.x_m"), ["vertexxm", "vertexx", "xm", "x"]);
        assert_eq!(keys("point_id"), ["pointid", "id"]);
        assert_eq!(keys("normals[0]"), ["normals0", "normals"]);
        assert_eq!(keys("Easting (X)"), ["eastingx", "easting"]);
        assert_eq!(keys("X (Easting)"), ["x"]);
        assert_eq!(keys("scalar"), ["scalar"]);
        assert_eq!(keys("m"), ["m"]);
        assert_eq!(keys("[m]"), ["m"]);
        assert_eq!(keys(""), [""]);
        assert_eq!(keys("ring)"), ["ring"]);
        assert_eq!(keys("\u{feff}\"X\" "), ["x"]);
        assert!(Name::of("scalar_R").is("r") && !Name::of("scalar_R").is("g"));
    }
    #[test]
    fn what_a_hostile_name_costs_is_bounded() {
        let long = format!("{}x", "sf.".repeat(20_000));
        assert_eq!(Name::of(&long).keys().count(), 0);
        let keys = Name::of("sf.sf.sf.sf.sf.x").keys;
        assert_eq!(
            keys.iter().map(|key| key.text.as_str()).collect::<Vec<_>>(),
            ["sfsfsfsfsfx", "sfsfsfsfx", "sfsfsfx", "sfsfx"]
        );
        assert!(Name::of("scalar_Number_Of_Returns_Of_Given_Pulse").is("numberofreturnsofgivenpulse"));
    }

    #[test]
    fn a_coordinate_is_a_length_or_an_angle() {
        let is_x = |name: &str, angles: bool| Name::of(name).is_axis("x", angles, false);
        for name in ["x", "X (m)", "x_ft", "X (Easting)"] {
            assert!(is_x(name, false), "{name}");
        }
        for name in ["x_deg", "x [rad]", "x_s", "field_x", "x (dB)"] {
            assert!(!is_x(name, false), "{name}");
        }
        assert!(is_x("x_deg", true) && !is_x("x_s", true) && Name::of("field_x").is_axis("x", false, true));
    }
}
