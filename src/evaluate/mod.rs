//! Metrics, controls, reports and pictures.

pub mod picture;
