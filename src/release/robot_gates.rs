//! The gates that compare a set with the robot: its identity, how much the parameters change, and whether its orientation is known.

use crate::calibration::{
    BASE_FRAME_OFF, MIN_REFERENCE_PER_REACH, implausible_changes, last_joint_zero_remedy,
    last_joint_zero_unknown,
};
use crate::kinematics::reach_mm;
use crate::release::gate_facts::Facts;
use crate::release::orientation::{NOT_COMPUTED, NOT_COMPUTED_BY_OLDER_VERSION, Orientation};
use crate::wire::release::Gate;
use crate::wire::report_shape::Evidence;

/// Tolerance for equal nominal values: those in a report may have been converted to degrees and back.
const SAME_NOMINAL: f64 = 1e-6;
/// The active set is far off if its error is more than this many times that of the candidate on the same points.
const FAR_OFF_RATIO: f64 = 10.0;
/// The same limit, if the active set is no better than the nominal robot.
const FAR_OFF_RATIO_IF_NO_BETTER_THAN_NOMINAL: f64 = 3.0;

pub fn identity(facts: &Facts<'_>) -> Gate {
    let stated = stated_serial_number(facts);
    if let (Some(robots), Some(stated)) = (facts.serial_number, stated)
        && robots != stated
    {
        let detail = format!("the upload says serial number {stated:?}, the robot has {robots:?}");
        return Gate::new("identity", false, detail);
    }
    let nominal = |link: usize, name: &str| {
        let link = facts.stored.robot.links.get(link.checked_sub(1)?)?;
        Some(match name.rsplit_once('_')?.0 {
            "a" => link.a_mm,
            "alpha" => link.alpha_rad.to_degrees(),
            "d" => link.d_mm,
            "theta_offset" => link.theta_offset_rad.to_degrees(),
            "beta" => link.beta_rad.to_degrees(),
            _ => return None,
        })
    };
    let of_links = facts
        .stored
        .report
        .parameters
        .iter()
        .filter_map(|p| Some((p, p.link?)));
    let other = of_links.clone().find(|(p, link)| {
        nominal(*link, &p.name).is_some_and(|expected| (expected - p.nominal).abs() > SAME_NOMINAL)
    });
    match other {
        Some((p, _)) => Gate::new(
            "identity",
            false,
            format!(
                "{} is nominally {} in the report, which is not the robot's",
                p.name, p.nominal
            ),
        ),
        None if facts.content.links.len() != facts.stored.robot.links.len() => {
            Gate::new("identity", false, "the set has another number of links")
        }
        None => match (facts.serial_number, stated) {
            (Some(_), Some(stated)) => Gate::new(
                "identity",
                true,
                format!("serial number {stated:?}, the robot's nominal model"),
            ),
            _ => Gate::new(
                "identity",
                true,
                "the robot's nominal model; no serial number was stated with the upload",
            )
            .with_warning(true),
        },
    }
}

/// The first stated serial number that contradicts the robot's. If there is none, the serial number that all sets state.
fn stated_serial_number<'a>(facts: &Facts<'a>) -> Option<&'a str> {
    let all = facts.stated_serial_numbers;
    let contradicts = |stated: &&str| facts.serial_number.is_some_and(|own| own != *stated);
    let first = all.iter().copied().next().flatten();
    let of_all = first.filter(|_| all.iter().all(|other| *other == first));
    all.iter().copied().flatten().find(contradicts).or(of_all)
}

pub fn change(facts: &Facts<'_>) -> Gate {
    let (reference, name) = match facts.active {
        Some(active) => (active.kinematic_links(), "the active set"),
        None => (facts.stored.robot.links.clone(), "the nominal robot"),
    };
    let changes = implausible_changes(&facts.content.kinematic_links(), &reference);
    let mut warnings = facts.stored.report.warnings.iter();
    let base = warnings.find(|warning| warning.code == BASE_FRAME_OFF);
    let of_links =
        (!changes.is_empty()).then(|| format!("against {name} it changes {}", changes.join(", ")));
    let found: Vec<String> = of_links
        .into_iter()
        .chain(base.map(|warning| warning.detail.clone()))
        .collect();
    let is_far = !found.is_empty();
    let found: Vec<String> = found.into_iter().chain(active_far_off(facts)).collect();
    if found.is_empty() {
        return Gate::new(
            "change_plausible",
            true,
            format!("no parameter is far from {name}"),
        );
    }
    let found = found.join("; ");
    let needs_orientation = is_far && !facts.is_rollback;
    if let Some(unknown) = unknown_because(orientation_of(facts)).filter(|_| needs_orientation) {
        let detail = format!(
            "{found}, and {unknown}: a reason is not enough here. Identify from a reflector off the last axis, or from two"
        );
        return Gate::new("change_plausible", false, detail);
    }
    match facts.change_reason {
        Some(reason) => Gate::new(
            "change_plausible",
            true,
            format!("{found}; the reason given: {reason}"),
        )
        .with_warning(true),
        None if facts.is_rollback => Gate::new(
            "change_plausible",
            true,
            format!("{found}; the set was active before"),
        )
        .with_warning(true),
        None => {
            let detail = format!(
                "{found}: check the tool and the robot. If the change is right, say why in change_reason"
            );
            Gate::new("change_plausible", false, detail)
        }
    }
}

