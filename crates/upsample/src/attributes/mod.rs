//! From the attributes of a cloud's points to those of a denser one: a rule for each, by its name and
//! type, and the nearest points of the source.

mod carry;
mod finish;
mod keep;
mod rules;

pub use carry::carry;
pub use finish::{Finish, finish};
pub use rules::{Rule, Rules, RulesError};
