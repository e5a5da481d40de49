//! The coordinate reference system: well-known text, or the keys of GeoTIFF.

use super::super::names::cut;
use super::LasRecord;
use super::records::{MOST, number, text};
use super::wkt;
use densecloud_cloud::Crs;

const USER: &str = "LASF_Projection";

/// The records' numbers.
const WKT: u16 = 2112;
const KEYS: u16 = 34_735;
const TEXTS: u16 = 34_737;

/// Keys, and what stands for a system that has no code.
const MODEL: u16 = 1024;
const CITATION: u16 = 1026;
const GEOGRAPHIC: u16 = 2048;
const GEOGRAPHIC_CITATION: u16 = 2049;
const PROJECTED: u16 = 3072;
const PROJECTED_CITATION: u16 = 3073;
const VERTICAL: u16 = 4096;
const VERTICAL_CITATION: u16 = 4097;
const USER_DEFINED: u16 = 32_767;
/// What a raster's cells stand for.
const RASTER: u16 = 1025;
/// Keys for units, and what they are in the systems that [`wkt`] knows: metres and degrees.
const UNITS: [(u16, u16); 4] = [(2052, 9001), (2054, 9102), (3076, 9001), (4099, 9001)];

/// Whether a record is well-known text in its place.
pub(super) fn is_wkt_record(record: &LasRecord) -> bool {
    record.user_id.eq_ignore_ascii_case(USER) && record.id == WKT
}

fn find(records: &[LasRecord], id: u16) -> Option<&LasRecord> {
    records.iter().find(|r| r.user_id.eq_ignore_ascii_case(USER) && r.id == id)
}

/// Four numbers a key: the key, where its value is, how long it is, and the value or its place.
fn keys(records: &[LasRecord]) -> Option<Vec<[u16; 4]>> {
    let numbers = |key: &[u8]| [0, 2, 4, 6].map(|from| number::<2>(key, from) as u16);
    Some(find(records, KEYS)?.data.chunks_exact(8).skip(1).map(numbers).collect())
}

/// What the records tell: well-known text before keys, codes before names.
pub(super) fn read(records: &[LasRecord]) -> Option<Crs> {
    if let Some(record) = find(records, WKT) {
        let text = text(&record.data);
        if !text.trim().is_empty() {
            return Some(Crs::Wkt(text.trim().to_owned()));
        }
    }
    let keys = keys(records)?;
    let code = |wanted| {
        let key = keys.iter().find(|[key, place, ..]| *key == wanted && *place == 0);
        key.map(|key| key[3]).filter(|code| (1024..USER_DEFINED).contains(code)).map(u32::from)
    };
    let is_projected = keys.iter().any(|[key, ..]| *key == PROJECTED);
    if let Some(horizontal) = code(PROJECTED).or(code(GEOGRAPHIC).filter(|_| !is_projected)) {
        return Some(Crs::Epsg { horizontal, vertical: code(VERTICAL) });
    }
    let texts = find(records, TEXTS).map(|record| record.data.as_slice()).unwrap_or_default();
    let citation = |wanted| {
        let [_, _, length, from] = *keys.iter().find(|[key, place, ..]| *key == wanted && *place == TEXTS)?;
        let from = usize::from(from);
        let bytes = texts.get(from..texts.len().min(from + usize::from(length)))?;
        let text = text(bytes);
        let text = text.trim_matches(['|', ' ']);
        let text = text.strip_prefix("ESRI PE String = ").unwrap_or(text);
        (!text.is_empty()).then(|| text.to_owned())
    };
    let name = citation(PROJECTED_CITATION).or(citation(CITATION)).or(citation(GEOGRAPHIC_CITATION))?;
    name.parse().ok()
}

