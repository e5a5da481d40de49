//! What only one format of file knows, carried through by those that do not.

use std::any::Any;
use std::fmt::Debug;
use std::sync::Arc;

/// A format's own knowledge of a file: LAS's header and records, say. Only the module of that format looks
/// inside, by [`get`](Self::get); everything else hands it on. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Extra(Arc<dyn FormatExtra>);

/// What a format keeps in an [`Extra`].
pub trait FormatExtra: Any + Debug + Send + Sync {
    /// What a file of any other format has no place for, a phrase each.
    fn lost_elsewhere(&self) -> Vec<String>;

    /// Whether `other` is of the same type and equal.
    fn equals(&self, other: &dyn FormatExtra) -> bool;
}

impl Extra {
    /// Wraps what a format knows.
    pub fn new(extra: impl FormatExtra) -> Self {
        Self(Arc::new(extra))
    }

    /// What was wrapped, if it is a `T`.
    #[must_use]
    pub fn get<T: FormatExtra>(&self) -> Option<&T> {
        (self.0.as_ref() as &dyn Any).downcast_ref()
    }

    /// See [`FormatExtra::lost_elsewhere`].
    #[must_use]
    pub fn lost_elsewhere(&self) -> Vec<String> {
        self.0.lost_elsewhere()
    }
}

impl PartialEq for Extra {
    fn eq(&self, other: &Self) -> bool {
        self.0.equals(other.0.as_ref())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq)]
    struct Note(&'static str);

    #[derive(Debug, PartialEq)]
    struct Number(u8);

    impl FormatExtra for Note {
        fn lost_elsewhere(&self) -> Vec<String> {
            vec![self.0.to_owned()]
        }

        fn equals(&self, other: &dyn FormatExtra) -> bool {
            (other as &dyn Any).downcast_ref() == Some(self)
        }
    }

    impl FormatExtra for Number {
        fn lost_elsewhere(&self) -> Vec<String> {
            Vec::new()
        }

        fn equals(&self, other: &dyn FormatExtra) -> bool {
            (other as &dyn Any).downcast_ref() == Some(self)
        }
    }

    #[test]
    fn only_what_was_put_in_comes_out() {
        let extra = Extra::new(Note("a"));
        assert_eq!(extra.get(), Some(&Note("a")));
        assert_eq!(extra.get::<Number>(), None);
        assert_eq!(extra.lost_elsewhere(), ["a"]);
        assert!(extra == extra.clone() && extra == Extra::new(Note("a")));
        assert!(extra != Extra::new(Note("b")) && extra != Extra::new(Number(1)));
    }
}
