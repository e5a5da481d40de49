//! A line that names the columns, and how it comes back.

use densecloud_cloud::{Axes, FormatExtra, Role, axes_of};

use super::super::names::Apart;
use super::super::text::quoted_fields;
use super::Separator;

/// The longest beginning of such a line that is kept.
const LONGEST_PREFIX: usize = 8;

/// A line cut into names: what stands before them, and whether each stands in quotes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Heading {
    pub(super) prefix: String,
    pub(super) names: Vec<String>,
    pub(super) quoted: bool,
}

/// How the line of names is written again: what the cloud's own attributes do not tell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Style {
    /// What stands before the first name: `//`, say.
    pub(super) prefix: String,
    /// Whether all names stand in quotes.
    pub(super) quoted: bool,
    /// The names of the coordinates.
    pub(super) axes: [String; 3],
}

impl FormatExtra for Style {
    fn lost_elsewhere(&self) -> Vec<String> {
        Vec::new()
    }

    fn equals(&self, other: &dyn FormatExtra) -> bool {
        (other as &dyn std::any::Any).downcast_ref() == Some(self)
    }
}

impl Heading {
    /// All ways to cut a line into names: at the separator of the points first, then at others, since some programs part
    /// names in another way than numbers.
    pub(super) fn all(line: &[u8], separator: Separator) -> Vec<Self> {
        let text = decoded(line);
        let text = text.trim_matches(|c: char| c == '\r' || c == ' ');
        let (prefix, rest) = text.split_at(prefix(text, separator));
        let prefix: String = prefix.trim_start().chars().take(LONGEST_PREFIX).collect();
        let others = Separator::ALL.into_iter().filter(|other| *other != separator);
        let mut found: Vec<Self> = Vec::new();
        for separator in std::iter::once(separator).chain(others) {
            for (names, quoted) in cut(rest, separator) {
                let heading = Self { prefix: prefix.clone(), names: without_label(names), quoted };
                if !heading.is_statement() && !found.contains(&heading) {
                    found.push(heading);
                }
            }
        }
        found
    }

    /// Of these ways, the first that gives each of `width` columns a name, coordinates among them if there is one. A
    /// separator may end the line.
    pub(super) fn fitting(all: Vec<Self>, width: usize) -> Option<Self> {
        let mut fitting = Vec::new();
        for mut heading in all {
            if heading.names.len() == width + 1 && heading.names.last().is_some_and(String::is_empty) {
                heading.names.pop();
            }
            if heading.names.len() == width {
                fitting.push(heading);
            }
        }
        let named = fitting.iter().position(|heading| !matches!(heading.axes(), Ok(None))).unwrap_or(0);
        (named < fitting.len()).then(|| fitting.swap_remove(named))
    }

    /// Where the coordinates stand, if these are names of columns at all: the error says which may be the same one.
    pub(super) fn axes(&self) -> Result<Option<Axes>, String> {
        axes_of(&self.names).map_err(|why| why.to_string())
    }

    /// Whether it is more likely to name columns than to be a title.
    pub(super) fn names_columns(&self) -> bool {
        let known = self.names.iter().filter(|name| Role::of(name).is_some()).count();
        known >= 2 || !matches!(self.axes(), Ok(None))
    }

    /// Whether these are three numbers or more, and nothing else.
    pub(super) fn is_numbers(&self) -> bool {
        self.names.len() >= 3 && self.names.iter().all(|name| is_number(name))
    }

    /// Whether it tells numbers rather than names, as `min x y z: 0.5 1.5 2.5`.
    fn is_statement(&self) -> bool {
        self.names.iter().any(|name| name.ends_with(':')) && self.names.iter().any(|name| is_number(name))
    }

    /// Whether each column has a name of words here, whatever it may mean.
    pub(super) fn is_of_words(&self) -> bool {
        self.names.iter().all(|name| !name.is_empty() && !is_number(name))
    }

