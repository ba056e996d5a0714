//! The parameters of a model, their names, and the effect of a vector of deviations on a robot.

use crate::identification::KinematicModel;
use crate::kinematics::Link;
use crate::kinematics::batch::Moved;
pub use crate::kinematics::rotation::{left_jacobian, rotation_exp, rotation_log};
use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Vector3};

/// Axes i-1 and i count as parallel (or antiparallel) below this |sin alpha_i|; about 1.1°.
pub const PARALLEL_SINE: f64 = 0.02;

/// A quantity of one link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Quantity {
    /// a, mm.
    A,
    /// alpha, rad.
    Alpha,
    /// d, mm.
    D,
    /// theta_offset, rad.
    ThetaOffset,
    /// beta, rad.
    Beta,
}

/// One free parameter. Its value is a deviation from the reference model, in mm or rad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Parameter {
    /// A quantity of a link (0-based here, 1-based in the name).
    Link(usize, Quantity),
    /// Translation of the base along an axis of the measuring frame.
    BaseTranslation(usize),
    /// Rotation vector of the base about an axis of the measuring frame, through the base's origin.
    BaseRotation(usize),
    /// Target offset along an axis of the flange frame.
    Target(usize, usize),
    /// Rotation vector of a target about an axis of the flange frame, if its poses are measured.
    TargetRotation(usize, usize),
}

const AXES: [&str; 3] = ["x", "y", "z"];

impl Parameter {
    /// Its name in the API: `a_1`, `theta_offset_3`, `base_x`, `base_rx`, `target_0_z`, `target_0_rx`.
    pub fn name(&self) -> String {
        match self {
            Self::Link(link, quantity) => {
                let quantity = match quantity {
                    Quantity::A => "a",
                    Quantity::Alpha => "alpha",
                    Quantity::D => "d",
                    Quantity::ThetaOffset => "theta_offset",
                    Quantity::Beta => "beta",
                };
                format!("{quantity}_{}", link + 1)
            }
            Self::BaseTranslation(axis) => format!("base_{}", AXES[*axis]),
            Self::BaseRotation(axis) => format!("base_r{}", AXES[*axis]),
            Self::Target(target, axis) => format!("target_{target}_{}", AXES[*axis]),
            Self::TargetRotation(target, axis) => format!("target_{target}_r{}", AXES[*axis]),
        }
    }

    /// True for parameters in rad, false for those in mm.
    pub fn is_angle(&self) -> bool {
        matches!(
            self,
            Self::Link(_, Quantity::Alpha | Quantity::ThetaOffset | Quantity::Beta)
                | Self::BaseRotation(_)
                | Self::TargetRotation(..)
        )
    }

    /// Its unit in requests and reports: `deg` or `mm`.
    pub fn unit(&self) -> &'static str {
        match self.is_angle() {
            true => "deg",
            false => "mm",
        }
    }

    /// A value of the parameter, mm or rad, in its unit in reports.
    pub fn in_unit(&self, value: f64) -> f64 {
        match self.is_angle() {
            true => value.to_degrees(),
            false => value,
        }
    }

    /// True for parameters of the robot itself; false for those of base and targets.
    pub fn is_link(&self) -> bool {
        matches!(self, Self::Link(..))
    }
}

/// The 4·n parameters of the paper [Gao 2018, Table 2]: a, alpha, d and theta_offset of every link.
pub fn paper_parameters(n_links: usize) -> Vec<Parameter> {
    let quantities = [
        Quantity::A,
        Quantity::Alpha,
        Quantity::D,
        Quantity::ThetaOffset,
    ];
    (0..n_links)
        .flat_map(|link| quantities.map(|quantity| Parameter::Link(link, quantity)))
        .collect()
}

/// Base pose and targets.
pub fn placement_parameters(n_targets: usize) -> Vec<Parameter> {
    let base = (0..3)
        .map(Parameter::BaseTranslation)
        .chain((0..3).map(Parameter::BaseRotation));
    let of_target = |target| (0..3).map(move |axis| Parameter::Target(target, axis));
    base.chain((0..n_targets).flat_map(of_target)).collect()
}

/// Rotation parameters of targets whose poses are measured.
pub fn target_rotation_parameters(targets: &[usize]) -> Vec<Parameter> {
    let of_target = |target: &usize| [0, 1, 2].map(|axis| Parameter::TargetRotation(*target, axis));
    targets.iter().flat_map(of_target).collect()
}

/// Base pose, all five numbers of every link, and targets. Positions do not determine all of them; their priors determine the rest.
pub fn complete_parameters(n_links: usize, n_targets: usize) -> Vec<Parameter> {
    let quantities = [
        Quantity::A,
        Quantity::Alpha,
        Quantity::D,
        Quantity::ThetaOffset,
        Quantity::Beta,
    ];
    let (base, targets): (Vec<_>, Vec<_>) = placement_parameters(n_targets)
        .into_iter()
        .partition(|p| !matches!(p, Parameter::Target(..)));
    let links =
        (0..n_links).flat_map(|link| quantities.map(|quantity| Parameter::Link(link, quantity)));
    base.into_iter().chain(links).chain(targets).collect()
}

/// True if the link's axis counts as parallel (or antiparallel) to the one before.
pub fn is_parallel(link: &Link) -> bool {
    libm::sin(link.alpha_rad).abs() < PARALLEL_SINE
}