/// Whether well-known text tells the system; if not, it takes GeoTIFF's keys, which the standard allows in
/// point formats 0 to 5 alone.
pub(super) fn is_wkt(crs: &Crs) -> bool {
    let Crs::Wkt(text) = crs else { return false };
    let word = text.trim_start().find(|c: char| !(c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_'));
    word.is_some_and(|end| end > 2 && text.trim_start()[end..].trim_start().starts_with(['[', '(']))
}

/// The system as well-known text, where that is known, and `records` that tell it by a code tell no more.
pub(super) fn as_text(crs: &Crs, records: &[LasRecord]) -> Crs {
    let text = match crs {
        Crs::Epsg { horizontal, vertical } if is_code_alone(records) => wkt::of(*horizontal, *vertical),
        _ => None,
    };
    text.map_or_else(|| crs.clone(), Crs::Wkt)
}

/// Whether keys tell nothing but codes, names, and the usual units: some have heights in feet, or a datum of their own.
fn is_code_alone(records: &[LasRecord]) -> bool {
    let is_usual = |[key, place, _, value]: [u16; 4]| match key {
        MODEL | RASTER | GEOGRAPHIC | PROJECTED | VERTICAL => place == 0,
        CITATION | GEOGRAPHIC_CITATION | PROJECTED_CITATION | VERTICAL_CITATION => true,
        _ => UNITS.contains(&(key, value)) && place == 0,
    };
    keys(records).unwrap_or_default().into_iter().all(is_usual)
}

/// The records that tell the system.
pub(super) fn write(crs: &Crs) -> Vec<LasRecord> {
    let record = |id, description: &str, data| LasRecord {
        user_id: USER.to_owned(),
        id,
        description: description.to_owned(),
        data,
        is_extended: false,
    };
    let keys = |keys: &[[u16; 4]]| {
        let head = [1, 1, 0, keys.len() as u16];
        let numbers = head.iter().chain(keys.as_flattened());
        record(KEYS, "GeoTIFF GeoKeyDirectoryTag", numbers.flat_map(|n| n.to_le_bytes()).collect())
    };
    let valid = |code: u32| u16::try_from(code).ok().filter(|code| (1024..USER_DEFINED).contains(code));
    match crs {
        Crs::Wkt(text) if is_wkt(crs) => {
            vec![record(WKT, "OGC Coordinate System WKT", [text.as_bytes(), b"\0"].concat())]
        }
        Crs::Epsg { horizontal, vertical }
            if valid(*horizontal).is_some() && vertical.is_none_or(|code| valid(code).is_some()) =>
        {
            let horizontal = valid(*horizontal).unwrap_or_default();
            let (model, key) = if is_geographic(horizontal) { (2, GEOGRAPHIC) } else { (1, PROJECTED) };
            let mut all = vec![[MODEL, 0, 1, model], [key, 0, 1, horizontal]];
            all.extend(vertical.and_then(valid).map(|code| [VERTICAL, 0, 1, code]));
            vec![keys(&all)]
        }
        // A name, or codes that a key has no room for.
        other => {
            let text = cut(other.to_string(), MOST - 2) + "|";
            let all = [[MODEL, 0, 1, USER_DEFINED], [CITATION, TEXTS, text.len() as u16, 0]];
            let texts = record(TEXTS, "GeoTIFF GeoAsciiParamsTag", [text.as_bytes(), b"\0"].concat());
            vec![keys(&all), texts]
        }
    }
}

/// Whether a code of the EPSG register is that of a geographic system: GeoTIFF has another key for those.
/// The register numbers them 4000 to 4999, and has added a few elsewhere since; the commonest of those are here.
fn is_geographic(code: u16) -> bool {
    matches!(code, 4000..=4999 | 6318 | 6322 | 6325 | 6668 | 7844 | 8232 | 9000 | 9057 | 9755)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        for text in [
            "EPSG:2992",
            "EPSG:4326",
            "EPSG:25832+5783",
            "EPSG:102100",
            "EPSG:25832+90000",
            "Gauß-Krüger, zone 4",
            "PROJCRS[\"NAD83 / Oregon\",BASEGEOGCRS[\"x\"]]",
        ] {
            let crs: Crs = text.parse().expect("any text");
            let records = write(&crs);
            assert!(records.iter().all(LasRecord::is_crs));
            assert_eq!(records.iter().any(is_wkt_record), text.starts_with("PROJ"), "{text}");
            assert_eq!(read(&records), Some(crs), "{text}");
        }
    }

    #[test]
    fn a_code_is_told_in_words_where_it_is_all_there_is() {
        let zone = Crs::Epsg { horizontal: 32_610, vertical: None };
        let with = |more: &[[u16; 4]]| {
            let mut records = write(&zone);
            let numbers = more.as_flattened().iter().flat_map(|n| n.to_le_bytes());
            records[0].data.extend(numbers);
            assert_eq!(read(&records), Some(zone.clone()));
            as_text(&zone, &records)
        };
        let text = Crs::Wkt(wkt::of(32_610, None).expect("a zone"));
        assert_eq!(as_text(&zone, &[]), text);
        assert_eq!(with(&[[3076, 0, 1, 9001], [4099, 0, 1, 9001], [1026, 34_737, 9, 0]]), text);
        // Heights in feet, degrees of another prime meridian.
        for more in [[4099, 0, 1, 9003], [2051, 0, 1, 8903], [2057, 34_736, 1, 0]] {
            assert_eq!(with(&[more]), zone);
        }
        let feet = Crs::Epsg { horizontal: 2992, vertical: None };
        assert_eq!(as_text(&feet, &write(&feet)), feet);
    }

    #[test]
    fn keys_that_make_no_sense_tell_nothing() {
        let mut records = write(&Crs::Epsg { horizontal: 2992, vertical: None });
        records[0].data.truncate(19);
        assert_eq!(read(&records), None);
        let mut records = write(&Crs::Wkt("name".into()));
        records[1].data.clear();
        assert_eq!(read(&records), None);
        let at = records[0].data.len() - 2;
        records[0].data[at..].copy_from_slice(&[0xFF; 2]);
        assert_eq!(read(&records), None);
        assert_eq!(read(&[]), None);
    }
}
