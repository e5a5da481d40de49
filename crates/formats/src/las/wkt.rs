//! Well-known text of systems that are known by their codes of the EPSG register: zones of UTM and degrees, in the datums that
//! most surveys have, and heights. What else there is would take megabytes.

use std::ops::RangeInclusive;

/// A datum, on the ellipsoid WGS 84 or GRS 1980.
struct Datum {
    /// The code of its degrees, and their name.
    code: u32,
    name: &'static str,
    /// Its own name and code.
    datum: (&'static str, u32),
}

const WGS_84: Datum = Datum { code: 4326, name: "WGS 84", datum: ("WGS_1984", 6326) };
const ETRS89: Datum =
    Datum { code: 4258, name: "ETRS89", datum: ("European_Terrestrial_Reference_System_1989", 6258) };
const NAD83: Datum = Datum { code: 4269, name: "NAD83", datum: ("North_American_Datum_1983", 6269) };
const NAD83_2011: Datum =
    Datum { code: 6318, name: "NAD83(2011)", datum: ("NAD83_National_Spatial_Reference_System_2011", 1116) };
const SIRGAS: Datum = Datum {
    code: 4674,
    name: "SIRGAS 2000",
    datum: ("Sistema_de_Referencia_Geocentrico_para_las_AmericaS_2000", 6674),
};
const GDA94: Datum = Datum { code: 4283, name: "GDA94", datum: ("Geocentric_Datum_of_Australia_1994", 6283) };
const GDA2020: Datum =
    Datum { code: 7844, name: "GDA2020", datum: ("Geocentric_Datum_of_Australia_2020", 1168) };

/// Zones of UTM that are numbered one after another.
struct Zones {
    codes: RangeInclusive<u32>,
    /// The zone of the first code.
    first: u32,
    is_south: bool,
    datum: Datum,
}

const fn zones(codes: RangeInclusive<u32>, first: u32, is_south: bool, datum: Datum) -> Zones {
    Zones { codes, first, is_south, datum }
}

const ZONES: [Zones; 10] = [
    zones(32_601..=32_660, 1, false, WGS_84),
    zones(32_701..=32_760, 1, true, WGS_84),
    zones(25_828..=25_838, 28, false, ETRS89),
    zones(26_901..=26_923, 1, false, NAD83),
    zones(6328..=6329, 59, false, NAD83_2011),
    zones(6330..=6348, 1, false, NAD83_2011),
    zones(31_965..=31_976, 11, false, SIRGAS),
    zones(31_977..=31_985, 17, true, SIRGAS),
    zones(28_348..=28_358, 48, true, GDA94),
    zones(7846..=7859, 46, true, GDA2020),
];

/// Heights in metres: the code, the name, and the datum's name and code.
const HEIGHTS: [(u32, &str, &str, u32); 5] = [
    (5703, "NAVD88 height", "North American Vertical Datum 1988", 5103),
    (3855, "EGM2008 height", "EGM2008 geoid", 1027),
    (5621, "EVRF2007 height", "European Vertical Reference Frame 2007", 5215),
    (5783, "DHHN92 height", "Deutsches Haupthoehennetz 1992", 5181),
    (5709, "NAP height", "Normaal Amsterdams Peil", 5109),
];

/// The text of the system of these codes; none where that is not known.
pub(super) fn of(horizontal: u32, vertical: Option<u32>) -> Option<String> {
    let (name, text) = in_zone(horizontal).or_else(|| in_degrees(horizontal))?;
    let Some(vertical) = vertical else { return Some(text) };
    let (heights, height) = height(vertical)?;
    Some(format!(r#"COMPD_CS["{name} + {heights}",{text},{height}]"#))
}

/// A name and a text.
type Named = (String, String);

fn in_zone(code: u32) -> Option<Named> {
    let Zones { codes, first, is_south, datum } = ZONES.iter().find(|zones| zones.codes.contains(&code))?;
    let zone = first + code - codes.start();
    let meridian = 6.0 * f64::from(zone) - 183.0;
    let (northing, hemisphere) = if *is_south { (10_000_000.0, "S") } else { (0.0, "N") };
    let name = match datum.name {
        name @ ("GDA94" | "GDA2020") => format!("{name} / MGA zone {zone}"),
        name => format!("{name} / UTM zone {zone}{hemisphere}"),
    };
    let numbers = [
        ("latitude_of_origin", 0.0),
        ("central_meridian", meridian),
        ("scale_factor", 0.9996),
        ("false_easting", 500_000.0),
        ("false_northing", northing),
    ];
    let numbers = numbers.map(|(name, number)| format!(r#"PARAMETER["{name}",{number}]"#)).join(",");
    let (degrees, metres, own) = (datum.degrees(), metres(), epsg(code));
    let axes = r#"AXIS["Easting",EAST],AXIS["Northing",NORTH]"#;
    let text = format!(
        r#"PROJCS["{name}",{degrees},PROJECTION["Transverse_Mercator"],{numbers},{metres},{axes},{own}]"#
    );
    Some((name, text))
}

fn in_degrees(code: u32) -> Option<Named> {
    let datum = ZONES.iter().map(|zones| &zones.datum).find(|datum| datum.code == code)?;
    Some((datum.name.to_owned(), datum.degrees()))
}

impl Datum {
    fn degrees(&self) -> String {
        let Self { code, name, datum: (datum, datum_code) } = self;
        let (ellipsoid, flattening, own) = match code {
            4326 => ("WGS 84", "298.257223563", 7030),
            _ => ("GRS 1980", "298.257222101", 7019),
        };
        let ellipsoid = format!(r#"SPHEROID["{ellipsoid}",6378137,{flattening},{}]"#, epsg(own));
        let datum = format!(r#"DATUM["{datum}",{ellipsoid},{}]"#, epsg(*datum_code));
        let meridian = format!(r#"PRIMEM["Greenwich",0,{}]"#, epsg(8901));
        let unit = format!(r#"UNIT["degree",0.0174532925199433,{}]"#, epsg(9122));
        format!(r#"GEOGCS["{name}",{datum},{meridian},{unit},{}]"#, epsg(*code))
    }
}

fn height(code: u32) -> Option<Named> {
    let (_, name, datum, datum_code) = HEIGHTS.iter().find(|(known, ..)| *known == code)?;
    let datum = format!(r#"VERT_DATUM["{datum}",2005,{}]"#, epsg(*datum_code));
    let axis = r#"AXIS["Gravity-related height",UP]"#;
    let text = format!(r#"VERT_CS["{name}",{datum},{},{axis},{}]"#, metres(), epsg(code));
    Some(((*name).to_owned(), text))
}

fn metres() -> String {
    format!(r#"UNIT["metre",1,{}]"#, epsg(9001))
}

/// A code of the register.
fn epsg(code: u32) -> String {
    format!(r#"AUTHORITY["EPSG","{code}"]"#)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zones_lie_where_they_should() {
        for (code, name, meridian, northing) in [
            (32_610, "WGS 84 / UTM zone 10N", -123, 0),
            (32_760, "WGS 84 / UTM zone 60S", 177, 10_000_000),
            (25_832, "ETRS89 / UTM zone 32N", 9, 0),
            (26_910, "NAD83 / UTM zone 10N", -123, 0),
            (6328, "NAD83(2011) / UTM zone 59N", 171, 0),
            (6339, "NAD83(2011) / UTM zone 10N", -123, 0),
            (31_965, "SIRGAS 2000 / UTM zone 11N", -117, 0),
            (31_983, "SIRGAS 2000 / UTM zone 23S", -45, 10_000_000),
            (28_355, "GDA94 / MGA zone 55", 147, 10_000_000),
            (7855, "GDA2020 / MGA zone 55", 147, 10_000_000),
        ] {
            let text = of(code, None).expect(name);
            assert!(text.starts_with(&format!("PROJCS[\"{name}\",GEOGCS[\"")), "{text}");
            assert!(text.contains(&format!("[\"central_meridian\",{meridian}]")), "{text}");
            assert!(text.contains(&format!("[\"false_northing\",{northing}]")), "{text}");
            assert!(text.ends_with(&format!("AUTHORITY[\"EPSG\",\"{code}\"]]")), "{text}");
        }
    }

    #[test]
    fn texts_are_balanced_and_heights_go_with_them() {
        let degrees = of(4326, None).expect("WGS 84");
        assert!(
            degrees.starts_with(
                "GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",SPHEROID[\"WGS 84\",6378137,298.257223563,"
            )
        );
        let both = of(25_832, Some(5783)).expect("both");
        assert!(both.starts_with("COMPD_CS[\"ETRS89 / UTM zone 32N + DHHN92 height\",PROJCS["), "{both}");
        for text in [degrees, both] {
            let count = |wanted: char| text.chars().filter(|c| *c == wanted).count();
            assert_eq!(count('['), count(']'), "{text}");
            assert_eq!(count('"') % 2, 0, "{text}");
        }
    }

    #[test]
    fn of_others_nothing_is_known() {
        for (horizontal, vertical) in [(2992, None), (32_661, None), (25_832, Some(1)), (0, None)] {
            assert_eq!(of(horizontal, vertical), None);
        }
    }
}