/// The reference with each parameter changed by its deviation.
pub fn apply(
    reference: &KinematicModel,
    parameters: &[Parameter],
    deviation: &[f64],
) -> KinematicModel {
    let mut model = reference.clone();
    apply_into(reference, parameters, deviation, &mut model);
    model
}

/// As [`apply`], into a model of the same size, without allocation if only positions are predicted.
pub fn apply_into(
    reference: &KinematicModel,
    parameters: &[Parameter],
    deviation: &[f64],
    model: &mut KinematicModel,
) {
    model.links.copy_from_slice(&reference.links);
    model.targets_mm.copy_from_slice(&reference.targets_mm);
    let mut translation = Vector3::zeros();
    let mut rotation = Vector3::zeros();
    let mut of_targets = vec![Vector3::zeros(); reference.target_rotations.len()];
    for (parameter, value) in parameters.iter().zip(deviation) {
        match *parameter {
            Parameter::Link(link, quantity) => {
                *quantity_mut(&mut model.links[link], quantity) += value
            }
            Parameter::BaseTranslation(axis) => translation[axis] += value,
            Parameter::BaseRotation(axis) => rotation[axis] += value,
            Parameter::Target(target, axis) => model.targets_mm[target][axis] += value,
            Parameter::TargetRotation(target, axis) => of_targets[target][axis] += value,
        }
    }
    for (target, turn) in of_targets.iter().enumerate() {
        model.target_rotations[target] = turned(&reference.target_rotations[target], turn);
    }
    model.t_instrument_base = moved_base(&reference.t_instrument_base, &translation, &rotation);
}

/// Deviation of a model's parameter from that of a reference, mm or rad. For rotations it is the rotation vector between the two.
pub fn deviation_from(
    reference: &KinematicModel,
    model: &KinematicModel,
    parameter: &Parameter,
) -> f64 {
    match *parameter {
        Parameter::Link(link, quantity) => {
            let of =
                |model: &KinematicModel| *quantity_mut(&mut model.links[link].clone(), quantity);
            of(model) - of(reference)
        }
        Parameter::BaseTranslation(axis) => {
            (model.t_instrument_base.translation.vector
                - reference.t_instrument_base.translation.vector)[axis]
        }
        Parameter::BaseRotation(axis) => rotation_log(
            &(model.t_instrument_base.rotation * reference.t_instrument_base.rotation.inverse()),
        )[axis],
        Parameter::Target(target, axis) => {
            (model.targets_mm[target] - reference.targets_mm[target])[axis]
        }
        Parameter::TargetRotation(target, axis) => rotation_log(
            &(model.target_rotations[target] * reference.target_rotations[target].inverse()),
        )[axis],
    }
}

/// Copies a parameter's value from `from` to `to`, to the last bit. Rotation vectors of base and targets are not values of the model and are not
/// copied.
pub fn copy_parameter(parameter: &Parameter, from: &KinematicModel, to: &mut KinematicModel) {
    match *parameter {
        Parameter::Link(link, quantity) => {
            let value = *quantity_mut(&mut from.links[link].clone(), quantity);
            *quantity_mut(&mut to.links[link], quantity) = value;
        }
        Parameter::BaseTranslation(axis) => {
            let value = from.t_instrument_base.translation.vector[axis];
            to.t_instrument_base.translation.vector[axis] = value;
        }
        Parameter::BaseRotation(_) | Parameter::TargetRotation(..) => {}
        Parameter::Target(target, axis) => {
            to.targets_mm[target][axis] = from.targets_mm[target][axis];
        }
    }
}

/// One quantity of a link.
pub fn quantity_mut(link: &mut Link, quantity: Quantity) -> &mut f64 {
    match quantity {
        Quantity::A => &mut link.a_mm,
        Quantity::Alpha => &mut link.alpha_rad,
        Quantity::D => &mut link.d_mm,
        Quantity::ThetaOffset => &mut link.theta_offset_rad,
        Quantity::Beta => &mut link.beta_rad,
    }
}

fn moved_base(
    base: &IsometryMatrix3<f64>,
    translation: &Vector3<f64>,
    rotation: &Vector3<f64>,
) -> IsometryMatrix3<f64> {
    if *translation == Vector3::zeros() && *rotation == Vector3::zeros() {
        return *base;
    }
    let turned = rotation_exp(rotation) * base.rotation;
    IsometryMatrix3::from_parts(
        Translation3::from(base.translation.vector + translation),
        turned,
    )
}

fn turned(rotation: &Rotation3<f64>, turn: &Vector3<f64>) -> Rotation3<f64> {
    match *turn == Vector3::zeros() {
        true => *rotation,
        false => rotation_exp(turn) * rotation,
    }
}

/// A parameter in the form of the kernels. They predict positions, which do not depend on the rotation of a target.
pub fn moved(parameter: &Parameter) -> Moved {
    match *parameter {
        Parameter::Link(link, Quantity::A) => Moved::A(link),
        Parameter::Link(link, Quantity::Alpha) => Moved::Alpha(link),
        Parameter::Link(link, Quantity::D) => Moved::D(link),
        Parameter::Link(link, Quantity::ThetaOffset) => Moved::ThetaOffset(link),
        Parameter::Link(link, Quantity::Beta) => Moved::Beta(link),
        Parameter::BaseTranslation(axis) => Moved::BaseTranslation(axis),
        Parameter::BaseRotation(axis) => Moved::BaseRotation(axis),
        Parameter::Target(target, axis) => Moved::Target(target, axis),
        Parameter::TargetRotation(..) => Moved::Nothing,
    }
}
