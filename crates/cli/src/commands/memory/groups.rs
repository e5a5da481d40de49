//! Limits of the control groups that the process is in: its own and all above it, of version 1 and 2.

use std::fs;
use std::path::{Component, Path, PathBuf};

/// Bytes that the process's groups leave it: the least of what each of them does; none where none has a limit. `root` is
/// where the file system begins.
///
/// A service's limit (`MemoryMax=`, a container's) is often on a group above the process's own, so all up to where the
/// groups are mounted are asked.
pub(super) fn left(root: &Path) -> Option<u64> {
    let read = |path: &str| fs::read_to_string(root.join(path)).unwrap_or_default();
    let (groups, mounts) = (read("proc/self/cgroup"), read("proc/self/mountinfo"));
    let mounts: Vec<Mount> = mounts.lines().filter_map(Mount::read).collect();
    let hierarchies = groups.lines().filter_map(group);
    hierarchies.filter_map(|(version, path)| least(root, &mounts, version, path)).min()
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Version {
    One,
    Two,
}

/// The version and the path of a line `number:controllers:path` of `/proc/self/cgroup`, where memory may be limited by it.
fn group(line: &str) -> Option<(Version, &Path)> {
    let mut parts = line.splitn(3, ':');
    let (number, controllers, path) = (parts.next()?, parts.next()?, Path::new(parts.next()?));
    match controllers {
        "" if number == "0" => Some((Version::Two, path)),
        _ if controllers.split(',').any(|one| one == "memory") => Some((Version::One, path)),
        _ => None,
    }
}

/// Where groups can be seen.
#[derive(Debug)]
struct Mount {
    version: Version,
    /// The group that is seen there; another than the first in a container.
    top: PathBuf,
    at: PathBuf,
}

impl Mount {
    /// A line of `/proc/self/mountinfo`, if it is one of groups that may limit memory.
    fn read(line: &str) -> Option<Self> {
        let (mount, system) = line.split_once(" - ")?;
        let mut fields = mount.split(' ').skip(3);
        let (top, at) = (unescaped(fields.next()?), unescaped(fields.next()?));
        let mut fields = system.split(' ');
        let (kind, options) = (fields.next()?, fields.nth(1)?);
        let version = match kind {
            "cgroup2" => Version::Two,
            "cgroup" if options.split(',').any(|option| option == "memory") => Version::One,
            _ => return None,
        };
        Some(Self { version, top, at })
    }

    /// Where a group is below the mount; nowhere where it is none of those that are seen there.
    fn below(&self, path: &Path) -> Option<PathBuf> {
        let below = path.strip_prefix(&self.top).ok()?;
        below.components().all(|part| matches!(part, Component::Normal(_))).then(|| below.to_owned())
    }
}

/// Blanks and backslashes are in a mount's paths as three octal digits.
fn unescaped(text: &str) -> PathBuf {
    let mut pieces = text.split('\\');
    let mut path = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let code = piece.get(..3).and_then(|digits| u8::from_str_radix(digits, 8).ok());
        match code.filter(u8::is_ascii) {
            Some(byte) => {
                path.push(char::from(byte));
                path.push_str(&piece[3..]);
            }
            None => path.extend(['\\'].into_iter().chain(piece.chars())),
        }
    }
    path.into()
}

/// What the group at `path` and those above it leave.
fn least(root: &Path, mounts: &[Mount], version: Version, path: &Path) -> Option<u64> {
    let mounts: Vec<_> = mounts.iter().filter(|mount| mount.version == version).collect();
    let seen = mounts.iter().find_map(|mount| Some((*mount, mount.below(path)?)));
    // A container may see its own group, and nothing of its path, at the mount's top.
    let (mount, below) = seen.or_else(|| mounts.first().map(|mount| (*mount, PathBuf::new())))?;
    let top = root.join(mount.at.strip_prefix("/").unwrap_or(&mount.at));
    let mut least = None;
    for (i, group) in below.ancestors().map(|below| top.join(below)).enumerate() {
        let left = match version {
            Version::One if i > 0 && number(&group, "memory.use_hierarchy") == Some(0) => break,
            Version::One => left_in_one(&group),
            Version::Two => left_in_two(&group),
        };
        least = [least, left].into_iter().flatten().min();
    }
    least
}

