//! Names of columns as files have them: a format's own for what a column means, and others valid and each another.

use std::collections::{HashMap, HashSet};

use densecloud_cloud::{Attribute, Origin, Role, roles_of};

/// What a format asks of a column's name.
#[derive(Clone, Copy)]
pub(crate) struct NameRule<'a> {
    /// Most bytes.
    pub(crate) most: usize,
    /// Whether a character may stand in a name; `_` stands for others.
    pub(crate) allows: fn(char) -> bool,
    /// Whether a name is one of the format's own.
    pub(crate) is_taken: &'a dyn Fn(&str) -> bool,
}

/// The coordinates' names, which stand before all others.
const AXES: [&str; 3] = ["x", "y", "z"];

impl NameRule<'_> {
    /// The names that columns have in a file, the coordinates' apart, in their order. Those that are valid stay as they
    /// are. In others `_` stands for each character that is not allowed; where nothing else is left, and for a blank name, it is
    /// `column 4` and so on, by its place in the file. Of two that are the same, the later one gets `_`, `_2`, `_3` or
    /// whatever is free behind it.
    pub(crate) fn apply<S: AsRef<str>>(self, names: &[S]) -> Vec<String> {
        let numbered: Vec<(usize, &str)> = names.iter().map(AsRef::as_ref).enumerate().collect();
        self.apply_to(&numbered)
    }

    /// As [`apply`](Self::apply) for some of a cloud's attributes, by their numbers, counted from 0.
    pub(crate) fn apply_to(self, names: &[(usize, &str)]) -> Vec<String> {
        let mut used: HashSet<String> = AXES.map(str::to_owned).into();
        let mut written = vec![String::new(); names.len()];
        // First those that can stay, so that no other takes their names.
        for ((number, name), written) in names.iter().zip(&mut written) {
            let stays = self.valid(name, *number) == *name && !(self.is_taken)(name);
            if stays && used.insert((*name).to_owned()) {
                (*name).clone_into(written);
            }
        }
        for ((number, name), written) in names.iter().zip(&mut written).filter(|(_, name)| name.is_empty()) {
            *written = self.free(&self.valid(name, *number), &used);
            used.insert(written.clone());
        }
        written
    }

    /// The name with allowed characters alone, and some that tell it from others.
    fn valid(self, name: &str, number: usize) -> String {
        let allowed: String = name.chars().map(|c| if (self.allows)(c) { c } else { '_' }).collect();
        let allowed = cut(allowed, self.most);
        let is_changed = allowed != name;
        let says_nothing = |c: char| c.is_whitespace() || is_changed && c == '_';
        if !allowed.chars().all(says_nothing) {
            return allowed;
        }
        let space = if (self.allows)(' ') { ' ' } else { '_' };
        format!("column{space}{}", AXES.len() + number + 1)
    }

    /// The name, with an end where something else has it.
    fn free(self, name: &str, used: &HashSet<String>) -> String {
        let mut names =
            (0..).map(end).map(|end| cut(name.to_owned(), self.most.saturating_sub(end.len())) + &end);
        // There are more numbers than columns.
        names.find(|name| !used.contains(name) && !(self.is_taken)(name)).unwrap_or_default()
    }
}

/// Tells columns of one name apart as they are read.
#[derive(Default)]
pub(crate) struct Apart {
    /// Names that are given, and how many ends of each were tried.
    given: HashMap<String, usize>,
}

impl Apart {
    /// The name, or, where an earlier column has it, the name with `_`, `_2`, `_3` or whatever is free behind it.
    pub(crate) fn name(&mut self, wanted: &str) -> String {
        let mut number = self.given.get(wanted).copied().unwrap_or(0);
        let mut name = wanted.to_owned() + &end(number);
        while self.given.contains_key(&name) {
            number += 1;
            name = wanted.to_owned() + &end(number);
        }
        // So that a thousand of one name are no million tries.
        self.given.insert(wanted.to_owned(), number + 1);
        self.given.entry(name.clone()).or_insert(1);
        name
    }
}

/// What tells the later ones of a name from the first.
fn end(number: usize) -> String {
    match number {
        0 => String::new(),
        1 => "_".to_owned(),
        more => format!("_{more}"),
    }
}

/// The text, shortened to `most` bytes at a character's end.
pub(crate) fn cut(mut text: String, most: usize) -> String {
    while text.len() > most {
        text.pop();
    }
    text
}

