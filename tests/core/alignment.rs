//! The alignment check: files that are wrong as a whole are found by fitting the nominal robot to them, and correct files are not refused.

use crate::data::paper_robot;
use crate::robots::{CLEAN, Tolerances, clean_robots, measured, models};
use crate::simulation::{
    Campaign, Normal, limited, links_alone, measure, poses, robot_of_the_priors,
};
use kincal::calibration::upload_checks::alignment::{
    Alignment, BETTER, Explanation, FITS, Suspicion, align, explain,
};
use kincal::calibration::{CalibrationRequest, Method, calibrate};
use kincal::kinematics::{JointMap, Robot};
use kincal::measurement::table::own_form;
use kincal::measurement::{Frame, MeasurementSet};
use nalgebra::{DMatrix, DVector, IsometryMatrix3, Rotation3, Translation3, Vector3};
use rand::RngExt;
use std::f64::consts::PI;
use std::ops::ControlFlow;

/// Number of robots; the study in docs/alignment.md does 1,000.
const SHORT_STUDY: usize = 120;
/// Largest share of correct files that may be refused.
const REFUSED_AT_MOST: f64 = 0.01;

fn check_upload(
    robot: &Robot,
    set: &MeasurementSet,
    others: &[(String, Robot)],
) -> Option<Explanation> {
    match align(robot, set) {
        Alignment::Fits => None,
        Alignment::Misses(rms_mm) => Some(explain(robot, set, rms_mm, others)),
    }
}

#[track_caller]
fn suspicion(robot: &Robot, set: &MeasurementSet) -> Suspicion {
    match check_upload(robot, set, &[]) {
        Some(Explanation::Refusal(found)) => found,
        other => panic!("not refused: {other:?}"),
    }
}

#[track_caller]
fn wrong(robot: &Robot, set: &MeasurementSet, code: &str, words: &str) {
    let found = suspicion(robot, set);
    let detail = found.detail;
    assert_eq!(found.code, code, "{detail}");
    assert!(detail.contains(words), "{detail:?} does not say {words:?}");
}

#[track_caller]
fn not_refused(robot: &Robot, set: &MeasurementSet, what: &str) {
    if let Some(Explanation::Refusal(found)) = check_upload(robot, set, &[]) {
        panic!("{what}: {found:?}");
    }
}

fn changed(
    set: &MeasurementSet,
    change: impl Fn(&mut Vec<f64>, &mut Vector3<f64>),
) -> MeasurementSet {
    let mut set = set.clone();
    set.points
        .iter_mut()
        .for_each(|p| change(&mut p.q_rad, &mut p.position_mm));
    set
}

/// Simulated robots of several makes, in both frames.
fn for_each_make(test: impl Fn(&str, &Robot, &MeasurementSet)) {
    for (seed, (name, nominal)) in models().into_iter().enumerate() {
        for frame in [Frame::Base, Frame::Instrument] {
            let set = measured(
                &nominal,
                &Tolerances { frame, ..CLEAN },
                &mut Normal::new(seed as u64),
            );
            test(name, &nominal, &set);
        }
    }
}

#[test]
fn right_files_are_not_refused() {
    let counts = clean_robots(SHORT_STUDY, 1);
    let refused: usize = counts.iter().map(|(_, [refused, ..])| refused).sum();
    assert!(
        refused as f64 <= REFUSED_AT_MOST * SHORT_STUDY as f64,
        "{counts:?}"
    );
}

#[test]
fn measured_robots_fit_without_a_remark() {
    let Some(root) = crate::data::real_data() else {
        return;
    };
    for (file, frame) in [
        ("motoman_ma1400/visit_1.csv", Frame::Instrument),
        ("motoman_ma1400/visit_2.csv", Frame::Instrument),
        ("qkm_hl6/set.csv", Frame::Instrument),
    ] {
        let path = root.join(file);
        let robot = crate::data::robot(&path.parent().unwrap().join("robot.json"));
        let set =
            own_form::parse(&std::fs::read(&path).unwrap(), frame, robot.links.len()).unwrap();
        assert_eq!(check_upload(&robot, &set, &[]), None, "{file}");
    }
}

/// Turning the base of a symmetric arm by 180° has the effect of reversing joints 2, 3 and 5: positions cannot tell both apart.
#[test]
fn two_explanations_of_a_symmetric_arm_are_both_named_and_none_is_offered() {
    for id in ["kawasaki_rs007l", "doosan_a0509"] {
        let model = kincal::operations::robot_models::get(id).unwrap().unwrap();
        let mut robot = Robot::try_from(&model.robot).unwrap();
        robot.joint_map = None;
        for seed in 0..3 {
            let mut random = Normal::new(40 + seed);
            let made = Tolerances {
                frame: Frame::Base,
                ..CLEAN
            };
            let in_base = measured(&robot, &made, &mut random);
            let turned = changed(&in_base, |_, p| *p = Vector3::new(-p.x, -p.y, p.z));
            wrong(
                &robot,
                &turned,
                "frame_suspect",
                "It fits as well if joints 2, 3 and 5",
            );
            let mut seen = from_a_tracker(&in_base, reach_mm(&robot), &mut random);
            seen.frame = Frame::Instrument;
            let signs = [-1.0, 1.0, -1.0, 1.0, -1.0, 1.0];
            let seen = changed(&seen, |q, _| {
                q.iter_mut().zip(signs).for_each(|(q, sign)| *q *= sign);
            });
            wrong(&robot, &seen, "joint_map_suspect", "It fits as well if");
            assert_eq!(suspicion(&robot, &seen).joint_map, None, "{id}");
        }
    }
}

