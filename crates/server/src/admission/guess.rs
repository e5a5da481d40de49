//! How many points a body has, where its header does not tell: a guess, until it has been read.

/// Bytes of a body that are looked at.
const SAMPLE: usize = 64 << 10;
/// Bytes of a point in a format that is no text: most have fewer, so that the guess is rather too small.
const BINARY: u64 = 32;

/// Points of a cloud of this beginning and length: of text, by the lines at its beginning; of another, by its length. O(1).
pub(crate) fn of_file(head: &[u8], length: u64) -> u64 {
    let sample = &head[..head.len().min(SAMPLE)];
    if sample.contains(&0) {
        return length / BINARY;
    }
    by(b'\n', head, length).max(by(b'\r', head, length))
}

/// Points of a tensor in JSON, by the commas at its beginning, of which each point has three.
pub(crate) fn of_json(bytes: &[u8]) -> u64 {
    by(b',', bytes, bytes.len() as u64) / 3
}

/// How often a byte comes, if it comes as often everywhere as at the beginning.
fn by(mark: u8, head: &[u8], length: u64) -> u64 {
    let sample = &head[..head.len().min(SAMPLE)];
    let found = sample.iter().filter(|&&byte| byte == mark).count();
    (found as f64 * (length as f64 / sample.len().max(1) as f64)) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_guessed_from_the_beginning() {
        let file = |bytes: &[u8]| of_file(bytes, bytes.len() as u64);
        let lines = |count: usize, line: &str| file(line.repeat(count).as_bytes());
        assert_eq!(lines(0, ""), 0);
        assert_eq!(lines(3, "1 2 3\n"), 3);
        assert_eq!(lines(3, "1 2 3\r\n"), 3);
        assert_eq!(lines(3, "1 2 3\r"), 3);
        let many = lines(100_000, "0.125 1.25 1e-3\n");
        assert!((99_900..=100_000).contains(&many), "{many}");
        assert_eq!(file(&[0; 3200]), 100);
        assert_eq!(of_file(&"1 2 3\n".repeat(50_000).into_bytes()[..60_000], 600_000), 100_000);
        let json = format!("{{\"shape\":[1000,3],\"data\":[{}0]}}", "0.5,".repeat(2999));
        assert_eq!(of_json(json.as_bytes()), 1000);
    }
}
