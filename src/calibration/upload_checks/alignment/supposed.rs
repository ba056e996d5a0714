//! Possible causes of a misfit, and their order of likelihood.

use super::convention::Convention;
use super::fitting::Zeroed;
use super::hypotheses::Hypothesis;
use crate::measurement::Frame;

/// A possible cause, and how well the robot then fits.
pub struct Supposed {
    pub what: What,
    pub rms_mm: f64,
    /// A hypothesis about the file that looks the same.
    pub or: Option<Hypothesis>,
    /// A joint convention that looks the same as a left-handed file.
    pub or_joints: Option<Box<Convention>>,
    /// Joint zero errors in addition.
    pub zeros: Option<Zeroed>,
}

pub enum What {
    File(Hypothesis),
    Joints(Box<Convention>),
}

impl What {
    /// True for a convention with zeros shifted by quarter turns.
    pub fn is_turned(&self) -> bool {
        matches!(self, Self::Joints(convention) if convention.is_turned())
    }

    /// True for a convention whose first zero is shifted by quarter turns, which looks like a turned base frame.
    pub fn turns_first_joint(&self) -> bool {
        matches!(self, Self::Joints(convention) if convention.quarter_turns.first().is_some_and(|turns| *turns > 0))
    }

    /// Order of likelihood: of the causes that fit equally well, the one with the smallest rank is reported. A left-handed frame and a maker's signs
    /// look the same on most arms, and makers do use these signs. Turned zeros are rarer than exchanged columns.
    pub fn rank(&self, frame: Frame) -> usize {
        match self {
            Self::File(Hypothesis::Units { .. }) => 0,
            Self::File(Hypothesis::Robot(_)) => 5,
            Self::File(Hypothesis::PositionColumns(_)) if frame == Frame::Base => 1,
            Self::File(file) if file.is_left_handed() => 3,
            Self::File(_) => 1,
            Self::Joints(_) if frame == Frame::Base && self.is_turned() => 4,
            Self::Joints(_) => 2,
        }
    }
}