    /// Gives a name to columns without one and makes names unique; tells what was changed, a sentence each.
    pub(super) fn mend(&mut self) -> Vec<String> {
        let (mut notes, mut apart) = (Vec::new(), Apart::numbered());
        let stays: Vec<bool> = self.names.iter().map(|name| !name.is_empty() && apart.keep(name)).collect();
        for (i, name) in self.names.iter_mut().enumerate().filter(|(i, _)| !stays[*i]) {
            let (wanted, why) = match (name.as_str(), i) {
                // pandas writes the index of its rows so.
                ("", 0) => ("index".to_owned(), "has no name".to_owned()),
                ("", _) => (format!("column {}", i + 1), "has no name".to_owned()),
                (twice, _) => (twice.to_owned(), format!("has the name `{twice}` of an earlier one")),
            };
            *name = apart.another(&wanted);
            notes.push(format!("column {} {why}; it is called `{name}`", i + 1));
        }
        notes
    }
}

/// The text of a line: UTF-8, or else Latin-1, which has a character for each byte.
fn decoded(line: &[u8]) -> String {
    match std::str::from_utf8(line) {
        Ok(text) => text.to_owned(),
        Err(_) => line.iter().map(|b| char::from(*b)).collect(),
    }
}

/// Bytes before the first name: the mark of a comment and white space.
fn prefix(text: &str, separator: Separator) -> usize {
    let begun = text.trim_start();
    let mark = ["/", "#", "%", ";"].into_iter().find(|mark| begun.starts_with(mark));
    let is_mark = match mark {
        Some("/") => begun.starts_with("//"),
        Some(";") => separator != Separator::Semicolon,
        other => other.is_some(),
    };
    let Some(mark) = mark.filter(|_| is_mark) else { return 0 };
    let keeps_tabs = |c: char| c == ' ' || c.is_whitespace() && separator != Separator::Tab;
    let rest = begun.trim_start_matches(mark).trim_start_matches(keeps_tabs);
    text.len() - rest.len()
}

/// The names between separators, and whether all stand in quotes.
fn cut(text: &str, separator: Separator) -> Vec<(Vec<String>, bool)> {
    let Some(character) = separator.character() else { return cut_words(text) };
    quoted_fields(text, character as u8).map(named).into_iter().collect()
}

/// The same between blanks, where a unit in brackets may stand apart from its name.
fn cut_words(text: &str) -> Vec<(Vec<String>, bool)> {
    let single = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let Some((words, quoted)) = quoted_fields(&single, b' ').map(named) else { return Vec::new() };
    let mut joined: Vec<String> = Vec::new();
    for word in &words {
        match joined.last_mut() {
            Some(last) if word.starts_with(['[', '(']) => *last = format!("{last} {word}"),
            _ => joined.push(word.clone()),
        }
    }
    vec![(words, quoted), (joined, quoted)]
}

/// Names without what stands before them all, as `columns: x y z`.
fn without_label(mut names: Vec<String>) -> Vec<String> {
    if let Some((label, others)) = names.split_first()
        && label.ends_with(':')
        && !others.iter().any(|name| name.ends_with(':'))
        && !matches!(axes_of(others), Ok(None))
    {
        names.remove(0);
    }
    names
}

fn is_number(name: &str) -> bool {
    name.parse::<f64>().is_ok()
}

fn named(fields: Vec<(String, bool)>) -> (Vec<String>, bool) {
    let quoted = fields.iter().all(|(_, quoted)| *quoted);
    (fields.iter().map(|(name, quoted)| plain(name, *quoted)).collect(), quoted)
}

/// A name without white space, control characters and single quotes about it.
fn plain(name: &str, quoted: bool) -> String {
    let name = name.trim();
    let within = name.strip_prefix('\'').and_then(|rest| rest.strip_suffix('\'')).filter(|_| !quoted);
    let name: String = within.unwrap_or(name).chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    name.trim().to_owned()
}
