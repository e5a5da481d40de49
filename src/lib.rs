//! densecloud turns a sparse, noisy 3D point cloud into a dense one.
//!
//! Data flows one way: bytes -> [`formats`] -> [`cloud`] -> [`cascade`] (which uses
//! [`geometry`] and a [`backend`]) -> [`formats`] -> bytes. The [`engine`] queues and runs
//! cascades; [`server`] and [`cli`] are thin edges over it, and [`evaluate`] scores results.

pub mod attributes;
pub mod backend;
pub mod cascade;
pub mod cli;
pub mod cloud;
pub mod engine;
pub mod evaluate;
pub mod formats;
pub mod geometry;
pub mod provenance;
pub mod server;
pub mod survey;
