//! From the attributes of a cloud's points to those of a denser one: a plan for all of them, by what their names and
//! values mean, and the nearest points of the source.

mod carry;
mod finish;
mod finished;
mod keep;
mod mean;
mod near;
mod normals;
mod plan;
mod rules;
mod sure;
mod vectors;

pub use carry::carry;
pub use finish::Finish;
pub use finished::{Part, finish, finish_part};
pub use plan::Plan;
pub use rules::{Rule, Rules, RulesError};