/// Description of the points on which the active set is far off and the candidate is not; `None` if there are none. Either the robot has
/// changed, or the file is of another robot.
fn active_far_off(facts: &Facts<'_>) -> Option<String> {
    let least_mm = MIN_REFERENCE_PER_REACH * reach_mm(&facts.stored.robot.links);
    let nominal_mm = facts
        .stored
        .report
        .verify
        .map(|verify| verify.before.rms_mm);
    let mut compared = facts.comparisons.iter();
    let far = compared.find_map(|comparison| {
        let rms = comparison.rms.as_ref().ok()?;
        let own_mm = rms.set_mm.max(least_mm);
        let is_useless = nominal_mm.is_some_and(|nominal_mm| rms.active_mm > nominal_mm);
        let times = if is_useless {
            FAR_OFF_RATIO_IF_NO_BETTER_THAN_NOMINAL
        } else {
            FAR_OFF_RATIO
        };
        (rms.active_mm > times * own_mm).then_some((comparison, rms))
    });
    far.map(|(comparison, rms)| {
        format!(
            "{}: the active set misses by {:.4} mm rms, this one by {:.4} mm: the robot, its tool or its base has changed, or the file is of another robot",
            comparison.points, rms.active_mm, rms.set_mm
        )
    })
}

fn orientation_of(facts: &Facts<'_>) -> Orientation {
    let report = &facts.stored.report;
    Orientation::new(
        report.flange_rotation_std_deg,
        report.last_joint_zero_std_deg,
        &report.warnings,
    )
}

/// Reason why the orientation counts as unknown; `None` if it is known. An unknown zero of the last joint alone does not count: it is no
/// sign of an error in the other links.
fn unknown_because(orientation: Orientation) -> Option<String> {
    match orientation {
        Orientation::NotComputed => Some(NOT_COMPUTED.into()),
        Orientation::NotComputedByOlderVersion => Some(NOT_COMPUTED_BY_OLDER_VERSION.into()),
        Orientation::NotShown { links_std_deg, .. } => Some(not_shown(links_std_deg)),
        Orientation::Known | Orientation::LastJointZeroUnknown { .. } => None,
    }
}

fn not_shown(std_deg: f64) -> String {
    format!(
        "the measured positions do not show how the flange is turned ({std_deg:.1}°, one standard deviation)"
    )
}

/// Points of one upload are fitted equally well with a wrongly rotated flange. Another session at least shows that the reflector's
/// positions are right.
pub fn orientation(facts: &Facts<'_>) -> Gate {
    let name = "orientation_known";
    let n_links = facts.stored.robot.links.len();
    let orientation = orientation_of(facts);
    let (found, remedy) = if let Orientation::NotShown { std_deg, .. } = orientation {
        (not_shown(std_deg), String::new())
    } else if let Some(unknown) = unknown_because(orientation) {
        (unknown, String::new())
    } else if let Orientation::LastJointZeroUnknown { std_deg } = orientation {
        let remedy = format!(". {}", last_joint_zero_remedy(n_links));
        (last_joint_zero_unknown(std_deg, n_links), remedy)
    } else {
        return Gate::new(name, true, "the orientation of the flange is not in doubt");
    };
    if facts.is_rollback {
        let detail = format!("{found}; the set was active before{remedy}");
        return Gate::new(name, true, detail).with_warning(true);
    }
    match facts.stored.evidence() {
        Evidence::IndependentSession => {
            let detail = format!(
                "{found}; another session shows that the position of the measured reflector is right: use the set for that alone{remedy}"
            );
            Gate::new(name, true, detail).with_warning(true)
        }
        _ => {
            let detail = format!(
                "{found}: identify from a reflector off the last axis, or from two, or show by another session that the reflector's positions \
                 are right{remedy}"
            );
            Gate::new(name, false, detail)
        }
    }
}
