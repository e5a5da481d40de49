//! The line of names that is written: such that this program, and others, read the same columns again.

use densecloud_cloud::{Attribute, Origin, Role, axes_of};

use super::super::names::Apart;
use super::super::numbers::one_word;
use super::Separator;
use super::heading::Style;

/// A line of names, and what is told of it.
pub(super) struct Line {
    pub(super) text: String,
    /// The attributes that have another name there, and that name.
    pub(super) renamed: Vec<(String, String)>,
}

impl Line {
    /// Of a cloud with these attributes. From text to text, the style is kept and the coordinates have the same names.
    pub(super) fn of(attributes: &[Attribute], origin: &Origin, separator: Separator) -> Self {
        let style = origin.extra.as_ref().and_then(|extra| extra.get::<Style>());
        let prefix = style.map_or("", |style| style.prefix.as_str());
        let quoted = style.is_some_and(|style| style.quoted);
        let clean = |name: &str| clean(name, separator, quoted);
        let others: Vec<String> = attributes.iter().map(|attribute| clean(&attribute.name)).collect();
        let axes = ["x", "y", "z"].map(str::to_owned);
        let kept = style.and_then(|style| written(&style.axes.clone().map(|name| clean(&name)), &others));
        let renamed = |is_odd: &dyn Fn(&String) -> bool| -> Vec<String> {
            others.iter().map(|name| if is_odd(name) { format!("{name}_2") } else { name.clone() }).collect()
        };
        let names = kept
            .or_else(|| written(&axes, &others))
            .or_else(|| {
                written(&axes, &renamed(&|name| written(&axes, std::slice::from_ref(name)).is_none()))
            })
            .unwrap_or_else(|| [&axes[..], &unique_all(&axes, &renamed(&|name| is_axis(name)))].concat());
        let renamed = attributes.iter().zip(&names[3..]).filter(|(attribute, name)| attribute.name != **name);
        let renamed = renamed.map(|(attribute, name)| (attribute.name.clone(), name.clone())).collect();
        let names: Vec<String> = names.iter().map(|name| field(name, separator, quoted)).collect();
        Self { text: format!("{prefix}{}\n", names.join(separator.as_str())), renamed }
    }
}

/// The names with these of the coordinates before them, if a reader finds the coordinates by them.
fn written(axes: &[String; 3], others: &[String]) -> Option<Vec<String>> {
    let names = [&axes[..], &unique_all(axes, others)].concat();
    let found = axes_of(&names).ok().flatten()?;
    (found.columns == [0, 1, 2]).then_some(names)
}

/// The others, no two the same and none as one of the coordinates.
fn unique_all(axes: &[String; 3], others: &[String]) -> Vec<String> {
    let mut apart = Apart::numbered();
    axes.iter().for_each(|axis| _ = apart.keep(axis));
    apart.rest(others)
}

/// Whether a name could be taken for a coordinate's.
fn is_axis(name: &str) -> bool {
    let company = |axis: usize| {
        let mut names = ["x", "y", "z"].map(str::to_owned);
        names[axis] = name.to_owned();
        matches!(axes_of(&names), Ok(Some(_)))
    };
    matches!(Role::of(name), Some(Role::X | Role::Y | Role::Z)) || (0..3).any(company)
}

/// A name without what would end it or begin another line: between blanks, one word, unless names stand in quotes.
fn clean(name: &str, separator: Separator, quoted: bool) -> String {
    let name = if separator == Separator::Space && !quoted {
        one_word(name).replace('"', "_")
    } else {
        name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect::<String>().trim().to_owned()
    };
    if name.is_empty() { "column".to_owned() } else { name }
}

/// A name as a field, in quotes where it must be.
fn field(name: &str, separator: Separator, quoted: bool) -> String {
    let parts = separator.character().is_some_and(|separator| name.contains(separator));
    if quoted || parts || name.contains('"') || name.starts_with('\'') {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.to_owned()
    }
}
