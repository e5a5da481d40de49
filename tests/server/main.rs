//! The whole server over real sockets, each test with its own on a port that the system chooses.

mod answers;
mod lifecycle;
mod misbehaviour;
mod refusals;
mod support;
