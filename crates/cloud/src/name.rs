//! A column's name without what programs put about it.

/// A name in comparable form: words in lower case.
pub(crate) struct Name {
    words: Vec<String>,
    /// How many words at the beginning are a program's own.
    prefix: usize,
    /// How many words at the end are a unit.
    unit: usize,
}

/// Words that programs put before every name, or every name of a kind.
const PREFIXES: [&str; 13] = [
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
];

/// Units, where they stand as a word at the end.
const UNITS: [&str; 26] = [
    "m", "mm", "cm", "km", "meter", "meters", "metre", "metres", "ft", "feet", "usft", "ftus", "deg",
    "degree", "degrees", "rad", "radians", "s", "sec", "seconds", "ms", "us", "ns", "db", "dn", "nm",
];

impl Name {
    pub(crate) fn of(name: &str) -> Self {
        let name = without_remark(name).to_lowercase();
        let words = name.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
        let words: Vec<String> = words.map(str::to_owned).collect();
        let last = words.len().saturating_sub(1);
        let prefix = words.iter().take(last).take_while(|word| PREFIXES.contains(&word.as_str())).count();
        let is_unit = |word: &&String| UNITS.contains(&word.as_str());
        let unit = usize::from(last > prefix && words.last().filter(is_unit).is_some());
        Self { words, prefix, unit }
    }

    /// What it may be looked up as: whole, without unit, without prefix, and without both.
    pub(crate) fn keys(&self) -> impl Iterator<Item = String> {
        let count = self.words.len();
        let whole = (0..count, 0..count - self.unit.min(count));
        let ranges = [whole.0, whole.1, self.prefix..count, self.prefix..count - self.unit.min(count)];
        ranges.into_iter().map(|range| self.words[range].concat())
    }

    /// Whether it may be looked up as this.
    pub(crate) fn is(&self, key: &str) -> bool {
        self.keys().any(|own| own == key)
    }
}

/// The name without what stands in brackets at its end, unless this is the number or the letter of a component.
fn without_remark(name: &str) -> &str {
    let name = name.trim().trim_matches(['"', '\'']).trim_end();
    let open = match name.chars().next_back() {
        Some(')') => '(',
        Some(']') => '[',
        _ => return name,
    };
    let Some(from) = name.rfind(open) else { return name };
    let remark = name[from + 1..name.len() - 1].trim();
    let is_component = remark.parse::<u16>().is_ok() || ["x", "y", "z", "X", "Y", "Z"].contains(&remark);
    if is_component || from == 0 { name } else { &name[..from] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_looked_up_whole_first_and_then_without_what_is_about_it() {
        let keys = |name: &str| Name::of(name).keys().collect::<Vec<_>>();
        assert_eq!(keys("scalar_Gps-Time [s]"), ["scalargpstime", "scalargpstime", "gpstime", "gpstime"]);
        assert_eq!(keys("vertex.x_m"), ["vertexxm", "vertexx", "xm", "x"]);
        assert_eq!(keys("point_id"), ["pointid", "pointid", "id", "id"]);
        assert_eq!(keys("normals[0]"), ["normals0"; 4]);
        assert_eq!(keys("scalar"), ["scalar"; 4]);
        assert_eq!(keys("m"), ["m"; 4]);
        assert_eq!(keys("[m]"), ["m"; 4]);
        assert_eq!(keys(""), [""; 4]);
        assert_eq!(keys("ring)"), ["ring"; 4]);
        assert_eq!(keys("\u{feff}\"X\" "), ["x"; 4]);
        assert!(Name::of("scalar_R").is("r") && !Name::of("scalar_R").is("g"));
    }
}
