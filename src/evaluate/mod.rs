//! Metrics, controls, reports and pictures.
