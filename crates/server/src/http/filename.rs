//! The name under which a browser saves a result (RFC 6266).

use std::fmt::Write;
use std::path::Path;

use axum::http::HeaderValue;

use densecloud_formats::Format;

/// The most characters of an upload's name that its result's has.
const LONGEST: usize = 100;

/// What a result's name has of its upload's: no folders, no ending, and nothing that some system keeps out of names.
/// Nothing where that is all of it.
pub(crate) fn stem(name: &str) -> Option<String> {
    let name = name.rsplit(['/', '\\']).next()?;
    let packed = |ending: &str| ["gz", "zst"].contains(&ending.to_ascii_lowercase().as_str());
    let name = name.rsplit_once('.').filter(|(_, ending)| packed(ending)).map_or(name, |(stem, _)| stem);
    let name = without_ending(name);
    let plain: String = name.chars().filter(|c| is_plain(*c)).take(LONGEST).collect();
    let plain = plain.trim_matches([' ', '.']);
    (!plain.is_empty()).then(|| plain.to_owned())
}

/// A name without what tells a format: `.ply`, `.copc.laz`.
fn without_ending(name: &str) -> &str {
    let Some(format) = Format::from_extension(Path::new(name)) else { return name };
    let stem = |ending: &str| {
        let at = name.len().checked_sub(ending.len()).filter(|at| name.is_char_boundary(*at))?;
        name[at..].eq_ignore_ascii_case(ending).then_some(&name[..at])
    };
    let whole = format.file_name("x");
    let other = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    whole.strip_prefix('x').and_then(stem).unwrap_or(other)
}

/// The name in a `filename*` parameter of a part's `Content-Disposition` (RFC 5987): browsers send none, but other
/// programs do for names that are not ASCII, and some without a `filename` beside it.
pub(crate) fn extended(disposition: &str) -> Option<String> {
    let lower = disposition.to_ascii_lowercase();
    let start = lower.find("filename*=")? + "filename*=".len();
    let value = disposition[start..].split(';').next()?.trim().trim_matches('"');
    let (charset, rest) = value.split_once('\'')?;
    let (_, text) = rest.split_once('\'')?;
    let bytes = decoded(text.as_bytes());
    match charset.to_ascii_lowercase().as_str() {
        "utf-8" => String::from_utf8(bytes).ok(),
        "iso-8859-1" => Some(bytes.into_iter().map(char::from).collect()),
        _ => None,
    }
}

/// Undoes percent signs; those before anything else stay.
fn decoded(mut text: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(text.len());
    while let [first, rest @ ..] = text {
        let code = rest.get(..2).filter(|_| *first == b'%').and_then(|code| hex::decode(code).ok());
        bytes.push(code.as_ref().map_or(*first, |code| code[0]));
        text = if code.is_some() { &rest[2..] } else { rest };
    }
    bytes
}

/// Not the marks that turn a name around, either, so that its ending is seen.
fn is_plain(c: char) -> bool {
    let invisible =
        matches!(c, '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}');
    !c.is_control() && !invisible && !"<>:\"|?*".contains(c)
}

/// The header `Content-Disposition` of a result of this media type, by what [`stem`] gave of its upload's name.
pub(crate) fn disposition(stem: Option<&str>, media_type: &str) -> HeaderValue {
    let kind = media_type.split(';').next().unwrap_or_default();
    let base = stem.map_or_else(|| "dense".to_owned(), |stem| format!("{stem}-dense"));
    let format = Format::from_media_type(kind.trim());
    let name = format.map_or_else(|| format!("{base}.bin"), |format| format.file_name(&base));
    // Some programs read percent signs and backslashes as the beginning of something else.
    let safe = |c: char| (c.is_ascii_graphic() || c == ' ') && !"\"\\%".contains(c);
    let ascii: String = name.chars().map(|c| if safe(c) { c } else { '_' }).collect();
    let mut value = format!("attachment; filename=\"{ascii}\"");
    if ascii != name {
        value += "; filename*=UTF-8''";
        for byte in name.bytes() {
            // Writing into a string cannot fail.
            let _ = match byte {
                byte if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) => {
                    write!(value, "{}", char::from(byte))
                }
                byte => write!(value, "%{byte:02X}"),
            };
        }
    }
    // ASCII by construction, so the fallback is never used.
    HeaderValue::from_str(&value).unwrap_or(HeaderValue::from_static("attachment"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_uploads_name_loses_folders_and_ending() {
        for (name, expected) in [
            ("scan.ply", Some("scan")),
            ("Scan.LAZ", Some("Scan")),
            ("Scan.COPC.laz", Some("Scan")),
            ("copc.laz", Some("copc")),
            ("scan.v2.xyz", Some("scan.v2")),
            ("scan.txt.gz", Some("scan")),
            ("C:\\scans\\my scan.las", Some("my scan")),
            ("/home/me/scan.ply", Some("scan")),
            ("../../etc/passwd", Some("passwd")),
            ("height 1.5m", Some("height 1.5m")),
            ("é\"*\u{202e}ylp.ply", Some("éylp")),
            ("a\r\nb.ply", Some("ab")),
            (".ply", Some("ply")),
            ("...", None),
            ("", None),
            ("scans/", None),
        ] {
            assert_eq!(stem(name).as_deref(), expected, "{name:?}");
        }
        assert_eq!(stem(&"ä".repeat(500)).expect("a name").chars().count(), LONGEST);
    }

    #[test]
    fn an_extended_name_is_read() {
        for (disposition, name) in [
            ("form-data; name=\"file\"; filename*=utf-8''%E7%82%B9.xyz", Some("点.xyz")),
            (
                "form-data; name=\"file\"; filename=\"_.xyz\"; FileName*=\"UTF-8'en'a%2B100%+.xyz\"",
                Some("a+100%+.xyz"),
            ),
            ("form-data; filename*=iso-8859-1''h%E4user.xyz; name=file", Some("häuser.xyz")),
            ("form-data; name=\"file\"; filename=\"a.xyz\"", None),
            ("form-data; filename*=utf-8''%ff", None),
            ("form-data; filename*=koi8-r''a", None),
            ("form-data; filename*=a", None),
        ] {
            assert_eq!(extended(disposition).as_deref(), name, "{disposition}");
        }
    }

    #[test]
    fn a_result_is_named_after_its_upload_and_ends_as_its_format() {
        for (stem, media_type, expected) in [
            (None, "application/x-ply", "attachment; filename=\"dense.ply\""),
            (Some("my scan"), "text/csv; charset=utf-8", "attachment; filename=\"my scan-dense.csv\""),
            (
                Some("Häuser 100%"),
                "model/e57",
                "attachment; filename=\"H_user 100_-dense.e57\"; filename*=UTF-8''H%C3%A4user%20100%25-dense.e57",
            ),
            (Some("a"), "text/x-colmap-points3d", "attachment; filename=\"points3D.txt\""),
            (Some("a"), "application/other", "attachment; filename=\"a-dense.bin\""),
        ] {
            assert_eq!(disposition(stem, media_type), expected);
        }
    }
}
