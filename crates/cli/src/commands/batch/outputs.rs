//! Names of outputs, from a pattern and the name of each input.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{MAIN_SEPARATOR, Path, PathBuf};

use super::super::{CliError, files};

/// What a pattern may have: the input's name without its ending, its ending, and both.
const PARTS: [&str; 3] = ["{stem}", "{ext}", "{name}"];
/// An ending of two parts.
const COPC: &str = ".copc.laz";

/// The output of each input, in their order. A pattern without parts is a folder, or of one input the output itself.
///
/// # Errors
/// [`CliError::Usage`] where a name would have to be guessed, and where two would be written to one place, or onto an input.
pub(super) fn outputs(inputs: &[PathBuf], pattern: &Path) -> Result<Vec<PathBuf>, CliError> {
    let outputs: Vec<_> =
        inputs.iter().map(|input| output(input, pattern, inputs.len() == 1)).collect::<Result<_, _>>()?;
    refuse_collisions(inputs, &outputs)?;
    Ok(outputs)
}

fn output(input: &Path, pattern: &Path, is_only: bool) -> Result<PathBuf, CliError> {
    let wrong = |why: &str| CliError::Usage(format!("{}: {why}", pattern.display()));
    let text = pattern.to_str().ok_or_else(|| wrong("not UTF-8"))?;
    if PARTS.iter().any(|part| text.contains(part)) {
        return filled(text, input).map(PathBuf::from);
    }
    if let Some(unknown) = text.find('{').filter(|_| text.contains('}')) {
        return Err(wrong(&format!("{} is none of {}", &text[unknown..], PARTS.join(", "))));
    }
    match is_folder(text, pattern) {
        true => Ok(PathBuf::from(filled(&format!("{}{{name}}", with_separator(text)), input)?)),
        false if is_only => Ok(pattern.to_owned()),
        false => Err(wrong(
            "all results would be written there; end it with / for a folder, or give each a name: 'out/{stem}_4x.{ext}'",
        )),
    }
}

fn is_folder(text: &str, pattern: &Path) -> bool {
    text.ends_with('/') || text.ends_with(MAIN_SEPARATOR) || (!files::is_stream(pattern) && pattern.is_dir())
}

fn with_separator(folder: &str) -> String {
    let ends = folder.ends_with('/') || folder.ends_with(MAIN_SEPARATOR);
    if ends { folder.to_owned() } else { format!("{folder}/") }
}

/// The pattern with the parts of this input's name.
fn filled(pattern: &str, input: &Path) -> Result<String, CliError> {
    let wrong =
        |why: &str| CliError::Usage(format!("{}: {why}, and {pattern} takes its parts", input.display()));
    let name = input.file_name().filter(|_| !files::is_stream(input));
    let name = name.and_then(|name| name.to_str()).ok_or_else(|| wrong("it has no name in UTF-8"))?;
    let (stem, ending) = parts(name);
    if ending.is_empty() && pattern.contains(PARTS[1]) {
        return Err(wrong("its name has no ending"));
    }
    // One after the other would look for parts in names, too.
    let mut filled = String::new();
    let mut rest = pattern;
    while let Some(at) = rest.find('{') {
        filled.push_str(&rest[..at]);
        rest = &rest[at..];
        let part = PARTS.iter().zip([stem, ending, name]).find(|(part, _)| rest.starts_with(**part));
        let (part, value) = part
            .ok_or_else(|| CliError::Usage(format!("{pattern}: {rest} is none of {}", PARTS.join(", "))))?;
        filled.push_str(value);
        rest = &rest[part.len()..];
    }
    Ok(filled + rest)
}

/// A name's stem and ending.
fn parts(name: &str) -> (&str, &str) {
    let cut = name.len().saturating_sub(COPC.len());
    let is_copc = cut > 0 && name.get(cut..).is_some_and(|end| end.eq_ignore_ascii_case(COPC));
    let at = if is_copc { Some(cut) } else { name.rfind('.').filter(|at| *at > 0) };
    at.map_or((name, ""), |at| (&name[..at], &name[at + 1..]))
}

