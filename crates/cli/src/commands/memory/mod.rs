//! How much memory there is for work.

mod groups;

use std::fs;
use std::path::Path;

/// How much memory work may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Memory {
    Auto,
    Bytes(u64),
}

impl Memory {
    /// Beside so many bytes of uploads and results.
    pub(super) fn bytes(self, held: u64) -> u64 {
        match self {
            Self::Auto => for_work(available(), held),
            Self::Bytes(bytes) => bytes,
        }
    }
}

/// `auto` or a number of bytes.
pub(super) fn parse(text: &str) -> Result<Memory, String> {
    match text {
        "auto" => Ok(Memory::Auto),
        text => text
            .parse()
            .ok()
            .filter(|&bytes| bytes > 0)
            .map(Memory::Bytes)
            .ok_or_else(|| "neither auto nor a positive number of bytes".to_owned()),
    }
}

/// Bytes that the program may still take: what the system has, or, where that is less, what its control
/// groups leave; none where neither tells.
pub fn available() -> Option<u64> {
    let system = fs::read_to_string("/proc/meminfo").ok().and_then(|text| meminfo(&text));
    [system, groups::left(Path::new("/"))].into_iter().flatten().min()
}

/// `MemAvailable` of `/proc/meminfo`, in bytes.
fn meminfo(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// Of so many bytes, those for work beside `held` bytes of uploads and results: nine tenths of what these
/// leave, but half of all at least, since they are seldom all there.
pub(super) fn for_work(available: Option<u64>, held: u64) -> u64 {
    let Some(available) = available else { return u64::MAX };
    (available.saturating_sub(held) / 10 * 9).max(available / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_has_what_uploads_and_results_leave_and_half_at_least() {
        const GIB: u64 = 1 << 30;
        assert_eq!(for_work(None, GIB), u64::MAX);
        assert_eq!(for_work(Some(22 * GIB), 2 * GIB) / GIB, 18);
        assert_eq!(for_work(Some(2 * GIB), 2 * GIB), GIB);
        assert_eq!(meminfo("MemTotal: 9 kB\nMemAvailable:    8123 kB\n"), Some(8123 * 1024));
        assert_eq!(meminfo("MemTotal: 9 kB\n"), None);
        if cfg!(target_os = "linux") {
            assert!(available().is_some_and(|bytes| bytes > 0));
        }
    }
}
