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
        let mut apart = Apart::default();
        AXES.into_iter().for_each(|axis| _ = apart.keep(axis));
        let mut written = vec![String::new(); names.len()];
        // First those that can stay, so that no other takes their names.
        for ((number, name), written) in names.iter().zip(&mut written) {
            let stays = self.valid(name, *number) == *name && !(self.is_taken)(name);
            if stays && apart.keep(name) {
                (*name).clone_into(written);
            }
        }
        for ((number, name), written) in names.iter().zip(&mut written).filter(|(_, name)| name.is_empty()) {
            *written = apart.free(&self.valid(name, *number), self.most, self.is_taken);
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
}

/// Gives names, each another.
pub(crate) struct Apart {
    /// The number of the first end.
    first: usize,
    given: HashSet<String>,
    /// Of names that several want, how many ends of each were tried.
    tried: HashMap<String, usize>,
}

impl Default for Apart {
    /// With `_`, `_2`, `_3` or whatever is free behind a name that another has.
    fn default() -> Self {
        Self { first: 1, given: HashSet::new(), tried: HashMap::new() }
    }
}

impl Apart {
    /// With `_2`, `_3` or whatever is free behind a name that another has.
    pub(crate) fn numbered() -> Self {
        Self { first: 2, ..Self::default() }
    }

    /// The names; of those that are the same, the later ones with an end that no other has.
    pub(crate) fn all<S: AsRef<str>>(names: &[S]) -> Vec<String> {
        Self::default().rest(names)
    }

    /// As [`all`](Self::all), beside those that are given.
    pub(crate) fn rest<S: AsRef<str>>(mut self, names: &[S]) -> Vec<String> {
        let is_first: Vec<bool> = names.iter().map(|name| self.keep(name.as_ref())).collect();
        let names = names.iter().map(AsRef::as_ref).zip(is_first);
        let name =
            |(name, is_first): (&str, bool)| if is_first { name.to_owned() } else { self.another(name) };
        names.map(name).collect()
    }

    /// Gives the name, if nothing has it.
    pub(crate) fn keep(&mut self, name: &str) -> bool {
        self.given.insert(name.to_owned())
    }

    /// The name, or, where another has it, the name with an end.
    pub(crate) fn another(&mut self, wanted: &str) -> String {
        self.free(wanted, usize::MAX, &|_| false)
    }

    /// As [`another`](Self::another), of `most` bytes and none that `is_taken`.
    fn free(&mut self, wanted: &str, most: usize, is_taken: &dyn Fn(&str) -> bool) -> String {
        let named = |number: usize| {
            let end = end(number);
            cut(wanted.to_owned(), most.saturating_sub(end.len())) + &end
        };
        let mut number = self.tried.get(wanted).copied().unwrap_or(0);
        while self.given.contains(&named(number)) || is_taken(&named(number)) {
            number = (number + 1).max(self.first);
        }
        // So that a thousand of one name are no million tries.
        self.tried.insert(wanted.to_owned(), number + 1);
        self.given.insert(named(number));
        named(number)
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

/// What the columns of a cloud mean, to be asked which of them fills a place of a format.
pub(crate) struct Meanings<'a> {
    names: Vec<&'a str>,
    /// None where a name means what it says, and nothing else.
    roles: Vec<Option<Role>>,
}

impl<'a> Meanings<'a> {
    /// By the columns' names.
    pub(crate) fn of(attributes: &'a [Attribute]) -> Self {
        let names: Vec<&str> = attributes.iter().map(|attribute| attribute.name.as_str()).collect();
        Self { roles: roles_of(&names), names }
    }

    /// As [`of`](Self::of), for a file of this kind: names that are from one mean nothing but what they say.
    pub(crate) fn in_kind(attributes: &'a [Attribute], origin: &Origin, kind: &str) -> Self {
        let own: HashSet<&str> = match &origin.named_in {
            Some(named) if named.kind == kind => named.names.iter().map(String::as_str).collect(),
            _ => HashSet::new(),
        };
        Self::of(attributes).but_for(|name, _| own.contains(name))
    }

    /// Without the meanings of columns that a format would not call so.
    pub(crate) fn but_for(mut self, is_none: impl Fn(&str, Role) -> bool) -> Self {
        for (name, role) in self.names.iter().zip(&mut self.roles) {
            *role = role.filter(|role| !is_none(name, *role));
        }
        self
    }

    /// The column for what a format calls `own` and that has this role: the one of that very name, else that of this
    /// program's name for it, else the first that means it.
    pub(crate) fn fills(&self, role: Role, own: &str) -> Option<usize> {
        let meaning = || (0..self.names.len()).filter(|i| self.roles[*i] == Some(role));
        let usual = || meaning().find(|i| self.names[*i] == role.name());
        self.called(own).or_else(usual).or_else(|| meaning().next())
    }

    /// The column for what a format calls as this program does.
    pub(crate) fn usual(&self, role: Role) -> Option<usize> {
        self.fills(role, role.name())
    }

    fn called(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|own| *own == name)
    }

    /// The name that a format has for what each column means, where it has one, by the columns that [fill](Self::fills)
    /// its places. Parts of a colour and of a normal only go there together.
    pub(crate) fn own_names(&self, own: &[(Role, &'static str)]) -> Vec<Option<&'static str>> {
        let has = |role: &Role| own.iter().any(|own| own.0 == *role && self.fills(own.0, own.1).is_some());
        let is_whole = |role: &Role| {
            let group = WHOLES.iter().find(|group| group.contains(role));
            group.is_none_or(|group| group[..3].iter().all(has))
        };
        let mut found = vec![None; self.names.len()];
        for (role, name) in own {
            let place = if is_whole(role) { self.fills(*role, name) } else { self.called(name) };
            if let Some(place) = place.filter(|place| found[*place].is_none()) {
                found[place] = Some(*name);
            }
        }
        found
    }
}

/// The names that a format of this kind has for what attributes mean, as [`Meanings::own_names`].
pub(crate) fn own_names(
    attributes: &[Attribute],
    origin: &Origin,
    kind: &str,
    own: &[(Role, &'static str)],
) -> Vec<Option<&'static str>> {
    Meanings::in_kind(attributes, origin, kind).own_names(own)
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
        assert_eq!(Apart::all(&["a", "a_2", "a", "a", "a_", "a"]), ["a", "a_2", "a_3", "a_4", "a_", "a_5"]);
        // As many as a header of a hostile file has.
        let many = vec!["b"; 200_000];
        assert_eq!(Apart::all(&many).into_iter().collect::<HashSet<_>>().len(), 200_000);
        assert_eq!(RULE.apply(&many).into_iter().collect::<HashSet<_>>().len(), 200_000);
    }

    #[test]
    fn what_a_column_means_tells_its_place() {
        let own = [
            (Role::Red, "red"),
            (Role::Green, "green"),
            (Role::Blue, "blue"),
            (Role::Intensity, "intensity"),
        ];
        let of = |names: &[&str], named_in: Option<&'static str>| {
            let values = densecloud_cloud::Values::U8(Vec::new());
            let attributes: Vec<Attribute> =
                names.iter().map(|name| Attribute { name: (*name).into(), values: values.clone() }).collect();
            let names =
                names.iter().map(|name| (*name).to_owned()).filter(|name| name != "intensity").collect();
            let named_in = named_in.map(|kind| densecloud_cloud::Named { kind, names });
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