#[test]
fn radians_given_as_degrees_and_the_other_way_round_are_found() {
    for_each_make(|_, robot, set| {
        let as_degrees = changed(set, |q, _| q.iter_mut().for_each(|q| *q = q.to_radians()));
        wrong(
            robot,
            &as_degrees,
            "unit_suspect",
            "the joint values are radians and were given as degrees",
        );
        let as_radians = changed(set, |q, _| q.iter_mut().for_each(|q| *q = q.to_degrees()));
        wrong(
            robot,
            &as_radians,
            "unit_suspect",
            "the joint values are degrees and were given as radians",
        );
    });
}

#[test]
fn metres_given_as_millimetres_and_the_other_way_round_are_found() {
    for_each_make(|_, robot, set| {
        wrong(
            robot,
            &changed(set, |_, p| *p *= 0.001),
            "unit_suspect",
            "the positions are metres and were given as millimetres",
        );
        wrong(
            robot,
            &changed(set, |_, p| *p *= 1000.0),
            "unit_suspect",
            "the positions are millimetres and were given as metres",
        );
    });
}

#[test]
fn one_position_in_all_rows_is_refused() {
    for_each_make(|_, robot, set| {
        let stuck = changed(set, |_, p| *p = Vector3::new(1000.0, 0.0, 500.0));
        suspicion(robot, &stuck);
    });
}

#[test]
fn both_units_wrong_are_found() {
    for_each_make(|_, robot, set| {
        let both = changed(set, |q, p| {
            q.iter_mut().for_each(|q| *q = q.to_radians());
            *p *= 0.001;
        });
        wrong(robot, &both, "unit_suspect", "radians");
    });
}

#[test]
fn swapped_position_columns_and_a_mirrored_axis_are_found() {
    for_each_make(|name, robot, set| {
        let swapped = changed(set, |_, p| p.swap((0, 0), (1, 0)));
        let mirrored = changed(set, |_, p| p.z = -p.z);
        if set.frame == Frame::Instrument {
            // All left-handed files look alike, and like a controller with opposite signs of some joints.
            for file in [swapped, mirrored] {
                let found = suspicion(robot, &file);
                let is_told = match found.code {
                    "joint_map_suspect" => found.detail.contains("left-handed"),
                    code => code == "column_suspect",
                };
                assert!(is_told, "{name}: {found:?}");
            }
            return;
        }
        let order = "x, y, z stand in the columns named y, x, z";
        wrong(robot, &swapped, "column_suspect", order);
        wrong(robot, &mirrored, "column_suspect", "z has the wrong sign");
    });
}

#[test]
fn swapped_joint_columns_and_a_joint_counted_the_other_way_are_found() {
    for_each_make(|_, robot, set| {
        wrong(
            robot,
            &changed(set, |q, _| q.swap(1, 2)),
            "column_suspect",
            "the columns of joints 2 and 3 are exchanged",
        );
        wrong(
            robot,
            &changed(set, |q, _| q[2] = -q[2]),
            "joint_map_suspect",
            "joint 3 is counted the other way round",
        );
    });
}

#[test]
fn shifted_rows_are_found() {
    for_each_make(|_, robot, set| {
        let mut shifted = set.clone();
        for row in 1..set.points.len() {
            shifted.points[row].position_mm = set.points[row - 1].position_mm;
        }
        wrong(
            robot,
            &shifted,
            "column_suspect",
            "1 row(s) below its joint values",
        );
    });
}

#[test]
fn a_set_of_another_known_robot_is_found_by_its_name() {
    let models = models();
    let set = measured(&models[1].1, &CLEAN, &mut Normal::new(5));
    let known = [
        ("cell 7".to_owned(), models[2].1.clone()),
        ("cell 9".to_owned(), models[1].1.clone()),
    ];
    match check_upload(&models[0].1, &set, &known) {
        Some(Explanation::Refusal(found)) if found.code == "robot_mismatch" => {
            assert_eq!(found.columns, None);
            assert!(found.detail.contains("cell 9"), "{}", found.detail);
        }
        other => panic!("{other:?}"),
    }
    // An unknown robot fits no hypothesis.
    wrong(&models[0].1, &set, "poor_alignment", "is it this robot");
}

