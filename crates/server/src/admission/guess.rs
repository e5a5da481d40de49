//! How many points a body has, where its header does not tell: a guess, until it has been read.

/// Bytes of a body that are looked at.
const SAMPLE: usize = 64 << 10;
/// Bytes of a point in a format that is no text: most have fewer, so that the guess is rather too small.
const BINARY: usize = 32;

/// Points of a cloud that is text, by the lines at its beginning; of another, by its length. O(1).
pub(crate) fn of_file(bytes: &[u8]) -> u64 {
    let sample = &bytes[..bytes.len().min(SAMPLE)];
    if sample.contains(&0) {
        return (bytes.len() / BINARY) as u64;
    }
    by(b'\n', bytes).max(by(b'\r', bytes))
}

/// Points of a tensor in JSON, by the commas at its beginning, of which each point has three.
pub(crate) fn of_json(bytes: &[u8]) -> u64 {
    by(b',', bytes) / 3
}

/// How often a byte comes, if it comes as often everywhere as at the beginning.
fn by(mark: u8, bytes: &[u8]) -> u64 {
    let sample = &bytes[..bytes.len().min(SAMPLE)];
    let found = sample.iter().filter(|&&byte| byte == mark).count();
    (found as f64 * (bytes.len() as f64 / sample.len().max(1) as f64)) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_guessed_from_the_beginning() {
        let lines = |count: usize, line: &str| of_file(line.repeat(count).as_bytes());
        assert_eq!(lines(0, ""), 0);
        assert_eq!(lines(3, "1 2 3\n"), 3);
        assert_eq!(lines(3, "1 2 3\r\n"), 3);
        assert_eq!(lines(3, "1 2 3\r"), 3);
        let many = lines(100_000, "0.125 1.25 1e-3\n");
        assert!((99_900..=100_000).contains(&many), "{many}");
        assert_eq!(of_file(&[0; 3200]), 100);
        let json = format!("{{\"shape\":[1000,3],\"data\":[{}0]}}", "0.5,".repeat(2999));
        assert_eq!(of_json(json.as_bytes()), 1000);
    }
}
