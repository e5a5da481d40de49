//! From the attributes of a cloud's points to those of a denser one: a rule for each, by its name and
//! type, and the nearest points of the source.

mod carry;
mod rules;

pub use carry::carry;
pub use rules::{Rule, Rules, RulesError};
