//! Checks whether the identified parameters are plausible for a robot that was built to its drawing.

use crate::calibration::reference::ScaleAtReach;
use crate::calibration::report::{CalibrationReport, Warning};
use crate::calibration::upload_checks::alignment::UNMASTERED_RAD;
use crate::calibration::validation::errors::without_outliers;
use crate::identification::least_squares::problem::{BASE_MM, BASE_RAD};
use crate::identification::statistics::distributions::t_half_width;
use crate::identification::statistics::uncertainty::Uncertainty;
use crate::kinematics::rotation::within_half_a_turn;
use crate::kinematics::{Link, reach_mm};
use crate::measurement::Subset;
use nalgebra::IsometryMatrix3;
use std::collections::BTreeSet;
use std::f64::consts::PI;

/// Limit for the deviation of a length, as a share of the reach: 5 mm on an arm of 1.7 m. Makers hold lengths to some tenths of a
/// millimetre, and a hard collision bends by a few millimetres. A larger deviation indicates a wrong tool, another robot, or a wrong model.
const PLAUSIBLE_PER_REACH: f64 = 5.0 / 1700.0;
/// Limit for the deviation of an angle, rad (2°). Mastering is off by some tenths of a degree, a slipped belt by one or two degrees.
const PLAUSIBLE_RAD: f64 = 2.0 * PI / 180.0;

/// Text about differences between two robots of the same type that are larger than expected.
pub fn implausible_changes(links: &[Link], reference: &[Link]) -> Vec<String> {
    let plausible_mm = PLAUSIBLE_PER_REACH * reach_mm(reference);
    let mut changes = Vec::new();
    for (i, (now, then)) in links.iter().zip(reference).enumerate() {
        let lengths = [("a", now.a_mm - then.a_mm), ("d", now.d_mm - then.d_mm)];
        for (name, delta_mm) in lengths
            .into_iter()
            .filter(|(_, delta)| delta.is_nan() || delta.abs() > plausible_mm)
        {
            changes.push(format!("{name}_{} by {delta_mm:.3} mm", i + 1));
        }
        let angles = [
            ("alpha", now.alpha_rad - then.alpha_rad),
            ("theta_offset", now.theta_offset_rad - then.theta_offset_rad),
            ("beta", now.beta_rad - then.beta_rad),
        ];
        for (name, delta_rad) in angles.map(|(name, delta)| (name, within_half_a_turn(delta))) {
            if delta_rad.is_nan() || delta_rad.abs() > PLAUSIBLE_RAD {
                changes.push(format!(
                    "{name}_{} by {:.4}°",
                    i + 1,
                    delta_rad.to_degrees()
                ));
            }
        }
    }
    if links.len() != reference.len() {
        changes.push(format!(
            "{} links instead of {}",
            links.len(),
            reference.len()
        ));
    }
    changes
}

/// Warning code: the base is not where its frame says.
pub const BASE_FRAME_OFF: &str = "base_frame_off";
/// The warning is given above this multiple of a base frame's prior standard deviation: 5 mm, 0.25°.
const BASE_FRAME_STDS: f64 = 5.0;

/// Warning if the positions are in the base frame, and the identified robot is far from that frame.
pub fn base_frame_off(t_measuring_base: &IsometryMatrix3<f64>) -> Option<Warning> {
    let at_mm = t_measuring_base.translation.vector;
    let turned_rad = t_measuring_base.rotation.angle();
    let is_off =
        at_mm.norm() > BASE_FRAME_STDS * BASE_MM || turned_rad > BASE_FRAME_STDS * BASE_RAD;
    let detail = format!(
        "the robot's base is at ({:.2}, {:.2}, {:.2}) mm in the base frame that was measured in, turned by {:.3}°: was the frame set up wrongly? Set it \
         up again, or read the positions in the frame instrument",
        at_mm.x,
        at_mm.y,
        at_mm.z,
        turned_rad.to_degrees()
    );
    is_off.then_some(Warning::new(BASE_FRAME_OFF, detail))
}

/// Warning code: the links only fit with a joint counted in another way.
pub const JOINT_MAP: &str = "joint_map_suspect";

