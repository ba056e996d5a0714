//! The parsers of kincal and what they stand on, from the package's own sources, without the server.
#![allow(dead_code, unused_imports)] // what only the server uses

#[path = "../../src/calibration/mod.rs"]
pub mod calibration;
#[path = "../../src/compensation/mod.rs"]
pub mod compensation;
#[path = "../../src/exchange/mod.rs"]
pub mod exchange;
#[path = "../../src/frames/mod.rs"]
pub mod frames;
#[path = "../../src/identification/mod.rs"]
pub mod identification;
#[path = "../../src/kinematics/mod.rs"]
pub mod kinematics;
#[path = "../../src/measurement/mod.rs"]
pub mod measurement;
#[path = "../../src/planning/mod.rs"]
pub mod planning;
#[path = "../../src/solvers/mod.rs"]
pub mod solvers;
#[path = "../../src/wire/mod.rs"]
pub mod wire;

use measurement::csv::{Decimal, MAX_COORDINATE_MM, MAX_ISSUES, MAX_JOINT_RAD, MAX_ROWS, ParseError};
use measurement::{Frame, MeasurementSet, csv};

/// What holds for every file, good or bad.
pub fn check_csv(decimal: Decimal, bytes: &[u8], n_joints: usize) {
    let parsed = csv::parse_with(decimal, bytes, Frame::Base, n_joints);
    match &parsed {
        Ok(set) => check_set(set, n_joints),
        Err(ParseError { issues }) => {
            assert!((1..=MAX_ISSUES).contains(&issues.len()), "{} issues", issues.len());
            let n_rows = bytes.iter().filter(|byte| matches!(byte, b'\n' | b'\r')).count() + 1;
            for issue in issues {
                assert!(!issue.detail.is_empty() && !issue.code.is_empty(), "{issue:?}");
                assert!(issue.row.is_none_or(|row| row < n_rows), "{issue:?} of {n_rows}");
            }
        }
    }
    assert_eq!(csv::parse_with(decimal, bytes, Frame::Base, n_joints), parsed, "the same bytes, the same answer");
}

fn check_set(set: &MeasurementSet, n_joints: usize) {
    assert!((1..=MAX_ROWS).contains(&set.points.len()));
    for point in &set.points {
        assert_eq!(point.q_rad.len(), n_joints);
        assert!(point.q_rad.iter().all(|q| q.is_finite() && q.abs() <= MAX_JOINT_RAD), "{point:?}");
        assert!(point.position_mm.iter().all(|p| p.is_finite() && p.abs() <= MAX_COORDINATE_MM), "{point:?}");
        assert!(point.std_mm.is_none_or(|std| std.is_finite() && std > 0.0), "{point:?}");
        assert!(point.temperature_c.is_none_or(f64::is_finite), "{point:?}");
    }
}
