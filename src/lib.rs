//! densecloud turns a sparse, noisy 3D point cloud into a dense one.
//!
//! Data flows one way: bytes -> [`formats`] -> [`cloud`] -> [`cascade`] (which uses
//! [`geometry`] and a [`backend`]) -> [`formats`] -> bytes. The [`engine`] queues and runs
//! cascades, and [`jobs`] keeps those on disk that should outlive the program; [`server`] and [`cli`] are
//! thin edges over them, and [`evaluate`] scores results. [`proto`] is the gRPC interface's contract.

pub mod attributes;
pub mod backend;
pub mod cascade;
pub mod cli;
pub mod cloud;
pub mod engine;
pub mod evaluate;
pub mod formats;
pub mod geometry;
pub mod jobs;
pub mod proto;
pub mod provenance;
pub mod server;
pub mod survey;
