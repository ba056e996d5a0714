//! The parsers of kincal and what they stand on, from the package's own sources, without the server.
#![allow(dead_code, unused_imports)] // what only the server uses

pub use kincal_core::{
    calibration, compensation, exchange, frames, identification, kinematics, measurement, planning,
    solvers,
};

#[path = "../../src/operations/mod.rs"]
pub mod operations;
#[path = "../../src/release/mod.rs"]
pub mod release;
#[path = "../../src/wire/mod.rs"]
pub mod wire;

use measurement::csv::{MAX_COORDINATE_MM, MAX_ISSUES, MAX_JOINT_RAD, MAX_ROWS, ParseError};
use measurement::table::own_form;
use measurement::{Decimal, Frame, MeasurementSet};
use operations::import::import;
use operations::urdf::Urdf;
use operations::xml_limits;
use wire::Invalid;
use wire::columns::ColumnsBody;
use wire::import::ImportFormat;
use wire::measurement::{Upload, from_file, from_upload};

/// Longest text of one issue, bytes: whatever the file holds, an answer stays short.
const LONGEST_DETAIL: usize = 70_000;

/// What holds for every file, good or bad.
pub fn check_csv(decimal: Decimal, bytes: &[u8], n_joints: usize) {
    let parsed = own_form::parse_as(decimal, None, bytes, Frame::Base, n_joints);
    match &parsed {
        Ok(set) => check_set(set, n_joints),
        Err(ParseError { issues }) => {
            assert!(
                (1..=MAX_ISSUES).contains(&issues.len()),
                "{} issues",
                issues.len()
            );
            let n_rows = bytes
                .iter()
                .filter(|byte| matches!(byte, b'\n' | b'\r'))
                .count()
                + 1;
            for issue in issues {
                assert!(
                    !issue.detail.is_empty() && !issue.code.is_empty(),
                    "{issue:?}"
                );
                assert!(
                    issue.row.is_none_or(|row| row < n_rows),
                    "{issue:?} of {n_rows}"
                );
            }
        }
    }
    assert_eq!(
        own_form::parse_as(decimal, None, bytes, Frame::Base, n_joints),
        parsed,
        "the same bytes, the same answer"
    );
}

/// What holds for every table: it is refused with reasons, or read, and read again in the way that was told.
pub fn check_table(is_mapped: bool, bytes: &[u8], n_joints: usize) {
    let columns = match is_mapped {
        false => ColumnsBody::default(),
        true => {
            let joints = (1..=n_joints).map(|joint| format!("\"q{joint}_deg\": {joint}"));
            let all: Vec<String> = joints
                .chain((1..=3).map(|axis| format!("\"{}_mm\": {}", ["x", "y", "z"][axis - 1], n_joints + axis)))
                .collect();
            ColumnsBody::parse(format!("{{{}}}", all.join(",")).as_bytes()).expect("a mapping")
        }
    };
    let upload = Upload {
        content_type: "text/csv",
        bytes,
        columns: &columns,
        decimal: None,
        rotation: None,
        frame: Frame::Base,
        instrument: None,
    };
    match from_file(&upload, n_joints) {
        Ok((set, reading)) => {
            check_set(&set, n_joints);
            let reading = serde_json::to_string(&reading.expect("a table was read somehow")).expect("JSON");
            let again = from_upload("text/csv", Some(&reading), bytes, Frame::Base, n_joints);
            assert_eq!(again.as_ref(), Ok(&set), "{reading}");
        }
        Err(Invalid { issues, .. }) => {
            assert!((1..=MAX_ISSUES).contains(&issues.len()), "{} issues", issues.len());
            for issue in issues {
                assert!(!issue.detail.is_empty() && !issue.code.is_empty(), "{issue:?}");
                assert!(issue.detail.len() < LONGEST_DETAIL, "{} bytes", issue.detail.len());
            }
        }
    }
}

fn check_set(set: &MeasurementSet, n_joints: usize) {
    assert!((1..=MAX_ROWS).contains(&set.points.len()));
    for point in &set.points {
        assert_eq!(point.q_rad.len(), n_joints);
        assert!(
            point
                .q_rad
                .iter()
                .all(|q| q.is_finite() && q.abs() <= MAX_JOINT_RAD),
            "{point:?}"
        );
        assert!(
            point
                .position_mm
                .iter()
                .all(|p| p.is_finite() && p.abs() <= MAX_COORDINATE_MM),
            "{point:?}"
        );
        assert!(
            point.std_mm.is_none_or(|std| std.is_finite() && std > 0.0),
            "{point:?}"
        );
        assert!(point.temperature_c.is_none_or(f64::is_finite), "{point:?}");
    }
}

/// What holds for every description of a robot.
pub fn check_import(bytes: &[u8], format: ImportFormat) {
    match import(bytes, format, "fuzzed", None) {
        Ok(answer) => {
            let written = serde_json::to_string(&answer.robot).expect("it can be written");
            let robot: wire::robot::RobotBody =
                wire::json::parse(written.as_bytes()).expect("it can be read");
            let links = kinematics::Robot::try_from(&robot).expect("it is a robot").links;
            assert!((1..=kinematics::model::MAX_LINKS).contains(&links.len()));
            assert!(answer.largest_difference_mm <= 1e-9, "{written}");
        }
        Err(invalid) => check_refusal(&invalid),
    }
}

/// A URDF that was read: it is within its limits, and its own origins put in again change no joint.
pub fn check_urdf(bytes: &[u8]) {
    let urdf = match Urdf::parse(bytes) {
        Ok(urdf) => urdf,
        Err(invalid) => return check_refusal(&invalid),
    };
    let text = std::str::from_utf8(bytes).expect("what was read is UTF-8");
    let document = roxmltree::Document::parse(text).expect("what was read is XML");
    for element in document.descendants().filter(roxmltree::Node::is_element) {
        assert!(element.attributes().len() <= xml_limits::MAX_ATTRIBUTES);
        assert!(element.ancestors().count() <= xml_limits::MAX_DEPTH + 1);
    }
    let old = match urdf.chain(None, None) {
        Ok(old) => old,
        Err(invalid) => return check_refusal(&invalid),
    };
    let text = urdf.with_origins(&old, &old.chain);
    let again = Urdf::parse(text.as_bytes()).unwrap_or_else(|e| panic!("{e:?}: {text}"));
    let new = again
        .chain(None, None)
        .unwrap_or_else(|e| panic!("{e:?}: {text}"));
    assert_eq!(old.chain.joints.len(), new.chain.joints.len(), "{text}");
}

fn check_refusal(invalid: &Invalid) {
    assert!((1..=wire::issue::MAX_ISSUES).contains(&invalid.issues.len()));
    for issue in &invalid.issues {
        assert!(
            !issue.detail.is_empty() && issue.detail.len() <= LONGEST_DETAIL,
            "{issue:?}"
        );
    }
}