/// Warning if a joint's zero or an axis is rotated by more than the zero error of an unmastered joint. A reflector near the last axis fits
/// as well with the last joint reversed: another link is then rotated by half a turn, and the flange's rotation is wrong. Parameters that
/// the points do not determine (`unseen`, by name) are ignored, because a swarm may leave them at any value.
pub fn joint_counted_otherwise(
    links: &[Link],
    nominal: &[Link],
    unseen: &BTreeSet<String>,
) -> Option<Warning> {
    let turned = links
        .iter()
        .zip(nominal)
        .zip(1..)
        .flat_map(|((now, then), i)| {
            [
                ("theta_offset", now.theta_offset_rad - then.theta_offset_rad),
                ("alpha", now.alpha_rad - then.alpha_rad),
            ]
            .map(|(name, delta_rad)| (format!("{name}_{i}"), within_half_a_turn(delta_rad)))
        });
    let words: Vec<String> = turned
        .filter(|(name, delta_rad)| delta_rad.abs() > UNMASTERED_RAD && !unseen.contains(name))
        .map(|(name, delta_rad)| format!("{name} by {:.1}°", delta_rad.to_degrees()))
        .collect();
    (!words.is_empty()).then(|| {
        let detail = format!(
            "the points fit only with {}: a joint that counts the other way round, from another zero, or together with another joint looks \
             like that, and then the flange is turned wrongly. Compare the controller's joint values with the nominal robot, correct the \
             robot's joint_map, and upload the file again. It cannot be released",
            words.join(", ")
        );
        Warning::new(JOINT_MAP, detail)
    })
}

/// Minimum uncertainty of the tool somewhere in the workspace for a warning, as a multiple of the error at the measured points.
const MIN_TIMES_ERROR: f64 = 5.0;
/// Minimum uncertainty of the tool for a warning as a share of the reach: 0.01 mm on an arm of 1.7 m, the accuracy of the best trackers.
const MIN_UNCERTAIN_PER_REACH: f64 = 0.01 / 1700.0;
/// Minimum relative error common to all lengths for a warning: the expansion of steel for 20 K.
const SCALE: f64 = 2e-4;
/// Minimum of that error in its standard deviations. It must also exceed the bound that a robot's own errors exceed in one of a hundred cases,
/// because with few lengths the standard deviation is poorly known.
const SCALE_SIGMAS: f64 = 4.0;
const SCALE_CONFIDENCE: f64 = 0.99;
/// A length with a smaller data share than this is not used for the scale.
const SCALE_SHARE: f64 = 0.1;

/// Warning code: the points do not determine the tool over the workspace.
pub const TOOL_UNCERTAIN: &str = "tool_uncertain";

/// Warning code: the positions were computed and not measured.
pub const POSITIONS_COMPUTED: &str = "positions_computed";
/// No robot repeats its positions this well, as a share of its reach: 0.017 mm of 1.7 m. Positions that fit better were computed.
const COMPUTED_PER_REACH: f64 = 1e-5;
/// A controller computes positions with nominal parameters. They agree with the nominal robot within this share of the reach, 0.5 mm of 1.7
/// m.
const NOMINAL_PER_REACH: f64 = 3e-4;

/// Warning if the positions agree with the nominal robot and fit better than measured ones can: they are the controller's own tool
/// positions.
fn positions_computed(report: &CalibrationReport, nominal: &[Link]) -> Option<Warning> {
    let reach_mm = reach_mm(nominal);
    let (before, after) = (report.identify.before, report.identify.after);
    let is_computed = before.rms_mm <= NOMINAL_PER_REACH * reach_mm
        && after.rms_mm <= COMPUTED_PER_REACH * reach_mm;
    let detail = format!(
        "the nominal robot fits these positions to {:.4} mm and the identified one to {:.4} mm, better than any robot repeats: they look computed by the \
         controller and not measured. Upload the positions of the instrument",
        before.rms_mm, after.rms_mm
    );
    is_computed.then(|| Warning::new(POSITIONS_COMPUTED, detail))
}

