//! Small tiles of small clouds, over a backend without a network.

mod flow;
mod formats;
mod resume;
mod space;
mod support;
mod whole;
