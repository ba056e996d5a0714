//! A robot that is measured again: scored on another session, and what has changed since the last one.

#[path = "support/data.rs"]
mod data;
#[path = "support/simulation.rs"]
mod simulation;

use data::{paper_robot, real_data};
use kincal::calibration::report::CalibrationReport;
use kincal::calibration::request::VerifySource;
use kincal::calibration::{CalibrationRequest, Error, Method, Model, calibrate, check, check_verify, verify};
use kincal::identification::KinematicModel;
use kincal::identification::corrected::IdentifiedRobot;
use kincal::kinematics::Robot;
use kincal::measurement::{Frame, MeasurementSet, csv};
use nalgebra::IsometryMatrix3;
use simulation::{Campaign, Normal, measure, poses, true_robot};
use std::ops::ControlFlow;

fn identified(robot: &Robot, set: &MeasurementSet) -> KinematicModel {
    let request = CalibrationRequest { method: Method::LeastSquares, ..CalibrationRequest::new(robot.clone(), set.clone()) };
    let report = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap();
    KinematicModel { t_instrument_base: report.t_instrument_base, links: report.links, targets_mm: report.targets_mm }
}

fn scored(robot: &Robot, set: &MeasurementSet, model: Option<&KinematicModel>) -> CalibrationReport {
    let identified = model.cloned().map(IdentifiedRobot::of_links);
    verify(&CalibrationRequest::new(robot.clone(), set.clone()), identified.as_ref(), &mut |_| ControlFlow::Continue(())).unwrap()
}

/// Two sessions of one simulated robot: the tracker stands elsewhere and the reflectors are fixed anew.
fn two_sessions(seed: u64, change: impl Fn(&mut KinematicModel)) -> (MeasurementSet, MeasurementSet) {
    let mut random = Normal::new(seed);
    let first = true_robot(&paper_robot(), 2, &mut random);
    let mut second = true_robot(&paper_robot(), 2, &mut random);
    second.links = first.links.clone();
    change(&mut second);
    let campaign = Campaign { n_configurations: 40, n_targets: 2, ..Campaign::PLAIN };
    let mut session = |truth: &KinematicModel| measure(truth, &poses(40, &mut random), &campaign, &mut random);
    (session(&first), session(&second))
}

#[test]
fn a_calibrated_robot_is_better_than_the_nominal_one_on_another_session_wherever_the_tracker_stands() {
    let robot = paper_robot();
    let (first, second) = two_sessions(3, |_| ());
    let report = scored(&robot, &second, Some(&identified(&robot, &first)));
    let errors = report.verify.unwrap();
    assert_eq!((errors.n_points, report.identify.n_points, report.n_evaluations, report.per_point.len()), (80, 0, 0, 80));
    // noise of 0.03 mm in each coordinate is 0.052 mm
    assert!(errors.before.rms_mm > 0.5 && errors.after.rms_mm < 0.06, "{errors:?}");
    assert!(report.warnings.is_empty() && report.parameters.is_empty());
}

#[test]
fn a_parameter_set_that_is_no_better_than_nominal_is_said_to_be_so() {
    let robot = paper_robot();
    let (first, _) = two_sessions(4, |_| ());
    let (_, of_another_robot) = two_sessions(5, |_| ());
    let report = scored(&robot, &of_another_robot, Some(&identified(&robot, &first)));
    assert_eq!(report.warnings[0].code, "no_better_than_nominal");
    assert!(report.method_reason.contains("no better than the nominal one"), "{}", report.method_reason);
}

#[test]
fn each_visit_of_the_measured_robot_verifies_the_other() {
    let Some(real) = real_data() else { return };
    let folder = real.join("motoman_ma1400");
    let robot = data::robot(&folder.join("robot.json"));
    let visit = |name: &str| csv::parse(&std::fs::read(folder.join(name)).unwrap(), Frame::Instrument, 6).unwrap();
    let visits = [visit("visit_1.csv"), visit("visit_2.csv")];
    for (from, on) in [(0, 1), (1, 0)] {
        let errors = scored(&robot, &visits[on], Some(&identified(&robot, &visits[from]))).verify.unwrap();
        println!("visit {} on visit {}: {:.4} mm rms, nominal {:.4}", from + 1, on + 1, errors.after.rms_mm, errors.before.rms_mm);
        assert!(errors.after.rms_mm < 0.6 * errors.before.rms_mm);
    }
}

