//! Small tiles of small clouds, over a backend without a network.

mod formats;
mod resume;
mod space;
mod support;
mod whole;
