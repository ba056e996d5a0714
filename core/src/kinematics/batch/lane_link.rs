//! Links of eight particles, and the fixed transforms between two of their commanded rotations.

use super::lanes::Lanes;

/// An angle: that of the reference, and the particles' deviations from it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Angle {
    /// (sin, cos) of the reference.
    pub reference: (f64, f64),
    pub deviation_rad: Lanes,
    pub is_moved: bool,
    pub sin: Lanes,
    pub cos: Lanes,
}

/// One link of eight particles, lengths in mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct LaneLink {
    pub a: Lanes,
    pub d: Lanes,
    pub alpha: Angle,
    pub theta: Angle,
    pub beta: Angle,
}

/// M_i: rotation (row-major) and translation. With beta 0, the rotation's r20 is also 0.
#[derive(Clone, Copy, Debug)]
pub(super) struct Between {
    pub rotation: [[Lanes; 3]; 3],
    pub translation: [Lanes; 3],
    pub is_tilted: bool,
}

/// A target's point as a function of the angle of the last joint that moves it: K + cos q · A + sin q · B.
#[derive(Clone, Copy, Debug)]
pub(super) struct Circle {
    pub centre: [Lanes; 3],
    pub cos: [Lanes; 3],
    pub sin: [Lanes; 3],
}