/// The name that a format has for what each attribute means, where it has one: the attribute of that very name goes
/// there, else that of this program's name for it, else the first that means it. Parts of a colour and of a normal only go there together. Names from a file of
/// the same `kind` mean what they say, and nothing else.
pub(crate) fn own_names(
    attributes: &[Attribute],
    origin: &Origin,
    kind: &str,
    own: &[(Role, &'static str)],
) -> Vec<Option<&'static str>> {
    let names: Vec<&str> = attributes.iter().map(|attribute| attribute.name.as_str()).collect();
    let roles = if origin.named_in == Some(kind) { vec![None; names.len()] } else { roles_of(&names) };
    let called = |wanted: &str| names.iter().position(|name| *name == wanted);
    let meant = |(role, own): &(Role, &str)| {
        let exact = called(own).or_else(|| called(role.name()));
        exact.or_else(|| roles.iter().position(|known| known.as_ref() == Some(role)))
    };
    let has = |role: &Role| own.iter().any(|own| own.0 == *role && meant(own).is_some());
    let is_whole = |role: &Role| {
        let group = WHOLES.iter().find(|group| group.contains(role));
        group.is_none_or(|group| group[..3].iter().all(has))
    };
    let mut found = vec![None; names.len()];
    for own in own {
        let place = if is_whole(&own.0) { meant(own) } else { called(own.1) };
        if let Some(place) = place.filter(|place| found[*place].is_none()) {
            found[place] = Some(own.1);
        }
    }
    found
}

/// What means something only together: the first three.
const WHOLES: [&[Role]; 2] =
    [&[Role::Red, Role::Green, Role::Blue, Role::Alpha], &[Role::NormalX, Role::NormalY, Role::NormalZ]];

/// The names of attributes, but the format's own where it has one for what they mean.
pub(crate) fn meant<'a>(attributes: &'a [Attribute], own: &[Option<&'static str>]) -> Vec<&'a str> {
    attributes.iter().zip(own).map(|(attribute, own)| own.unwrap_or(&attribute.name)).collect()
}

/// As [`Choices::renamed`](super::kind::Choices::renamed), where attributes have these names in a file.
pub(crate) fn changes(
    attributes: &[Attribute],
    own: &[Option<&'static str>],
    written: Vec<String>,
) -> Vec<(String, String)> {
    let others = attributes.iter().zip(written).zip(own).filter(|(_, own)| own.is_none());
    let pairs = others.map(|((attribute, written), _)| (attribute.name.clone(), written));
    pairs.filter(|(from, to)| from != to).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: NameRule<'static> =
        NameRule { most: 8, allows: |c| c.is_ascii_graphic(), is_taken: &|name| name == "end" };

    #[test]
    fn names_are_valid_and_none_is_there_twice() {
        let names =
            ["a b", "", "red", "red", "x", "高さ", "a_b", "end", "a name of 16", "a name of 17", "red"];
        assert_eq!(
            RULE.apply(&names),
            [
                "a_b_", "column_5", "red", "red_", "x_", "column_9", "a_b", "end_", "a_name_o", "a_name__",
                "red_2",
            ]
        );
        assert_eq!(RULE.apply(&["column_5", ""]), ["column_5", "column__"]);
        let many = RULE.apply(&["twice"; 1000]);
        assert_eq!(many.iter().collect::<HashSet<_>>().len(), 1000);
        assert!(many.iter().all(|name| name.len() <= 8));
        assert_eq!(many[999], "twic_999");
    }

    #[test]
    fn columns_of_one_name_are_told_apart() {
        let mut apart = Apart::default();
        let names = ["a", "a_2", "a", "a", "a_", "a"].map(|name| apart.name(name));
        assert_eq!(names, ["a", "a_2", "a_", "a_3", "a__", "a_4"]);
        // As many as a header of a hostile file has.
        let many: HashSet<String> = (0..200_000).map(|_| apart.name("b")).collect();
        assert_eq!(many.len(), 200_000);
    }

    #[test]
    fn what_a_column_means_tells_its_place() {
        let own = [
            (Role::Red, "red"),
            (Role::Green, "green"),
            (Role::Blue, "blue"),
            (Role::Intensity, "intensity"),
        ];
        let of = |names: &[&str], named_in| {
            let values = densecloud_cloud::Values::U8(Vec::new());
            let attributes: Vec<Attribute> =
                names.iter().map(|name| Attribute { name: (*name).into(), values: values.clone() }).collect();
            own_names(&attributes, &Origin { named_in, ..Origin::default() }, "ply", &own)
        };
        let colour = [Some("red"), Some("green"), Some("blue")];
        assert_eq!(of(&["Red", "scalar_Intensity", "label"], None), [None, Some("intensity"), None]);
        assert_eq!(of(&["R", "G", "B"], None), colour);
        assert_eq!(
            of(&["Red", "GREEN", "blue", "green"], Some("another")),
            [Some("red"), None, Some("blue"), Some("green")]
        );
        assert_eq!(
            of(&["Red", "GREEN", "blue", "intensity"], Some("ply")),
            [None, None, Some("blue"), Some("intensity")]
        );
        assert_eq!(of(&["red", "green", "blue"], Some("ply")), colour);
    }
}
