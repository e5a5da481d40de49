//! Geometry on local points: neighbours, sampling, normals, distances. No IO, no network.
