//! The local frame: an anchor and a scale that make `f32` safe.

use super::{Point, Position};

/// Maps true `f64` coordinates to local `f32` ones and back: `local = (p - anchor) / scale`.
///
/// The anchor is the centre of the bounding box, subtracted in `f64`, so clouds far from the
/// origin (UTM coordinates, say) keep their detail. The scale is a power of two at or above the
/// largest half side of the box, so that scaling itself rounds nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    anchor: Position,
    scale: f64,
}

/// Why no frame can be fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// There is no point, or one is NaN or infinite.
    #[error("the cloud has no finite points")]
    NotFinite,
    /// The extent is zero: every point is the same.
    #[error("all points are the same")]
    Degenerate,
    /// The extent overflows.
    #[error("the coordinates span more than 1e300 units; rescale the cloud")]
    TooLarge,
}

impl Frame {
    /// Fits a frame to finite positions. One pass, O(n).
    ///
    /// # Errors
    /// See [`FrameError`].
    pub fn fit(positions: &[Position]) -> Result<Self, FrameError> {
        let mut lo = [f64::INFINITY; 3];
        let mut hi = [f64::NEG_INFINITY; 3];
        for p in positions {
            for a in 0..3 {
                if !p[a].is_finite() {
                    return Err(FrameError::NotFinite);
                }
                lo[a] = lo[a].min(p[a]);
                hi[a] = hi[a].max(p[a]);
            }
        }
        if positions.is_empty() {
            return Err(FrameError::NotFinite);
        }
        let mut anchor = [0.0; 3];
        let mut half = 0.0_f64;
        for a in 0..3 {
            let side = hi[a] - lo[a];
            if side > 1e300 {
                return Err(FrameError::TooLarge);
            }
            anchor[a] = lo[a] + side / 2.0;
            half = half.max(side / 2.0);
        }
        // Below this the scale would be subnormal and its reciprocal infinite.
        if half < 1e-300 {
            return Err(FrameError::Degenerate);
        }
        Ok(Self { anchor, scale: half.log2().ceil().exp2() })
    }

    /// True coordinates to local ones.
    #[must_use]
    pub fn to_local(&self, p: Position) -> Point {
        std::array::from_fn(|a| ((p[a] - self.anchor[a]) / self.scale) as f32)
    }

    /// Local coordinates to true ones.
    #[must_use]
    pub fn to_world(&self, p: Point) -> Position {
        std::array::from_fn(|a| f64::from(p[a]) * self.scale + self.anchor[a])
    }

    /// The length of one local unit in the file's units.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn utm_coordinates_keep_a_millimetre() {
        let cloud: Vec<Position> =
            (0..1000).map(|i| [500_000.0 + f64::from(i) * 0.001, 4_649_776.123, 12.0]).collect();
        let frame = Frame::fit(&cloud).expect("a frame");
        for p in &cloud {
            let back = frame.to_world(frame.to_local(*p));
            for a in 0..3 {
                assert!((back[a] - p[a]).abs() < 1e-6, "{p:?} came back as {back:?}");
            }
        }
    }

    #[test]
    fn local_coordinates_lie_in_the_unit_cube() {
        for scale in [1e-30, 1.0, 3.7, 1e30] {
            let cloud = [[0.0, 0.0, 0.0], [scale, scale / 2.0, 0.0]];
            let frame = Frame::fit(&cloud).expect("a frame");
            for p in cloud {
                assert!(frame.to_local(p).iter().all(|c| c.abs() <= 1.0));
            }
        }
    }

    #[test]
    fn impossible_clouds_are_refused() {
        assert_eq!(Frame::fit(&[]), Err(FrameError::NotFinite));
        assert_eq!(Frame::fit(&[[f64::NAN, 0.0, 0.0]]), Err(FrameError::NotFinite));
        assert_eq!(Frame::fit(&[[1.0; 3]; 5]), Err(FrameError::Degenerate));
        assert_eq!(Frame::fit(&[[-1e308; 3], [1e308; 3]]), Err(FrameError::TooLarge));
    }
}