/// Warnings on a finished identification, for its report.
pub fn warnings(report: &CalibrationReport, nominal: &[Link]) -> Vec<Warning> {
    let mut warnings = Vec::from_iter(positions_computed(report, nominal));
    let changes = implausible_changes(&report.links, nominal);
    if !changes.is_empty() {
        let detail = format!(
            "against the nominal robot {}: a wrong tool or base, a slipped joint, another robot?",
            changes.join(", ")
        );
        warnings.push(Warning::new("implausible_parameters", detail));
    }
    let measured = without_outliers(&report.per_point, Subset::Verify)
        .or_else(|| without_outliers(&report.per_point, Subset::Identify));
    let measured_mm = measured.unwrap_or(report.identify).after.rms_mm;
    // More poses do not reduce the error of the instrument's scale, which has its own warning.
    let of_scale_mm = report.instrument_scale.map_or(0.0, |scale| scale.std_mm);
    let of_poses_mm = report.tool_uncertainty.map(|tool| {
        ((tool.max_mm - of_scale_mm) * (tool.max_mm + of_scale_mm))
            .max(0.0)
            .sqrt()
    });
    let noticed_mm =
        (MIN_TIMES_ERROR * measured_mm).max(MIN_UNCERTAIN_PER_REACH * reach_mm(nominal));
    if let Some(of_poses_mm) = of_poses_mm.filter(|mm| *mm > noticed_mm) {
        let detail = format!(
            "elsewhere in the workspace the tool may be off by {of_poses_mm:.3} mm (one standard deviation) though the points fit to {measured_mm:.3} mm: \
             measure poses spread over the workspace, with every joint moving"
        );
        warnings.push(Warning::new(TOOL_UNCERTAIN, detail));
    }
    let told = report
        .parameters
        .iter()
        .filter(|p| p.data_share < Some(SCALE_SHARE));
    let unseen: BTreeSet<&str> = told.map(|p| p.name.as_str()).collect();
    let of_instrument = report.instrument_scale;
    if let Some(scale) = common_scale(&report.links, nominal, &unseen) {
        let cause = match of_instrument {
            Some(of) if of.scale.explains(scale) => {
                "the reference shows the same error of the instrument"
            }
            Some(_) => {
                "the reference shows that it is not the instrument: a robot at another temperature, or another robot"
            }
            None => {
                "a wrong scale or temperature compensation of the instrument, rather than the robot"
            }
        };
        let detail = format!(
            "all lengths are {:+.3} % off by the same share: {cause}",
            100.0 * scale
        );
        warnings.push(Warning::new("scale_suspect", detail));
    }
    warnings.extend(of_instrument.and_then(instrument_scale));
    warnings
}

/// Warning code: the instrument measured a reference wrongly.
pub const INSTRUMENT_SCALE: &str = "instrument_scale";

/// Warning if the reference shows that the instrument measures lengths wrongly.
pub fn instrument_scale(of: ScaleAtReach) -> Option<Warning> {
    let ScaleAtReach { scale, std_mm } = of;
    scale.is_off().then(|| {
        let detail = format!(
            "the instrument measures lengths {:+.1} ppm wrong (standard uncertainty {:.1} ppm), by its reference: {std_mm:.3} mm at the arm's reach. The \
             positions are not corrected for it. Set the temperature and the refraction of the instrument, measure the reference again, and then the robot",
            PPM * scale.error,
            PPM * scale.std
        );
        Warning::new(INSTRUMENT_SCALE, detail)
    })
}

/// Parts per million.
const PPM: f64 = 1e6;

/// The common relative error of all identified lengths, if it is significant against their scatter. Lengths that were not identified are not used.
fn common_scale(links: &[Link], nominal: &[Link], unseen: &BTreeSet<&str>) -> Option<f64> {
    let lengths = links
        .iter()
        .zip(nominal)
        .zip(1..)
        .flat_map(|((now, then), i)| {
            [
                (format!("a_{i}"), then.a_mm, now.a_mm - then.a_mm),
                (format!("d_{i}"), then.d_mm, now.d_mm - then.d_mm),
            ]
        });
    let lengths: Vec<(f64, f64)> = lengths
        .filter(|(name, length, delta)| {
            *length != 0.0 && *delta != 0.0 && !unseen.contains(name.as_str())
        })
        .map(|(_, length, delta)| (length, delta))
        .collect();
    let squares: f64 = lengths.iter().map(|(length, _)| length * length).sum();
    if lengths.len() < 3 {
        return None;
    }
    let scale = lengths
        .iter()
        .map(|(length, delta)| length * delta)
        .sum::<f64>()
        / squares;
    let scatter: f64 = lengths
        .iter()
        .map(|(length, delta)| (delta - scale * length) * (delta - scale * length))
        .sum();
    let freedom = (lengths.len() - 1) as f64;
    let std = (scatter / freedom / squares).sqrt();
    let sigmas = t_half_width(SCALE_CONFIDENCE, freedom).max(SCALE_SIGMAS);
    (scale.abs() > SCALE && scale.abs() > sigmas * std).then_some(scale)
}

