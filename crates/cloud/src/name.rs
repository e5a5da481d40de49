//! A column's name without what programs put about it.

/// A name in comparable forms.
pub(crate) struct Name {
    /// What it may be looked up as, in this order: in lower case, without separators.
    keys: Vec<String>,
}

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

/// Units, where they stand as a word at the end.
const UNITS: [&str; 26] = [
    "m", "mm", "cm", "km", "meter", "meters", "metre", "metres", "ft", "feet", "usft", "ftus", "deg",
    "degree", "degrees", "rad", "radians", "s", "sec", "seconds", "ms", "us", "ns", "db", "dn", "nm",
];

impl Name {
    /// Whole, without unit, the same without each word that is a prefix; then the same without what stands in brackets at its end.
    /// Only the number or the letter of a component counts there: not `m` in `X (m)`.
    pub(crate) fn of(name: &str) -> Self {
        let name = name.trim().trim_matches(['"', '\'']).trim_end().to_lowercase();
        let mut keys = Vec::new();
        match split_remark(&name) {
            Some((before, remark)) => {
                if remark.parse::<u16>().is_ok() || ["x", "y", "z"].contains(&remark) {
                    add_keys(&name, &mut keys);
                }
                add_keys(before, &mut keys);
            }
            None => add_keys(&name, &mut keys),
        }
        Self { keys }
    }

    /// What it may be looked up as, the likeliest first.
    pub(crate) fn keys(&self) -> impl Iterator<Item = &str> {
        self.keys.iter().map(String::as_str)
    }

    /// Whether it may be looked up as this.
    pub(crate) fn is(&self, key: &str) -> bool {
        self.keys.iter().any(|own| own == key)
    }
}

fn add_keys(name: &str, keys: &mut Vec<String>) {
    let words: Vec<&str> =
        name.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
    let count = words.len();
    let prefix =
        words.iter().take(count.saturating_sub(1)).take_while(|word| PREFIXES.contains(word)).count();
    for from in 0..=prefix {
        let unit = count > from + 1 && words.last().is_some_and(|word| UNITS.contains(word));
        for to in [count, count - usize::from(unit)] {
            let key = words[from..to].concat();
            if !keys.contains(&key) {
                keys.push(key);
            }
        }
    }
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
        let keys = |name: &str| Name::of(name).keys;
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
}