#[test]
fn an_unmastered_joint_alone_warns_and_names_the_joint() {
    for_each_make(|name, robot, set| {
        let unmastered = changed(set, |q, _| q[2] += 4.0f64.to_radians());
        match check_upload(robot, &unmastered, &[]) {
            Some(Explanation::Warning {
                code: "joint_offset_suspect",
                detail,
            }) => {
                assert!(detail.contains("(joint 3)"), "{name}: {detail}");
                assert!(detail.ends_with("an unmastered joint?"), "{detail}");
            }
            None => {} // a small arm: 4° are less than the limit
            Some(Explanation::Warning {
                code: "poor_alignment",
                ..
            }) if name == "four axes" => {} // hardly above the limit
            other => panic!("{name}: {other:?}"),
        }
    });
}

/// The set in the frame of an instrument that stands somewhere: levelled, and turned about the vertical.
fn from_a_tracker(set: &MeasurementSet, reach_mm: f64, random: &mut Normal) -> MeasurementSet {
    let mut uniform = |from: f64, to: f64| from + (to - from) * random.0.random::<f64>();
    let (yaw, away, bearing) = (uniform(-PI, PI), uniform(1.0, 3.0), uniform(-PI, PI));
    let at = Vector3::new(
        away * bearing.cos(),
        away * bearing.sin(),
        uniform(-0.5, 0.5),
    ) * reach_mm;
    let placed = IsometryMatrix3::from_parts(
        Translation3::from(at),
        Rotation3::from_axis_angle(&Vector3::z_axis(), yaw),
    );
    changed(set, |_, p| {
        *p = placed.rotation * *p + placed.translation.vector;
    })
}

fn reach_mm(robot: &Robot) -> f64 {
    robot.links.iter().map(|l| l.a_mm.hypot(l.d_mm)).sum()
}

#[test]
fn a_base_frame_file_turned_by_quarter_turns_is_told_as_another_frame_and_not_as_joint_1() {
    let made = Tolerances {
        frame: Frame::Base,
        ..CLEAN
    };
    for (seed, (name, robot)) in models().into_iter().enumerate() {
        let in_base = measured(&robot, &made, &mut Normal::new(seed as u64));
        for quarter_turns in 1..4 {
            if name == "seven axes" && quarter_turns == 2 {
                continue; // the same arm with opposite signs of joints 2, 4 and 6
            }
            let turn =
                Rotation3::from_axis_angle(&Vector3::z_axis(), f64::from(quarter_turns) * PI / 2.0);
            let mut set = changed(&in_base, |_, p| *p = turn * *p);
            wrong(&robot, &set, "frame_suspect", "in the frame instrument");
            set.frame = Frame::Instrument;
            assert_eq!(
                check_upload(&robot, &set, &[]),
                None,
                "{name} {quarter_turns}"
            );
        }
    }
}

#[test]
fn makers_signs_are_found_on_a_robot_with_unmastered_joints() {
    let kuka = [-1.0, 1.0, 1.0, -1.0, 1.0, -1.0];
    for (seed, (name, robot)) in models().into_iter().take(4).enumerate() {
        for frame in [Frame::Base, Frame::Instrument] {
            let made = Tolerances { frame, ..CLEAN };
            let set = measured(&robot, &made, &mut Normal::new(seed as u64));
            let set = changed(&set, |q, _| {
                q[2] -= 4.0f64.to_radians();
                q.iter_mut().zip(kuka).for_each(|(q, sign)| *q *= sign);
            });
            let found = suspicion(&robot, &set);
            assert_eq!(found.code, "joint_map_suspect", "{name}: {}", found.detail);
            // With this convention, only the joint's offset remains.
            let mended = Robot {
                joint_map: found.joint_map,
                ..robot.clone()
            };
            not_refused(&mended, &set, &found.detail);
        }
    }
}

/// The same robot and its files in another size.
fn scaled(robot: &Robot, by: f64) -> Robot {
    let mut robot = robot.clone();
    for link in &mut robot.links {
        link.a_mm *= by;
        link.d_mm *= by;
    }
    robot
}

#[test]
fn a_tracker_file_read_as_base_frame_is_refused_in_24_levelled_placements_and_fits_when_it_is_read_as_told()
 {
    let made = Tolerances {
        frame: Frame::Base,
        ..CLEAN
    };
    for (seed, (name, robot)) in models().into_iter().enumerate() {
        for placement in 0..if name == "paper" { 24 } else { 4 } {
            let mut random = Normal::new(100 * seed as u64 + placement);
            let in_base = measured(&robot, &made, &mut random);
            let mut set = from_a_tracker(&in_base, reach_mm(&robot), &mut random);
            wrong(&robot, &set, "frame_suspect", "in the frame instrument");
            set.frame = Frame::Instrument;
            assert_eq!(check_upload(&robot, &set, &[]), None, "{name} {placement}");
        }
    }
}

#[test]
fn a_tracker_file_of_a_robot_with_an_unmastered_joint_read_as_base_frame_is_refused_too() {
    for (seed, (_, robot)) in models().into_iter().enumerate() {
        let mut random = Normal::new(seed as u64);
        let set = measured(&robot, &CLEAN, &mut random);
        let mut set = from_a_tracker(&set, reach_mm(&robot), &mut random);
        set = changed(&set, |q, _| q[1] += 10.0f64.to_radians());
        set.frame = Frame::Base;
        wrong(&robot, &set, "frame_suspect", "in the frame instrument");
        set.frame = Frame::Instrument;
        not_refused(&robot, &set, "read in its own frame");
    }
}