/// Warnings about joints that follow another joint: wrist gears that the controller does not compensate. No link parameter describes this.
pub fn of_following_joints(uncertainty: &Uncertainty) -> impl Iterator<Item = Warning> {
    let followings = uncertainty.features.followings.iter();
    followings.enumerate().map(|(k, following)| {
        let row = uncertainty.n_parameters + k;
        // The feature is the followed joint's value in half turns.
        let share = uncertainty.mean(row) / PI;
        let (percent, std_percent) = (100.0 * share, 100.0 * uncertainty.posterior_std(row) / PI);
        let (joint, followed) = (following.joint + 1, following.followed + 1);
        Warning::new("joint_follows", format!(
                "joint {joint} turns by {percent:+.2} % (± {std_percent:.2} %, one standard deviation of the noise alone) of the value of joint {followed} in addition to its own: by the points, the gears \
                 between them are not compensated. If that may be, add {share:+.5} times row {followed} to row {joint} of joint_map.coupling (the identity, if none is \
                 stated) and calibrate again"
            ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const LINK: Link = Link {
        a_mm: 100.0,
        alpha_rad: PI / 2.0,
        d_mm: 300.0,
        theta_offset_rad: 0.0,
        beta_rad: 0.0,
    };

    #[test]
    fn an_unmastered_joint_is_counted_as_it_should_be_and_half_a_turn_is_not() {
        let turned_by = |degrees: f64| Link {
            theta_offset_rad: degrees.to_radians(),
            ..LINK
        };
        let told_but =
            |degrees: f64, unseen| joint_counted_otherwise(&[turned_by(degrees)], &[LINK], &unseen);
        let told = |degrees: f64| told_but(degrees, BTreeSet::new());
        for degrees in [0.0, 20.0, -44.0, 360.0, 340.0] {
            assert_eq!(told(degrees), None, "{degrees}");
        }
        for degrees in [46.0, -90.0, 180.0, -180.0] {
            assert_eq!(told(degrees).unwrap().code, JOINT_MAP, "{degrees}");
        }
        assert_eq!(
            told_but(126.0, BTreeSet::from(["theta_offset_1".into()])),
            None
        );
    }

    #[test]
    fn tenths_of_a_millimetre_are_plausible_and_a_wrong_tool_is_not() {
        let near = Link {
            a_mm: 100.4,
            alpha_rad: PI / 2.0 + 0.001,
            d_mm: 299.2,
            theta_offset_rad: -0.01,
            beta_rad: 0.0,
        };
        assert_eq!(implausible_changes(&[near], &[LINK]), Vec::<String>::new());
        let longer = Link {
            d_mm: 310.0,
            ..LINK
        };
        assert_eq!(
            implausible_changes(&[longer], &[LINK]),
            ["d_1 by 10.000 mm"]
        );
        let turned = Link {
            theta_offset_rad: 0.05,
            ..LINK
        };
        assert_eq!(
            implausible_changes(&[turned], &[LINK]),
            ["theta_offset_1 by 2.8648°"]
        );
        assert_eq!(
            implausible_changes(&[LINK], &[LINK, LINK]),
            ["1 links instead of 2"]
        );
    }

    #[test]
    fn a_full_turn_is_no_change_and_what_is_not_a_number_is_one() {
        let turned = Link {
            theta_offset_rad: TAU,
            ..LINK
        };
        assert!(implausible_changes(&[turned], &[LINK]).is_empty());
        assert_eq!(
            implausible_changes(
                &[Link {
                    a_mm: f64::NAN,
                    ..LINK
                }],
                &[LINK]
            )
            .len(),
            1
        );
    }

    #[test]
    fn lengths_that_are_all_off_by_the_same_share_show_a_wrong_scale() {
        let arm = |scale: f64, scatter: f64| -> Vec<Link> {
            let lengths: [(f64, f64); 3] = [(0.0, 504.0), (166.0, 0.0), (782.0, 761.0)];
            let one = |i: usize, length: f64| {
                if length == 0.0 {
                    0.0
                } else {
                    length * scale
                        + if i.is_multiple_of(2) {
                            scatter
                        } else {
                            -scatter
                        }
                }
            };
            lengths
                .iter()
                .enumerate()
                .map(|(i, (a, d))| Link {
                    a_mm: one(i, *a),
                    d_mm: one(i + 1, *d),
                    ..LINK
                })
                .collect()
        };
        let scale = common_scale(&arm(1.001, 0.05), &arm(1.0, 0.0), &BTreeSet::new()).unwrap();
        assert!((scale - 1e-3).abs() < 1e-4, "{scale}");
        assert_eq!(
            common_scale(&arm(1.0, 0.3), &arm(1.0, 0.0), &BTreeSet::new()),
            None,
            "a robot's own errors have no common sign"
        );
        assert_eq!(
            common_scale(&arm(1.0001, 0.0), &arm(1.0, 0.0), &BTreeSet::new()),
            None,
            "a warm robot is no wrong scale"
        );
    }
}
