//! Data of the tests: the paper's robot and sets (`data/paper`), and measured sets of real robots if they are available.

use kincal::kinematics::{Link, Robot};
use kincal::measurement::table::own_form;
use kincal::measurement::{Frame, MeasurementSet};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Path of a file in `data/paper`.
pub fn paper_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("data/paper")
        .join(name)
}

/// Folder of the measured sets; `None`, with one message, if it is missing.
pub fn real_data() -> Option<PathBuf> {
    let root = std::env::var("KINCAL_REAL_DATA").unwrap_or_else(|_| "../shared/data/real".into());
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(root);
    if path.is_dir() {
        return Some(path);
    }
    static SAID: std::sync::Once = std::sync::Once::new();
    // Written directly to standard error, because the test runner hides captured output.
    SAID.call_once(|| {
        let line = format!("!!! NO REAL DATA at {} (KINCAL_REAL_DATA): the tests on measured robots DID NOT RUN !!!", path.display());
        let _ = writeln!(std::io::stderr(), "{line}");
    });
    None
}

/// Makers' descriptions of robots, in a subfolder of the measured sets: names and texts, sorted. Empty if they are missing.
pub fn urdfs() -> Vec<(String, String)> {
    let folder = real_data().and_then(|real| Some(real.parent()?.join("urdf")));
    let Some(entries) = folder.and_then(|folder| std::fs::read_dir(folder).ok()) else {
        return vec![];
    };
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == "urdf"));
    paths.sort();
    let read = |path: PathBuf| {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        (name, std::fs::read_to_string(path).unwrap())
    };
    paths.into_iter().map(read).collect()
}

/// The Python for oracles: that of `KINCAL_ORACLES_PYTHON`, which has their libraries, else `python3`.
pub fn oracles_python() -> String {
    std::env::var("KINCAL_ORACLES_PYTHON").unwrap_or_else(|_| "python3".into())
}

/// A robot file.
pub fn robot(path: &Path) -> Robot {
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let number = |link: &serde_json::Value, key: &str| {
        link.get(key)
            .and_then(serde_json::Value::as_f64)
            .unwrap_or(0.0)
    };
    let link = |link: &serde_json::Value| Link {
        a_mm: number(link, "a_mm"),
        alpha_rad: number(link, "alpha_deg").to_radians(),
        d_mm: number(link, "d_mm"),
        theta_offset_rad: number(link, "theta_offset_deg").to_radians(),
        beta_rad: number(link, "beta_deg").to_radians(),
    };
    Robot::from_links(json["links"].as_array().unwrap().iter().map(link).collect())
}

/// The paper's robot.
pub fn paper_robot() -> Robot {
    robot(&paper_path("robot.json"))
}

/// A set of the paper's robot, in the base frame.
pub fn paper_set(name: &str) -> MeasurementSet {
    own_form::parse(&std::fs::read(paper_path(name)).unwrap(), Frame::Base, 6).unwrap()
}
