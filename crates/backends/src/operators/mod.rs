//! Our kernels for the operators of the domain `densecloud` that a unit's graph is made of.
//!
//! The ONNX files define these operators by functions of standard ones, so that any runtime can run
//! them; ONNX Runtime takes a registered kernel before such a function. The plain graph spends three
//! quarters of its time in `TopK`, `Gather` and on edge tables that leave the cache: here a patch's
//! edges live in registers, eight points (or as many as the processor's vectors hold) at a time.

mod edge_block;
mod neighbours;
mod skip;

use ort::operator::OperatorDomain;

/// The domain with all kernels.
pub(super) fn domain() -> ort::Result<OperatorDomain> {
    OperatorDomain::new("densecloud")?
        .add(neighbours::Neighbours)?
        .add(edge_block::EdgeBlock)?
        .add(skip::BilateralSkip)
}

/// The sizes of a tensor of three axes.
fn three(shape: &[i64], what: &str) -> ort::Result<[usize; 3]> {
    match *shape {
        [a, b, c] if a >= 0 && b >= 0 && c >= 0 => Ok([a as usize, b as usize, c as usize]),
        _ => Err(ort::Error::new(format!("{what} has the shape {shape:?}, not [B, N, C]"))),
    }
}

fn missing(what: &str) -> ort::Error {
    ort::Error::new(format!("{what} is missing"))
}