#[test]
fn too_few_points_to_place_base_and_targets_and_still_verify_are_refused() {
    let robot = paper_robot();
    let (first, mut second) = two_sessions(6, |_| ());
    second.points.truncate(4);
    let request = CalibrationRequest::new(robot.clone(), second);
    let refused = check_verify(&request, Some(&identified(&robot, &first)));
    // 12 equations, 6 numbers of the base and 6 of the targets, of which twice as many are needed
    assert!(
        matches!(&refused, Err(Error::Unusable { code: "under_determined", detail }) if detail.contains("at least 4 more configurations")),
        "{refused:?}"
    );
}

fn to_identify_and_verify(first: &MeasurementSet, second: MeasurementSet) -> CalibrationRequest {
    let request = CalibrationRequest { method: Method::LeastSquares, ..CalibrationRequest::new(paper_robot(), first.clone()) };
    CalibrationRequest { verify: VerifySource::Set(second), ..request }
}

fn refusal(request: &CalibrationRequest) -> Option<&'static str> {
    match check(request) {
        Err(Error::Unusable { code, .. }) => Some(code),
        _ => None,
    }
}

fn some(set: &MeasurementSet, n: usize) -> MeasurementSet {
    MeasurementSet { frame: set.frame, points: set.points[..n].to_vec() }
}

#[test]
fn a_verify_set_needs_twice_the_equations_that_placing_it_takes() {
    let (first, second) = two_sessions(6, |_| ());
    // two targets: 12 numbers of base and targets, 6 equations a configuration, two rows each
    assert_eq!(refusal(&to_identify_and_verify(&first, some(&second, 1))), Some("under_determined"));
    assert_eq!(refusal(&to_identify_and_verify(&first, some(&second, 6))), Some("under_determined"));
    assert_eq!(refusal(&to_identify_and_verify(&first, some(&second, 8))), None);
    let repeated = MeasurementSet { frame: second.frame, points: vec![second.points[0].clone(); 30] };
    assert_eq!(refusal(&to_identify_and_verify(&first, repeated)), Some("under_determined"));
}

#[test]
fn points_that_were_fitted_verify_nothing_in_whatever_order_they_come_again() {
    let (first, second) = two_sessions(7, |_| ());
    let mut again = first.clone();
    again.points.reverse();
    again.points.truncate(50);
    assert_eq!(refusal(&to_identify_and_verify(&first, again)), Some("verify_overlaps_identify"));
    assert_eq!(refusal(&to_identify_and_verify(&first, second)), None);
}

#[test]
fn a_verify_set_of_several_stations_is_refused_when_the_job_is_posted() {
    let (first, mut second) = two_sessions(8, |_| ());
    second.points[40].station = Some("b".into());
    assert_eq!(refusal(&to_identify_and_verify(&first, second)), Some("not_available"));
}

#[test]
fn a_verify_set_is_placed_anew_whenever_its_frame_or_its_targets_are_others() {
    let robot = paper_robot();
    let (first, second) = two_sessions(9, |_| ());
    let verify_rms = |first: &MeasurementSet, second: MeasurementSet| {
        calibrate(&to_identify_and_verify(first, second), &mut |_| ControlFlow::Continue(())).unwrap().verify.unwrap().after.rms_mm
    };
    // noise of 0.03 mm in each coordinate is 0.052 mm
    assert!(verify_rms(&first, second.clone()) < 0.06, "both in the instrument frame");
    let in_base = |truth: &KinematicModel, seed: u64, n_targets: usize| {
        let mut random = Normal::new(seed);
        let model = KinematicModel { t_instrument_base: IsometryMatrix3::identity(), ..truth.clone() };
        let campaign = Campaign { n_configurations: 40, n_targets, ..Campaign::PLAIN };
        MeasurementSet { frame: Frame::Base, ..measure(&model, &poses(40, &mut random), &campaign, &mut random) }
    };
    let truth = true_robot(&robot, 2, &mut Normal::new(9));
    assert!(verify_rms(&first, in_base(&truth, 100, 2)) < 0.06, "identified from an instrument, verified in the base frame");
    let one_target = in_base(&truth, 101, 1);
    let complete = CalibrationRequest { model: Some(Model::Complete), ..to_identify_and_verify(&one_target, in_base(&truth, 102, 2)) };
    let report = calibrate(&complete, &mut |_| ControlFlow::Continue(())).unwrap();
    assert!(report.verify.unwrap().after.rms_mm < 0.06, "more targets than were identified");
}
