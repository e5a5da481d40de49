//! The Python literal that a header is.

use super::super::text::shown;

/// What a header is made of.
#[derive(Debug, PartialEq)]
pub(super) enum Literal {
    Str(String),
    Int(u64),
    Bool(bool),
    /// A list or a tuple.
    List(Vec<Literal>),
    Dict(Vec<(String, Literal)>),
}

/// As deep as types of types go.
const MAX_DEPTH: usize = 16;

/// Reads a literal.
///
/// # Errors
/// What the text is instead.
pub(super) fn parse(text: &str) -> Result<Literal, String> {
    Parser { rest: text }.whole()
}

struct Parser<'a> {
    rest: &'a str,
}

impl Parser<'_> {
    fn whole(mut self) -> Result<Literal, String> {
        let literal = self.literal(0)?;
        match self.next() {
            None => Ok(literal),
            Some(c) => Err(format!("`{c}` after the header's end")),
        }
    }

    /// The next character that is no white space; it is not consumed.
    fn next(&mut self) -> Option<char> {
        self.rest = self.rest.trim_start();
        self.rest.chars().next()
    }

    /// Consumes a character if it is the next.
    fn take(&mut self, c: char) -> bool {
        let taken = self.next() == Some(c);
        if taken {
            self.rest = &self.rest[c.len_utf8()..];
        }
        taken
    }

    fn literal(&mut self, depth: usize) -> Result<Literal, String> {
        if depth > MAX_DEPTH {
            return Err("the header is nested too deep".into());
        }
        match self.next() {
            Some('{') => {
                self.take('{');
                let mut entries = Vec::new();
                while !self.take('}') {
                    let key = self.string()?;
                    if !self.take(':') {
                        return Err("a `:` is missing in the header".into());
                    }
                    entries.push((key, self.literal(depth + 1)?));
                    self.comma('}')?;
                }
                Ok(Literal::Dict(entries))
            }
            Some(open @ ('(' | '[')) => {
                let close = if open == '(' { ')' } else { ']' };
                self.take(open);
                let mut items = Vec::new();
                while !self.take(close) {
                    items.push(self.literal(depth + 1)?);
                    self.comma(close)?;
                }
                Ok(Literal::List(items))
            }
            Some('\'' | '"') => Ok(Literal::Str(self.string()?)),
            _ => {
                let end = self.rest.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(self.rest.len());
                let (word, rest) = self.rest.split_at(end);
                self.rest = rest;
                match word {
                    "True" => Ok(Literal::Bool(true)),
                    "False" => Ok(Literal::Bool(false)),
                    // Python 2 wrote `L` behind long numbers.
                    _ => (word.trim_end_matches('L').parse().map(Literal::Int))
                        .map_err(|_| format!("{} means nothing in a NumPy header", quoted(word))),
                }
            }
        }
    }

    /// What stands between two entries; before `close` it may be missing.
    fn comma(&mut self, close: char) -> Result<(), String> {
        if self.take(',') || self.next() == Some(close) {
            Ok(())
        } else {
            Err(format!("no `{close}` in the header"))
        }
    }

    fn string(&mut self) -> Result<String, String> {
        let quote = self
            .next()
            .filter(|c| matches!(c, '\'' | '"'))
            .ok_or("a name in quotes is missing in the header")?;
        self.take(quote);
        let mut text = String::new();
        let mut chars = self.rest.char_indices();
        while let Some((i, c)) = chars.next() {
            match c {
                _ if c == quote => {
                    self.rest = &self.rest[i + c.len_utf8()..];
                    return Ok(text);
                }
                '\\' => text.extend(chars.next().map(|(_, escaped)| escaped)),
                _ => text.push(c),
            }
        }
        Err("the header ends within quotes".into())
    }
}

/// A word of the header, for an error message.
pub(super) fn quoted(text: &str) -> String {
    shown(text.as_bytes())
}
