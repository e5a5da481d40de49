//! Who asks, and what a request has been promised: points, memory, a turn, and until when.
//!
//! | file | holds |
//! |---|---|
//! | `client`, `keys` | who asks |
//! | `ticket`, `guess` | the points that a request has reserved; how many, where only its end tells |
//! | `deadline` | until when its answer is of use |
//! | `budget` | memory for bodies and results |
//! | `parsing` | turns at parsing, fair among clients |

pub(crate) mod budget;
pub(crate) mod client;
pub(crate) mod deadline;
pub(crate) mod guess;
pub(crate) mod keys;
pub(crate) mod parsing;
pub(crate) mod ticket;
