//! The whole server over real sockets, each test with its own on a port that the system chooses.

#![allow(clippy::unwrap_used, reason = "in a test, a panic is how a failure is told")]

mod admission;
mod answers;
mod cors;
mod departures;
mod encodings;
mod faults;
mod forms;
mod grpc;
mod half_closed;
mod heads;
mod inference;
mod jobs;
mod lifecycle;
mod misbehaviour;
mod points;
mod proxies;
mod refusals;
mod support;
mod tiles;
