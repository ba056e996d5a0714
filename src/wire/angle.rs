//! Conversion between degrees and radians. All conversions for the wire use these functions.

/// Degrees of the wire to radians of the core.
pub fn to_radians(deg: f64) -> f64 {
    deg.to_radians()
}

/// Radians of the core to degrees of the wire.
pub fn to_degrees(rad: f64) -> f64 {
    rad.to_degrees()
}