#[test]
fn a_base_frame_known_to_some_millimetres_and_tenths_of_a_degree_is_not_refused() {
    let made = Tolerances {
        frame: Frame::Base,
        ..CLEAN
    };
    for (seed, (name, robot)) in models().into_iter().enumerate() {
        for other in 0..3 {
            let mut random = Normal::new(10 * other + seed as u64);
            let set = measured(&robot, &made, &mut random);
            let turn = Rotation3::new(random.vector() * 0.3f64.to_radians());
            let shift = random.vector() * 3.0;
            let set = changed(&set, |_, p| *p = turn * *p + shift);
            not_refused(&robot, &set, name);
        }
    }
}

#[test]
fn a_turn_about_joint_1_alone_is_an_unmastered_joint_up_to_45_degrees_and_another_frame_beyond() {
    let (_, robot) = models().swap_remove(0);
    let made = Tolerances {
        frame: Frame::Base,
        ..CLEAN
    };
    for turn_deg in [-40.0f64, -20.0, 8.0, 30.0, 53.0, -70.0, 130.0] {
        let set = measured(&robot, &made, &mut Normal::new(9));
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), turn_deg.to_radians());
        let set = changed(&set, |_, p| *p = turn * *p);
        match check_upload(&robot, &set, &[]) {
            Some(Explanation::Warning {
                code: "joint_offset_suspect",
                detail,
            }) if turn_deg.abs() < 45.0 => {
                assert!(detail.contains("(joint 1)"), "{detail}");
                let both = "a frame that is turned about axis 1, which looks the same";
                assert!(detail.contains(both), "{detail}");
            }
            Some(Explanation::Refusal(found)) if turn_deg.abs() > 45.0 => {
                assert_eq!(found.code, "frame_suspect", "{turn_deg}: {found:?}");
            }
            other => panic!("{turn_deg}: {other:?}"),
        }
    }
}