fn refuse_collisions(inputs: &[PathBuf], outputs: &[PathBuf]) -> Result<(), CliError> {
    let from: HashMap<_, _> = inputs.iter().map(|input| (place(input), input)).collect();
    let mut to = HashMap::new();
    for (input, output) in inputs.iter().zip(outputs).filter(|(_, output)| !files::is_stream(output)) {
        if let Some(other) = to.insert(place(output), input) {
            let [one, other] = [other, input].map(|path| path.display());
            return Err(CliError::Usage(format!(
                "{one} and {other} would both be written to {}",
                output.display()
            )));
        }
        if let Some(other) = from.get(&place(output)) {
            let why = format!("{} would be written onto the input {}", input.display(), other.display());
            return Err(CliError::Usage(why));
        }
    }
    Ok(())
}

/// What tells places apart, whatever they are called: links are followed, and case does not matter where it may not for the
/// system.
fn place(path: &Path) -> OsString {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let real = absolute.canonicalize().ok().or_else(|| {
        let (folder, name) = (absolute.parent()?, absolute.file_name()?);
        Some(folder.canonicalize().ok()?.join(name))
    });
    let name = real.unwrap_or(absolute).into_os_string();
    match name.to_str() {
        Some(name) if cfg!(any(windows, target_os = "macos")) => name.to_lowercase().into(),
        _ => name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(inputs: &[&str], pattern: &str) -> Result<Vec<String>, String> {
        let inputs: Vec<_> = inputs.iter().map(PathBuf::from).collect();
        let made = outputs(&inputs, Path::new(pattern)).map_err(|why| why.to_string())?;
        Ok(made.into_iter().map(|path| path.to_string_lossy().into_owned()).collect())
    }

    #[test]
    fn each_input_has_an_output_of_its_own_name() {
        for (input, pattern, expected) in [
            ("in/a.ply", "out/{stem}_4x.{ext}", "out/a_4x.ply"),
            ("in/a.b.LAZ", "{stem}.ply", "a.b.ply"),
            ("city.copc.laz", "out/{stem}.{ext}", "out/city.copc.laz"),
            (".copc.laz", "{stem}+{ext}", ".copc+laz"),
            ("in/a.ply", "out/", "out/a.ply"),
            ("in/a.ply", "out/b.ply", "out/b.ply"),
            ("{ext}.ply", "{stem}/{name}", "{ext}/{ext}.ply"),
            ("s3://in/a.laz", "s3://out/{stem}.{ext}", "s3://out/a.laz"),
            ("a.ply", "-", "-"),
        ] {
            assert_eq!(of(&[input], pattern), Ok(vec![expected.to_owned()]), "{input} {pattern}");
        }
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().to_str().expect("UTF-8");
        assert_eq!(
            of(&["x/a.ply", "x/b.ply"], path),
            Ok(vec![format!("{path}/a.ply"), format!("{path}/b.ply")])
        );
    }

    #[test]
    fn nothing_is_guessed_and_nothing_is_written_twice() {
        for (inputs, pattern, word) in [
            (&["a.ply", "b.ply"][..], "out.ply", "all results"),
            (&["a.ply", "b.ply"], "-", "all results"),
            (&["a/x.ply", "b/x.ply"], "out/", "both be written to out/x.ply"),
            (&["a.ply", "a.las"], "out/{stem}.ply", "both be written"),
            (&["a.ply", "./a.ply"], "out/", "both be written"),
            (&["a.ply", "a_4x.ply"], "{stem}_4x.ply", "onto the input a_4x.ply"),
            (&["a.ply"], "{name}", "onto the input"),
            (&["a.ply"], "out/{stme}.ply", "{stme}.ply is none of {stem}, {ext}, {name}"),
            (&["a.ply"], "out/{stem}{n}", "{n} is none of"),
            (&["-"], "out/{stem}.ply", "no name"),
            (&["scan"], "out/{stem}.{ext}", "no ending"),
        ] {
            let why = of(inputs, pattern).expect_err(pattern);
            assert!(why.contains(word), "{inputs:?} {pattern}: {why}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_link_to_an_input_is_that_input() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
        std::fs::create_dir(path("in")).expect("a folder");
        std::fs::write(path("in/a.ply"), "").expect("a file");
        std::os::unix::fs::symlink(path("in"), path("out")).expect("a link");
        assert!(of(&[&path("in/a.ply")], &path("out/")).is_err_and(|why| why.contains("onto the input")));
    }
}
