//! Whether the disk has room for the tiles, for what is made of them, and for the result where it is made as a file first.

use densecloud::survey::Goal;
use densecloud_cloud::{Attribute, Values, bytes_a_point};
use densecloud_formats::{Block, Format};

use super::spill::Spilled;
use super::{BARE, Large};
use crate::disk::free_space;
use crate::{Folder, TilesError, Work};

/// Asks for what is known of a cloud whose first points are read: the number of points that its header tells, and the types
/// of columns. Columns without a number but zero may be none of the cloud's.
pub(super) fn check_before(input: &Large<'_>, work: &Work<'_>, folder: &Folder) -> Result<(), TilesError> {
    let (Some(points), Goal::Target(target)) = (input.header.points, work.options.goal) else {
        return Ok(());
    };
    let made = target.points_out(points)?;
    let attributes = told(&input.first);
    check(work, input.header.format, folder, &attributes, points, made, 0)
}

/// Asks for a cloud that lies on the disk.
pub(super) fn check_after(
    spilled: &Spilled,
    attributes: &[Attribute],
    ratio: f64,
    work: &Work<'_>,
    folder: &Folder,
) -> Result<(), TilesError> {
    let made = (spilled.finite as f64 * ratio) as u64;
    check(work, spilled.header.format, folder, attributes, spilled.finite, made, spilled.bytes)
}

/// `there`: bytes of the cloud that lie on the disk already, and make room for its tiles.
fn check(
    work: &Work<'_>,
    input: Format,
    folder: &Folder,
    attributes: &[Attribute],
    points: u64,
    made: u64,
    there: u64,
) -> Result<(), TilesError> {
    // Tiles have some more points than the cloud.
    let tiles = (points as f64 * (BARE + bytes_a_point(attributes)) as f64 * 1.5) as u64;
    let values = work.options.finish.bytes_a_point(attributes);
    let format = Format::of_result(work.options.format, input, true);
    let file = format.temporary_bytes(made, values);
    let parts = made.saturating_mul(24 + values);
    let needed = tiles.saturating_sub(there).saturating_add(parts).saturating_add(file);
    match free_space(folder.path()) {
        Some(free) if free < needed => {
            Err(TilesError::NoSpace { folder: folder.path().to_owned(), free, needed })
        }
        _ => Ok(()),
    }
}

/// The columns that have numbers in the first points, under no names.
fn told(first: &[Block]) -> Vec<Attribute> {
    let Some(Block { columns, .. }) = first.first() else { return Vec::new() };
    let has_numbers = |values: &&Values| (0..values.len()).any(|i| values.get(i) != 0.0);
    let attribute = |values: &Values| Attribute { name: String::new(), values: Values::new(values.kind()) };
    columns.iter().filter(has_numbers).map(attribute).collect()
}
