//! What arrays of a shape hold.

use super::super::columns::MAX_COLUMNS;

/// How many points a table of this shape holds, and how many columns. Dimensions of one entry hold one table.
///
/// # Errors
/// What else it holds, and what to do.
pub(super) fn table(shape: &[u64]) -> Result<(u64, usize), String> {
    let shown = shown(shape);
    let [before @ .., columns] = shape else { return Err("one number alone is no cloud".into()) };
    let many: Vec<u64> = before.iter().copied().filter(|size| *size != 1).collect();
    if before.is_empty() || *columns < 3 {
        return Err(format!("an array of shape {shown}; a cloud has the shape (points, 3 or more)"));
    }
    let points = match many.as_slice() {
        [] => 1,
        [points] => *points,
        [clouds, ..] => {
            return Err(format!(
                "an array of shape {shown} holds {clouds} clouds, or the rows of a picture; save one as a[0], or all as one: \
                 a.reshape(-1, {columns})"
            ));
        }
    };
    // A point has few columns, and a cloud many points.
    let is_turned = *columns > points && (points == 3 || points > 3 && *columns > 16);
    if is_turned {
        return Err(format!("an array of shape {shown} has its points side by side; transpose it: a.T"));
    }
    if *columns > MAX_COLUMNS as u64 {
        return Err(format!("an array of {columns} columns; more than {MAX_COLUMNS} are not read"));
    }
    Ok((points, *columns as usize))
}

/// How many points an array of structures holds.
///
/// # Errors
/// What else it holds, and what to do.
pub(super) fn list(shape: &[u64]) -> Result<u64, String> {
    let many: Vec<u64> = shape.iter().copied().filter(|size| *size != 1).collect();
    match many.as_slice() {
        [] => Ok(1),
        [points] => Ok(*points),
        _ => Err(format!(
            "an array of shape {} holds several clouds, or the rows of a picture; save one as a[0], or all as one: a.ravel()",
            shown(shape)
        )),
    }
}

/// As Python shows a shape.
fn shown(shape: &[u64]) -> String {
    let sizes: Vec<String> = shape.iter().map(u64::to_string).collect();
    if let [one] = sizes.as_slice() { format!("({one},)") } else { format!("({})", sizes.join(", ")) }
}
