//! Which columns of a file that names them are the position.

use densecloud_cloud::axes_of;

/// The places of the coordinates among columns of these names; what can be no coordinate has an empty name. `what` is what
/// has the columns, for people: `the vertices have`.
///
/// `x`, `y` and `z` as they are come first, then the names that programs give them, in any case.
///
/// # Errors
/// Why there are none.
pub(super) fn axes_among<S: AsRef<str>>(names: &[S], what: &str) -> Result<[usize; 3], String> {
    let exact = ["x", "y", "z"].map(|axis| {
        let mut places = (0..names.len()).filter(|i| names[*i].as_ref() == axis);
        places.next().filter(|_| places.next().is_none())
    });
    if let [Some(x), Some(y), Some(z)] = exact {
        return Ok([x, y, z]);
    }
    match axes_of(names) {
        Ok(Some(axes)) => Ok(axes.columns),
        Ok(None) => {
            let has = |axis: &str| names.iter().any(|name| name.as_ref().eq_ignore_ascii_case(axis));
            let missing = ["x", "y", "z"].into_iter().find(|axis| !has(axis)).unwrap_or("x");
            let all: Vec<&str> =
                names.iter().map(AsRef::as_ref).filter(|name| !name.is_empty()).take(50).collect();
            Err(format!(
                "{what} no number `{missing}`, and no coordinates by other names: {}",
                all.join(", ")
            ))
        }
        Err(why) => Err(why.to_string()),
    }
}