/// What one group of version 2 leaves. At `memory.high` it would be slowed down until it stands still.
fn left_in_two(group: &Path) -> Option<u64> {
    let limit = [number(group, "memory.max"), number(group, "memory.high")].into_iter().flatten().min()?;
    Some(left_of(limit, number(group, "memory.current"), stat(group, "inactive_file")))
}

/// What one group of version 1 leaves; its statistics also know the limits of groups above that are not seen.
fn left_in_one(group: &Path) -> Option<u64> {
    let own = number(group, "memory.limit_in_bytes");
    let limit = [own, stat(group, "hierarchical_memory_limit")].into_iter().flatten().min()?;
    Some(left_of(limit, number(group, "memory.usage_in_bytes"), stat(group, "total_inactive_file")))
}

/// Pages of files that nobody has used for a while are given up before anything else, so they count as free.
fn left_of(limit: u64, used: Option<u64>, cached: Option<u64>) -> u64 {
    limit.saturating_sub(used.unwrap_or(0).saturating_sub(cached.unwrap_or(0)))
}

/// The number in a group's file; none for `max`, and where there is no such file.
fn number(group: &Path, file: &str) -> Option<u64> {
    fs::read_to_string(group.join(file)).ok()?.trim().parse().ok()
}

/// One of a group's statistics.
fn stat(group: &Path, name: &str) -> Option<u64> {
    let text = fs::read_to_string(group.join("memory.stat")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '))?;
    line.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIB: u64 = 1 << 20;
    /// What version 1 has where there is no limit.
    const UNLIMITED: &str = "9223372036854771712\n";
    const V2: &str = "25 1 0:22 / /sys/fs/cgroup rw,nosuid - cgroup2 cgroup2 rw,nsdelegate\n";
    const V1: &str = "30 24 0:27 / /sys/fs/cgroup/cpu,cpuacct rw - cgroup cgroup rw,cpu,cpuacct\n\
                      31 24 0:28 / /sys/fs/cgroup/memory rw shared:9 - cgroup cgroup rw,memory\n";

    /// A file system of these groups, mounts, and files below `/sys/fs/cgroup`.
    fn tree(groups: &str, mounts: &str, files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |path: &str, text: &str| {
            let path = folder.path().join(path);
            fs::create_dir_all(path.parent().expect("a parent")).expect("folders");
            fs::write(path, text).expect("a file");
        };
        write("proc/self/cgroup", groups);
        write("proc/self/mountinfo", &format!("22 1 8:1 / / rw - ext4 /dev/sda1 rw\n{mounts}"));
        for (path, text) in files {
            write(&format!("sys/fs/cgroup/{path}"), text);
        }
        folder
    }

    fn of(groups: &str, mounts: &str, files: &[(&str, &str)]) -> Option<u64> {
        left(tree(groups, mounts, files).path())
    }

    #[test]
    fn a_services_own_limit_is_seen_and_the_lowest_above_it() {
        // systemd's MemoryMax= of a unit.
        let unit = "0::/system.slice/densecloud.service\n";
        let own = ("system.slice/densecloud.service/memory.max", "209715200\n");
        assert_eq!(of(unit, V2, &[own]), Some(200 * MIB));
        let slice = ("system.slice/memory.max", "104857600\n");
        assert_eq!(of(unit, V2, &[own, slice]), Some(100 * MIB));
        let used = ("system.slice/memory.current", "94371840\n");
        assert_eq!(of(unit, V2, &[own, slice, used]), Some(10 * MIB), "less what all in it have");
        let cached = ("system.slice/memory.stat", "anon 1\ninactive_file 73400320\nactive_file 5\n");
        assert_eq!(of(unit, V2, &[own, slice, used, cached]), Some(80 * MIB), "caches are given up");
        assert_eq!(of("0::/system.slice/other.service\n", V2, &[own]), None, "another's limit");
    }

    #[test]
    fn no_limit_is_none_and_one_that_slows_down_counts() {
        let group = "0::/a\n";
        let max = ("a/memory.max", "max\n");
        assert_eq!(of(group, V2, &[max]), None);
        assert_eq!(of(group, V2, &[max, ("a/memory.high", "5242880\n")]), Some(5 * MIB));
        assert_eq!(of(group, V2, &[("a/memory.max", "5"), ("a/memory.current", "9")]), Some(0));
        assert_eq!(of("", "", &[]), None);
        assert_eq!(of(group, "", &[]), None, "nothing is mounted");
        assert_eq!(left(Path::new("/nowhere")), None);
    }

    #[test]
    fn version_1_is_seen_nested_and_with_limits_out_of_sight() {
        let group = "4:memory:/srv/case\n3:cpu,cpuacct:/\n0::/\n";
        let none = ("memory/memory.limit_in_bytes", UNLIMITED);
        let own = ("memory/srv/case/memory.limit_in_bytes", UNLIMITED);
        let above = ("memory/srv/memory.limit_in_bytes", "209715200\n");
        assert_eq!(of(group, V1, &[none, own, above]), Some(200 * MIB));
        let used = ("memory/srv/memory.usage_in_bytes", "41943040\n");
        let cached = ("memory/srv/memory.stat", "inactive_file 1\ntotal_inactive_file 10485760\n");
        assert_eq!(of(group, V1, &[none, own, above, used, cached]), Some(170 * MIB));
        let hidden = ("memory/srv/case/memory.stat", "cache 0\nhierarchical_memory_limit 10485760\n");
        assert_eq!(of(group, V1, &[own, hidden]), Some(10 * MIB));
        let alone = ("memory/srv/memory.use_hierarchy", "0\n");
        let limit = ("memory/srv/case/memory.limit_in_bytes", "314572800\n");
        assert_eq!(
            of(group, V1, &[limit, above, alone]),
            Some(300 * MIB),
            "it does not count what is below it"
        );
        let unlimited = of(group, V1, &[none, own]).expect("a number");
        assert!(unlimited > 1 << 62, "more than any machine has: {unlimited}");
    }

    #[test]
    fn both_versions_beside_each_other_are_asked() {
        // As systemd's hybrid has it: memory is version 1's.
        let mounts = format!("{V1}32 24 0:29 / /sys/fs/cgroup/unified rw - cgroup2 cgroup2 rw\n");
        let one = ("memory/a/memory.limit_in_bytes", "52428800\n");
        assert_eq!(of("4:memory:/a\n0::/b\n", &mounts, &[one]), Some(50 * MIB));
        let two = ("unified/b/memory.max", "41943040\n");
        assert_eq!(of("4:memory:/a\n0::/b\n", &mounts, &[one, two]), Some(40 * MIB));
    }

    #[test]
    fn a_container_sees_its_own_group_whatever_its_path() {
        let max = ("memory.max", "104857600\n");
        // With a namespace for groups of its own.
        assert_eq!(of("0::/\n", V2, &[max]), Some(100 * MIB));
        // Without: the mount's top is the container's group.
        let mount = "25 1 0:22 /docker/ab12 /sys/fs/cgroup ro - cgroup2 cgroup ro\n";
        assert_eq!(of("0::/docker/ab12\n", mount, &[max]), Some(100 * MIB));
        let inner = ("run/memory.max", "10485760\n");
        assert_eq!(of("0::/docker/ab12/run\n", mount, &[max, inner]), Some(10 * MIB));
        // Names that only begin alike are others'.
        let other = ("3/memory.max", "10485760\n");
        assert_eq!(of("0::/docker/ab123\n", mount, &[max, other]), Some(100 * MIB));
        let one = "31 24 0:28 /docker/ab12 /sys/fs/cgroup/memory ro - cgroup cgroup rw,memory\n";
        let limit = ("memory/memory.limit_in_bytes", "104857600\n");
        assert_eq!(of("4:memory:/docker/ab12\n", one, &[limit]), Some(100 * MIB));
        // Moved out of what its namespace shows.
        assert_eq!(of("0::/../other\n", V2, &[max]), Some(100 * MIB));
    }

    #[test]
    fn of_several_mounts_that_with_the_group_is_taken_and_names_may_have_blanks() {
        let mounts = format!("24 1 0:22 /else /mnt/else rw - cgroup2 cgroup2 rw\n{V2}");
        assert_eq!(of("0::/a b/c\n", &mounts, &[("a b/c/memory.max", "1048576")]), Some(MIB));
        let mount = "25 1 0:22 /a\\040b /sys/fs/cgroup/of\\040all rw - cgroup2 cgroup2 rw\n";
        assert_eq!(of("0::/a b/c\n", mount, &[("of all/c/memory.max", "1048576")]), Some(MIB));
        assert_eq!(unescaped("/a\\134b\\9\\04"), Path::new("/a\\b\\9\\04"));
    }
}
