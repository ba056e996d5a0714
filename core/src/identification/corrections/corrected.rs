//! A robot with corrections, and the region in which they hold.

use crate::identification::KinematicModel;
use crate::kinematics::compliance::t_base_flange_corrected;
use crate::kinematics::rotation::{between, rotation_exp, rotation_log};
use crate::kinematics::{Corrections, MeasuredRegion, Payload, t_base_flange};
use nalgebra::{IsometryMatrix3, Rotation3, Vector3};

/// A measured robot with corrections of effects that links cannot describe. Base, links and targets were identified together with the corrections and
/// differ from those of the links alone.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectedModel {
    /// Base, links and targets.
    pub model: KinematicModel,
    /// Its corrections.
    pub corrections: Corrections,
    /// The region of joint values in which it was measured.
    pub region: MeasuredRegion,
}

/// An identified robot: with its links alone, and with corrections if some were kept.
///
/// The corrected model is used in the region where the robot was measured. Outside of it, it is blended into the model of the links alone.
#[derive(Clone, Debug, PartialEq)]
pub struct IdentifiedRobot {
    /// Links alone: the best model for a controller without corrections.
    pub plain: KinematicModel,
    /// With corrections.
    pub corrected: Option<CorrectedModel>,
}

impl CorrectedModel {
    /// Flange in the base frame of this model, at any joint values.
    pub fn t_base_flange(&self, q_rad: &[f64]) -> IsometryMatrix3<f64> {
        t_base_flange_corrected(&self.model.links, &self.corrections, q_rad)
    }

    /// Flange in the measuring frame.
    pub fn t_instrument_flange(&self, q_rad: &[f64]) -> IsometryMatrix3<f64> {
        self.model.t_instrument_base * self.t_base_flange(q_rad)
    }

    /// Position of a target in the measuring frame, mm.
    pub fn position(&self, q_rad: &[f64], target: usize) -> Vector3<f64> {
        let flange = self.t_instrument_flange(q_rad);
        flange.rotation * self.model.targets_mm[target] + flange.translation.vector
    }

    /// Rotation of a target in the measuring frame; `None` if its rotation in the flange frame is unknown.
    pub fn rotation(&self, q_rad: &[f64], target: usize) -> Option<Rotation3<f64>> {
        let of_target = self.model.target_rotations.get(target)?;
        Some(self.t_instrument_flange(q_rad).rotation * of_target)
    }
}

impl IdentifiedRobot {
    /// Links alone.
    pub fn of_links(plain: KinematicModel) -> Self {
        Self {
            plain,
            corrected: None,
        }
    }

    /// The same robot with this payload on its flange. `None`: with the payload of the identification.
    pub fn carrying(mut self, payload: Option<Payload>) -> Self {
        if let (Some(corrected), Some(payload)) = (&mut self.corrected, payload) {
            corrected.corrections.compliance.payload = Some(payload);
        }
        self
    }

    /// Base, links and targets that were identified with corrections, if there are some; else those of the links alone.
    pub fn model(&self) -> &KinematicModel {
        self.corrected
            .as_ref()
            .map_or(&self.plain, |corrected| &corrected.model)
    }

    /// Offset of a target in the flange frame, mm: of the links with corrections if there are some, else of the links alone.
    pub fn target_mm(&self, target: usize) -> Vector3<f64> {
        self.model().targets_mm[target]
    }

    /// Weight of the corrections at a pose, 0 to 1; 0 without corrections.
    pub fn weight(&self, q_rad: &[f64]) -> f64 {
        self.corrected
            .as_ref()
            .map_or(0.0, |corrected| corrected.region.weight(q_rad))
    }

    /// True if there are corrections and their weight is below 1.
    pub fn is_extrapolated(&self, q_rad: &[f64]) -> bool {
        self.corrected
            .as_ref()
            .is_some_and(|corrected| corrected.region.is_extrapolated(q_rad))
    }

    /// Flange in the measuring frame.
    pub fn t_instrument_flange(&self, q_rad: &[f64]) -> IsometryMatrix3<f64> {
        let plain = || self.plain.t_instrument_base * t_base_flange(&self.plain.links, q_rad);
        match (&self.corrected, self.weight(q_rad)) {
            (Some(corrected), 1.0) => corrected.t_instrument_flange(q_rad),
            (Some(corrected), weight) if weight > 0.0 => {
                between(&plain(), &corrected.t_instrument_flange(q_rad), weight)
            }
            _ => plain(),
        }
    }

    /// Position of a target in the measuring frame, mm.
    pub fn position(&self, q_rad: &[f64], target: usize) -> Vector3<f64> {
        match (&self.corrected, self.weight(q_rad)) {
            (Some(corrected), 1.0) => corrected.position(q_rad, target),
            (Some(corrected), weight) if weight > 0.0 => {
                let plain = self.plain.position(q_rad, target);
                plain + (corrected.position(q_rad, target) - plain) * weight
            }
            _ => self.plain.position(q_rad, target),
        }
    }

    /// Rotation of a target in the measuring frame; `None` if its rotation in the flange frame is unknown.
    pub fn rotation(&self, q_rad: &[f64], target: usize) -> Option<Rotation3<f64>> {
        let plain = self.plain.rotation(q_rad, target)?;
        let weight = self.weight(q_rad);
        match &self.corrected {
            Some(corrected) if weight > 0.0 => {
                let turn = rotation_log(&(corrected.rotation(q_rad, target)? * plain.inverse()));
                Some(rotation_exp(&(turn * weight)) * plain)
            }
            _ => Some(plain),
        }
    }
}
