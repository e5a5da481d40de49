//! What stands between the columns of text, and what before the fraction of a number.

use std::fmt;
use std::str::FromStr;

use super::super::reading::UnknownName;

/// What stands between two columns of text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Separator {
    /// A space; read, any white space.
    Space,
    /// A comma.
    Comma,
    /// A semicolon.
    Semicolon,
    /// A tab.
    Tab,
    /// A vertical bar.
    Bar,
}

/// What stands before the fraction of a number in text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum Decimal {
    /// A point: `3.5`.
    #[default]
    Point,
    /// A comma: `3,5`.
    Comma,
}

impl Separator {
    /// The names of all, as [`FromStr`] takes them; it also takes the characters themselves.
    pub const NAMES: &'static [&'static str] = &["comma", "semicolon", "tab", "space", "bar"];

    /// All of them: the order in which they are thought of where several fit.
    pub(super) const ALL: [Self; 5] = [Self::Tab, Self::Semicolon, Self::Bar, Self::Comma, Self::Space];

    /// What is written.
    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::Space => " ",
            Self::Comma => ",",
            Self::Semicolon => ";",
            Self::Tab => "\t",
            Self::Bar => "|",
        }
    }

    /// The character, where there is exactly one between two columns.
    pub(super) fn character(self) -> Option<char> {
        (self != Self::Space).then(|| self.as_str().chars().next()).flatten()
    }

    /// For people.
    pub(super) fn shown(self) -> &'static str {
        match self {
            Self::Space => "white space",
            Self::Comma => "a comma",
            Self::Semicolon => "a semicolon",
            Self::Tab => "a tab",
            Self::Bar => "a vertical bar",
        }
    }
}

impl fmt::Display for Separator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Space => "space",
            Self::Comma => "comma",
            Self::Semicolon => "semicolon",
            Self::Tab => "tab",
            Self::Bar => "bar",
        })
    }
}

impl FromStr for Separator {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let fits = |separator: &&Self| {
            text == separator.as_str() || text.eq_ignore_ascii_case(&separator.to_string())
        };
        let found = Self::ALL.iter().find(fits).copied();
        found.or((text == "\\t").then_some(Self::Tab)).ok_or_else(|| UnknownName::new(text, Self::NAMES))
    }
}

impl Decimal {
    /// The names of both, as [`FromStr`] takes them; it also takes the characters themselves.
    pub const NAMES: &'static [&'static str] = &["point", "comma"];
}

impl fmt::Display for Decimal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Point => "point",
            Self::Comma => "comma",
        })
    }
}

impl FromStr for Decimal {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        match text.to_ascii_lowercase().as_str() {
            "point" | "." => Ok(Self::Point),
            "comma" | "," => Ok(Self::Comma),
            _ => Err(UnknownName::new(text, Self::NAMES)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_have_names_and_are_their_own() {
        for name in Separator::NAMES {
            let separator: Separator = name.parse().expect(name);
            assert_eq!(separator.to_string(), *name);
            assert_eq!(separator.as_str().parse(), Ok(separator));
        }
        for (name, mark) in Decimal::NAMES.iter().zip([".", ","]) {
            let decimal: Decimal = name.parse().expect(name);
            assert_eq!((decimal.to_string().as_str(), mark.parse()), (*name, Ok(decimal)));
        }
        assert_eq!("\\t".parse(), Ok(Separator::Tab));
        let why = "colon".parse::<Separator>().expect_err("none").to_string();
        assert_eq!(why, "\"colon\"; there are comma, semicolon, tab, space, bar");
    }
}
