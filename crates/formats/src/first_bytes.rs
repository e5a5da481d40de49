//! Judging a file by its first bytes while the rest of it is still on its way.

use super::registry;
use super::source::BOM;

/// Bytes that are enough to recognise any format, and to read every header but the longest.
pub(super) const ENOUGH: usize = 4096;

/// What the first bytes of a file allow to judge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FirstBytes {
    /// Nothing yet.
    TooFew,
    /// The header, which is whole: what [`CloudReader::open`](super::CloudReader::open) says of these bytes, it says of
    /// the file.
    WholeHeader,
    /// A beginning, which is cut off anywhere: what is malformed in it may only be incomplete.
    CutOff,
}

impl FirstBytes {
    /// What `bytes` allow to judge, the first of a file; the last `new` of them have not been asked about before. O(new).
    ///
    /// ```
    /// use densecloud_formats::FirstBytes;
    ///
    /// let header = b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n";
    /// assert_eq!(FirstBytes::of(&header[..20], 20), FirstBytes::TooFew);
    /// assert_eq!(FirstBytes::of(header, header.len() - 20), FirstBytes::WholeHeader);
    /// assert_eq!(FirstBytes::of(&[b' '; 4096], 4096), FirstBytes::CutOff);
    /// ```
    #[must_use]
    pub fn of(bytes: &[u8], new: usize) -> Self {
        let head = bytes.strip_prefix(BOM).unwrap_or(bytes);
        let Some(end) = registry::by_bytes(head).and_then(|found| found.header_end) else {
            return if bytes.len() >= ENOUGH { Self::CutOff } else { Self::TooFew };
        };
        // One line end must follow. Only what is new is searched: a header that comes byte by byte
        // must not cost the square of its length.
        let from = bytes.len().saturating_sub(new).saturating_sub(end.len() + 1);
        let is_end = |w: &[u8]| w.starts_with(end) && w[end.len()].is_ascii_whitespace();
        if bytes[from..].windows(end.len() + 1).any(is_end) { Self::WholeHeader } else { Self::TooFew }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ply_header_is_noticed_with_its_last_byte_however_it_is_cut() {
        let header = b"ply\nformat ascii 1.0\nelement vertex 3\nend_header\n";
        for cut in [1, 2, 3, 7, header.len()] {
            let mut seen = None;
            for end in (cut..=header.len()).step_by(cut).chain([header.len()]) {
                let start = end.saturating_sub(cut);
                if FirstBytes::of(&header[..end], end - start) == FirstBytes::WholeHeader {
                    seen = Some(end);
                    break;
                }
            }
            assert_eq!(seen, Some(header.len()), "pieces of {cut}");
        }
    }

    #[test]
    fn text_is_looked_at_once_there_is_enough_of_it() {
        assert_eq!(FirstBytes::of(b"1 2 3\n", 6), FirstBytes::TooFew);
        assert_eq!(FirstBytes::of(&[b' '; ENOUGH], 1), FirstBytes::CutOff);
    }
}