/// A maker's convention: signs, coupling of joint 2 into joint 3, and zeros in quarter turns. Missing entries are zero.
type Convention = (&'static str, &'static [i8], i8, &'static [i8]);

const CONVENTIONS: &[Convention] = &[
    ("KUKA", &[-1, 1, 1, -1, 1, -1], 0, &[]),
    ("joint 5 reversed", &[1, 1, 1, 1, -1], 0, &[]),
    ("upper arm reversed", &[1, -1, -1], 0, &[]),
    ("FANUC", &[], 1, &[]),
    ("linkage", &[], -1, &[]),
    ("FANUC, signs", &[1, 1, -1, -1, -1, -1], 1, &[]),
    ("joint 2 from the horizontal", &[], 0, &[0, 1]),
    ("joint 3 stretched", &[], 0, &[0, 0, -1]),
    ("joints 2 and 3", &[], 0, &[0, -1, 1]),
    ("KUKA, zeros", &[-1, 1, 1, -1, 1, -1], 0, &[0, -1, 1]),
    ("FANUC, zero", &[], 1, &[0, 1]),
];

fn joint_map((_, sign, coupling, turns): Convention, n: usize) -> JointMap {
    let at = |list: &[i8], joint: usize, default: i8| {
        f64::from(list.get(joint).copied().unwrap_or(default))
    };
    let mut matrix = DMatrix::identity(n, n);
    matrix[(2, 1)] = f64::from(coupling);
    JointMap {
        sign: (0..n).map(|joint| at(sign, joint, 1)).collect(),
        offset_rad: (0..n).map(|joint| at(turns, joint, 0) * PI / 2.0).collect(),
        coupling: matrix,
    }
}

/// The file in a controller's joint convention.
fn as_counted_by(map: &JointMap, set: &MeasurementSet) -> MeasurementSet {
    let inverse = map.rates().try_inverse().unwrap();
    let offset = DVector::from_column_slice(&map.offset_rad);
    changed(set, |q, _| {
        let model = DVector::from_column_slice(q);
        *q = (&inverse * (model - &offset)).iter().copied().collect();
    })
}

#[test]
fn makers_joint_conventions_are_told_with_the_joint_map_that_mends_them() {
    for_each_make(|name, robot, set| {
        for convention in CONVENTIONS {
            let what = format!("{name}, {:?}, {}", set.frame, convention.0);
            let map = joint_map(*convention, robot.links.len());
            let file = as_counted_by(&map, set);
            if file == *set {
                continue; // for joints that this arm does not have
            }
            let Some(found) = check_upload(robot, &file, &[]) else {
                // For some arms conventions are equivalent: a sign change of all joints of a planar arm turns its base.
                assert_eq!(set.frame, Frame::Instrument, "{what}");
                continue;
            };
            let Explanation::Refusal(found) = found else {
                panic!("{what}: {found:?}");
            };
            assert_eq!(found.code, "joint_map_suspect", "{what}: {found:?}");
            if found.joint_map.is_none() {
                // symmetric arms have two equivalent conventions: both are named, and none is offered
                let is_named = found.detail.contains("It fits as well if joint");
                assert!(is_named && name == "seven axes", "{what}: {}", found.detail);
                continue;
            }
            let mut mended = robot.clone();
            mended.joint_map = found.joint_map;
            assert_eq!(
                check_upload(&mended, &file, &[]),
                None,
                "{what}: {}",
                found.detail
            );
        }
    });
}

#[test]
fn the_joint_map_of_the_papers_arm_is_the_makers_own() {
    let (_, robot) = models().swap_remove(0);
    for frame in [Frame::Base, Frame::Instrument] {
        let set = measured(&robot, &Tolerances { frame, ..CLEAN }, &mut Normal::new(8));
        for convention in &CONVENTIONS[..6] {
            let map = joint_map(*convention, 6);
            let found = suspicion(&robot, &as_counted_by(&map, &set));
            assert_eq!(
                found.joint_map,
                Some(map),
                "{frame:?} {}: {}",
                convention.0,
                found.detail
            );
        }
    }
}

/// Too few points for a search of all conventions: a mirrored frame alone would be told, and a mirrored robot identified.
#[test]
fn with_few_points_makers_signs_are_told_and_no_mirrored_frame_alone() {
    let (_, robot) = models().swap_remove(0);
    for (frame, n_points) in [(Frame::Instrument, 10), (Frame::Base, 8)] {
        let clean = Tolerances { frame, ..CLEAN };
        let mut set = measured(&robot, &clean, &mut Normal::new(8));
        set.points.truncate(n_points);
        let map = joint_map(CONVENTIONS[0], 6);
        let found = suspicion(&robot, &as_counted_by(&map, &set));
        assert_eq!(found.code, "joint_map_suspect", "{frame:?}: {found:?}");
        assert_eq!(found.joint_map, Some(map), "{frame:?}: {}", found.detail);
    }
}

#[test]
fn a_joint_map_that_the_robot_has_already_is_mended_and_not_replaced() {
    let (_, mut robot) = models().swap_remove(0);
    let set = measured(&robot, &CLEAN, &mut Normal::new(8));
    let file = as_counted_by(&joint_map(CONVENTIONS[0], 6), &set);
    robot.joint_map = Some(joint_map(CONVENTIONS[10], 6));
    let found = suspicion(&robot, &file);
    robot.joint_map = found.joint_map;
    assert_eq!(check_upload(&robot, &file, &[]), None, "{}", found.detail);
}

#[test]
fn a_coupling_that_only_the_joint_map_has_is_told_as_such() {
    let (_, mut robot) = models().swap_remove(0);
    let file = measured(&robot, &CLEAN, &mut Normal::new(8));
    robot.joint_map = Some(joint_map(CONVENTIONS[3], 6));
    let found = suspicion(&robot, &file);
    let told = "joint 3 does not move with joint 2, as the robot's joint_map says it does";
    assert!(found.detail.contains(told), "{}", found.detail);
    robot.joint_map = found.joint_map;
    assert_eq!(check_upload(&robot, &file, &[]), None, "{}", found.detail);
}

#[test]
fn unmastered_joints_of_up_to_30_degrees_are_not_refused() {
    for_each_make(|name, robot, set| {
        for seed in 0..4 {
            let mut random = Normal::new(seed);
            let n = robot.links.len();
            let off: Vec<f64> = (0..n)
                .map(|_| 30.0f64.to_radians() * (2.0 * random.0.random::<f64>() - 1.0))
                .collect();
            let is_off = |joint: usize| seed > 1 || joint == seed as usize + 1;
            let file = changed(set, |q, _| {
                (0..n)
                    .filter(|joint| is_off(*joint))
                    .for_each(|joint| q[joint] += off[joint]);
            });
            not_refused(robot, &file, &format!("{name} {:?} {seed}", set.frame));
        }
    });
}

#[test]
fn files_with_a_tenth_of_gross_rows_are_not_refused() {
    for_each_make(|name, robot, set| {
        for seed in 0..3 {
            let mut random = Normal::new(seed);
            let mut file = set.clone();
            let n = file.points.len();
            for _ in 0..n / 10 {
                let row = (random.0.random::<f64>() * n as f64) as usize;
                let far = random.vector() * reach_mm(robot);
                file.points[row].position_mm += far;
            }
            not_refused(robot, &file, &format!("{name} {:?} {seed}", set.frame));
        }
    });
}

#[test]
fn another_robot_is_refused_whatever_its_frame() {
    let models = models();
    for (seed, (name, measured_on)) in models.iter().enumerate() {
        for frame in [Frame::Base, Frame::Instrument] {
            let set = measured(
                measured_on,
                &Tolerances { frame, ..CLEAN },
                &mut Normal::new(seed as u64),
            );
            let same_joints =
                |robot: &&(&str, Robot)| robot.1.links.len() == measured_on.links.len();
            for (other, robot) in models.iter().filter(|m| m.0 != *name).filter(same_joints) {
                match check_upload(robot, &set, &[]) {
                    Some(Explanation::Refusal(_)) => {}
                    found => panic!("a file of {name} on {other}, {frame:?}: {found:?}"),
                }
            }
        }
    }
}

#[test]
fn arms_of_ten_millimetres_and_of_twenty_metres_are_judged_by_their_reach() {
    let (_, paper) = models().swap_remove(0);
    for by in [0.005, 8.0] {
        let robot = scaled(&paper, by);
        for frame in [Frame::Base, Frame::Instrument] {
            let mut random = Normal::new(4);
            let making = Tolerances { frame, ..CLEAN };
            let set = changed(&measured(&paper, &making, &mut random), |_, p| *p *= by);
            assert_eq!(check_upload(&robot, &set, &[]), None, "{by} {frame:?}");
            let kuka = as_counted_by(&joint_map(CONVENTIONS[0], 6), &set);
            wrong(&robot, &kuka, "joint_map_suspect", "joints 1, 4 and 6");
            let unmastered = changed(&set, |q, _| q[2] += 20.0f64.to_radians());
            not_refused(&robot, &unmastered, "unmastered");
            let mut tracker = from_a_tracker(&set, reach_mm(&robot), &mut random);
            tracker.frame = Frame::Base;
            wrong(&robot, &tracker, "frame_suspect", "in the frame instrument");
        }
    }
}

#[test]
fn too_few_points_say_nothing() {
    let (_, robot) = models().swap_remove(0);
    let mut set = measured(
        &robot,
        &Tolerances {
            n_points: 4,
            ..CLEAN
        },
        &mut Normal::new(3),
    );
    set.points.iter_mut().for_each(|p| p.position_mm *= 1000.0);
    assert_eq!(check_upload(&robot, &set, &[]), None);
}

/// Files of few points, in the base frame: number of points and of reflectors.
const FEW: [(usize, usize); 6] = [(5, 1), (6, 1), (7, 1), (8, 1), (12, 3), (18, 3)];

fn of_few_points((n_points, n_targets): (usize, usize), frame: Frame) -> Tolerances {
    Tolerances {
        frame,
        n_points,
        n_targets,
        ..CLEAN
    }
}

#[test]
fn a_few_points_of_a_tracker_read_as_base_frame_are_refused() {
    for (seed, (name, robot)) in models().into_iter().enumerate() {
        for few in FEW {
            for placement in 0..4 {
                let mut random = Normal::new(1000 * seed as u64 + placement);
                let in_base = measured(&robot, &of_few_points(few, Frame::Base), &mut random);
                let mut set = from_a_tracker(&in_base, reach_mm(&robot), &mut random);
                let found = suspicion(&robot, &set);
                assert_eq!(
                    found.code, "frame_suspect",
                    "{name} {few:?} {placement}: {found:?}"
                );
                set.frame = Frame::Instrument;
                assert_eq!(
                    check_upload(&robot, &set, &[]),
                    None,
                    "{name} {few:?} {placement}"
                );
            }
        }
    }
}

#[test]
fn right_files_of_few_points_are_not_refused() {
    for (seed, (name, robot)) in models().into_iter().enumerate() {
        for (few, frame) in FEW
            .into_iter()
            .flat_map(|few| [(few, Frame::Base), (few, Frame::Instrument)])
        {
            for (robot_of, off_deg) in (0..8).flat_map(|r| [(r, 0.0f64), (r, 20.0)]) {
                let mut random = Normal::new(1000 * seed as u64 + robot_of);
                let set = measured(&robot, &of_few_points(few, frame), &mut random);
                let set = changed(&set, |q, _| {
                    q[1 + robot_of as usize % 3] += off_deg.to_radians()
                });
                let what = format!("{name} {few:?} {frame:?} {robot_of} {off_deg}");
                not_refused(&robot, &set, &what);
            }
        }
    }
}

/// Eight points of each reflector, or nine of one: none has enough for a search of all conventions.
#[test]
fn makers_conventions_are_told_from_few_points_and_from_several_reflectors() {
    for (seed, (name, robot)) in models().into_iter().enumerate() {
        if robot.links.len() != 6 {
            continue;
        }
        for (few, frame) in [(9, 1), (24, 3)]
            .into_iter()
            .flat_map(|few| [(few, Frame::Base), (few, Frame::Instrument)])
        {
            for convention in [
                CONVENTIONS[0],
                ("FANUC", &[1, 1, -1, -1, -1, -1], 1, &[]),
                CONVENTIONS[3],
                CONVENTIONS[4],
            ] {
                let mut random = Normal::new(seed as u64);
                let set = measured(&robot, &of_few_points(few, frame), &mut random);
                let file = as_counted_by(&joint_map(convention, 6), &set);
                let what = format!("{name} {few:?} {frame:?} {}", convention.0);
                let Some(found) = check_upload(&robot, &file, &[]) else {
                    panic!("{what}: taken");
                };
                let Explanation::Refusal(found) = found else {
                    panic!("{what}: {found:?}");
                };
                assert_eq!(found.code, "joint_map_suspect", "{what}: {found:?}");
                let mut mended = robot.clone();
                mended.joint_map = found.joint_map;
                assert_eq!(check_upload(&mended, &file, &[]), None, "{what}");
            }
        }
    }
}

// Twice the errors of real robots; and a hypothesis must fit several times better.
const _: () = assert!(FITS >= 2.0 * 0.005 && BETTER >= 5.0);

/// The warnings of an identification where the controller counts joint 6 `sign` times as the nominal robot does, from one reflector.
fn warned_with(
    nominal: &Robot,
    seed: u64,
    sign: f64,
    reflector_mm: Vector3<f64>,
) -> Vec<(&'static str, String)> {
    warned_where(nominal, seed, |q| q[5] *= sign, reflector_mm)
}

/// The same where the controller shows other joint values.
fn warned_where(
    nominal: &Robot,
    seed: u64,
    shown: impl Fn(&mut [f64]),
    reflector_mm: Vector3<f64>,
) -> Vec<(&'static str, String)> {
    let mut random = Normal::new(seed);
    let mut truth = robot_of_the_priors(nominal, 1, &mut random);
    truth.targets_mm[0] = reflector_mm;
    let poses = poses(60, &mut random);
    let mut set = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
    for point in &mut set.points {
        shown(&mut point.q_rad);
        // half of them to verify on
        point.subset = None;
    }
    let request = links_alone(&CalibrationRequest::new(nominal.clone(), set));
    let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
    let warnings = report.warnings.into_iter();
    warnings.map(|w| (w.code, w.detail)).collect()
}

#[test]
fn a_last_joint_that_counts_the_other_way_is_told_from_a_reflector_a_fifth_of_a_millimetre_off_its_axis()
 {
    let nominal = limited(paper_robot());
    for off_mm in [0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 6.0] {
        for seed in 0..6 {
            let reflector_mm = Vector3::new(0.6 * off_mm, -0.8 * off_mm, 120.0);
            for (sign, is_told) in [(-1.0, true), (1.0, false)] {
                let warnings = warned_with(&nominal, seed, sign, reflector_mm);
                let told = warnings
                    .iter()
                    .any(|(code, _)| ["joint_map_suspect", "no_fit"].contains(code));
                assert_eq!(
                    told, is_told,
                    "{off_mm} mm, seed {seed}, {sign}: {warnings:?}"
                );
                assert!(
                    warnings
                        .iter()
                        .all(|(_, detail)| !detail.contains("They fit as well")),
                    "{off_mm} mm, seed {seed}: {warnings:?}"
                );
            }
        }
    }
}

/// With the reflector near the last axis, a wrist whose last two joints turn together fits to some millimetres, and turns the flange by up to half a turn.
#[test]
fn a_last_joint_that_turns_with_the_one_before_is_told() {
    let nominal = limited(paper_robot());
    for off_mm in [1.0, 2.0, 4.0, 8.0] {
        for seed in 0..3 {
            let reflector_mm = Vector3::new(0.8 * off_mm, 0.6 * off_mm, 60.0);
            for coupling in [1.0, -1.0] {
                let shown = |q: &mut [f64]| q[5] += coupling * q[4];
                let warnings = warned_where(&nominal, seed, shown, reflector_mm);
                let told = warnings
                    .iter()
                    .any(|(code, _)| ["joint_map_suspect", "no_fit"].contains(code));
                assert!(told, "{off_mm} mm, seed {seed}, {coupling}: {warnings:?}");
            }
        }
    }
}

#[test]
fn of_a_reflector_on_the_last_axis_it_is_said_that_the_joint_may_count_either_way() {
    let nominal = limited(paper_robot());
    for seed in 0..6 {
        for sign in [-1.0, 1.0] {
            let warnings = warned_with(&nominal, seed, sign, Vector3::new(0.0, 0.0, 120.0));
            assert!(
                warnings
                    .iter()
                    .any(|(code, detail)| *code == "pose_not_seen"
                        && detail.contains("fit as well with joint 6 counted the other way round")),
                "seed {seed}: {warnings:?}"
            );
            assert!(
                warnings
                    .iter()
                    .all(|(code, _)| *code != "joint_map_suspect"),
                "{warnings:?}"
            );
        }
    }
}

/// Few poses of a small part of the workspace, with three joints counted the other way round: a mirrored robot fits them with a reflector that is
/// farther away than the arm is long. The fit to all points tells it also where the fit to the identify subset does not.
#[test]
fn a_reflector_farther_away_than_the_arm_is_long_is_told_of_the_delivered_fit() {
    let Some(root) = crate::data::real_data() else {
        return;
    };
    let folder = root.join("motoman_ma1400");
    let robot = crate::data::robot(&folder.join("robot.json"));
    let file = std::fs::read(folder.join("visit_1.csv")).unwrap();
    let visit = own_form::parse(&file, Frame::Instrument, 6).unwrap();
    for n_rows in [20, 22, 25] {
        for seed in 0..3 {
            let mut set = visit.clone();
            set.points.truncate(n_rows);
            for point in &mut set.points {
                for joint in [0, 3, 5] {
                    point.q_rad[joint] *= -1.0;
                }
            }
            let request = CalibrationRequest {
                method: Method::Pso,
                seed,
                ..CalibrationRequest::new(robot.clone(), set)
            };
            let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
            let codes: Vec<_> = report.warnings.iter().map(|w| w.code).collect();
            let farthest = report.targets_mm.iter().map(|t| t.norm());
            println!(
                "{n_rows} rows, seed {seed}: {:.0} mm {codes:?}",
                farthest.fold(0.0, f64::max)
            );
            let told = codes
                .iter()
                .any(|code| ["joint_map_suspect", "no_fit"].contains(code));
            assert!(told, "{n_rows} rows, seed {seed}: {codes:?}");
        }
    }
}

/// Half a turn of joint 5 puts a reflector on the last axis behind the wrist, and nothing else shows it.
#[test]
fn a_reflector_that_is_found_inside_the_arm_is_no_reflector() {
    let nominal = limited(paper_robot());
    for seed in 0..6 {
        for (turned_deg, is_told) in [(180.0, true), (0.0, false)] {
            let mut random = Normal::new(seed);
            let mut truth = robot_of_the_priors(&nominal, 1, &mut random);
            truth.targets_mm[0] = Vector3::new(0.0, 0.0, 120.0);
            let poses = poses(60, &mut random);
            let mut set = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
            for point in &mut set.points {
                point.q_rad[4] += f64::to_radians(turned_deg);
                point.subset = None;
            }
            let request = links_alone(&CalibrationRequest::new(nominal.clone(), set));
            let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
            let told = report
                .warnings
                .iter()
                .find(|w| w.code == "joint_map_suspect");
            assert_eq!(
                told.is_some(),
                is_told,
                "seed {seed}: {:?}",
                report.warnings
            );
            if let Some(told) = told {
                assert!(told.detail.contains("behind the wrist"), "{}", told.detail);
            }
        }
    }
}

#[test]
fn columns_that_look_like_a_makers_signs_are_told_with_those() {
    let nominal = limited(paper_robot());
    let mut random = Normal::new(77);
    let truth = robot_of_the_priors(&nominal, 1, &mut random);
    let mut truth = truth;
    truth.t_instrument_base = IsometryMatrix3::identity();
    truth.targets_mm[0] = Vector3::new(40.0, -60.0, 150.0);
    let poses = poses(60, &mut random);
    let mut set = measure(&truth, &poses, &Campaign::PLAIN, &mut random);
    set.frame = Frame::Base;
    let signs = [-1.0, 1.0, 1.0, -1.0, 1.0, -1.0];
    for point in &mut set.points {
        point.q_rad[0] -= PI / 2.0;
        point
            .q_rad
            .iter_mut()
            .zip(signs)
            .for_each(|(q, sign)| *q *= sign);
    }
    let Some(Explanation::Refusal(suspicion)) = check_upload(&nominal, &set, &[]) else {
        panic!("not refused");
    };
    println!("{}: {}", suspicion.code, suspicion.detail);
    assert!(
        suspicion.detail.contains("joint_map is"),
        "{}",
        suspicion.detail
    );
    assert!(
        suspicion.detail.contains("mirrored"),
        "{}",
        suspicion.detail
    );
}

/// Signs that makers have: KUKA's, and FANUC's.
const MAKERS_SIGNS: [[f64; 6]; 2] = [
    [-1.0, 1.0, 1.0, -1.0, 1.0, -1.0],
    [1.0, 1.0, -1.0, -1.0, -1.0, -1.0],
];

#[test]
fn makers_signs_are_found_beside_any_one_joint_that_was_never_mastered() {
    let mut missed = Vec::new();
    for (seed, (name, robot)) in models().into_iter().enumerate() {
        if robot.links.len() != 6 {
            continue;
        }
        for frame in [Frame::Base, Frame::Instrument] {
            let made = Tolerances { frame, ..CLEAN };
            let set = measured(&robot, &made, &mut Normal::new(seed as u64));
            for signs in MAKERS_SIGNS {
                for (joint, off_deg) in [(1, 12.0f64), (2, -40.0), (3, 40.0), (4, -12.0)] {
                    let file = changed(&set, |q, _| {
                        q[joint] += off_deg.to_radians();
                        q.iter_mut().zip(signs).for_each(|(q, sign)| *q *= sign);
                    });
                    let found = check_upload(&robot, &file, &[]);
                    let is_told = match &found {
                        Some(Explanation::Refusal(found)) => found.joint_map.is_some(),
                        _ => false,
                    };
                    if !is_told {
                        missed.push(format!(
                            "{name} {frame:?} {signs:?} joint {} {off_deg} {found:?}",
                            joint + 1
                        ));
                    }
                }
            }
        }
    }
    assert!(
        missed.is_empty(),
        "{} missed:\n{}",
        missed.len(),
        missed.join("\n")
    );
}
