#![no_main]
//! Any bytes as each of the documents that the service reads: robots, sets, jobs, policies, releases; and as stored weights.

use kincal_fuzz::wire::job::JobRequestBody;
use kincal_fuzz::wire::measurement::MeasurementSetBody;
use kincal_fuzz::wire::policy::PolicyBody;
use kincal_fuzz::wire::predict::PredictBody;
use kincal_fuzz::wire::release::ReleaseBody;
use kincal_fuzz::wire::robot::{Robot, RobotBody};
use kincal_fuzz::wire::{json, safetensors};
use serde::Serialize;
use serde::de::DeserializeOwned;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((first, body)) = bytes.split_first() else {
        return;
    };
    match first % 7 {
        0 => round_trip::<RobotBody>(body, |robot| drop(Robot::try_from(robot))),
        1 => round_trip::<MeasurementSetBody>(body, |set| {
            for n_joints in [1, 6, 12] {
                if let Ok(set) = set.measurement_set(None, None, n_joints) {
                    assert!(set.points.iter().all(|p| p.q_rad.len() == n_joints
                        && p.position_mm.iter().all(|p| p.is_finite())));
                }
            }
        }),
        2 => round_trip::<JobRequestBody>(body, |job| drop(job.check())),
        3 => round_trip::<PolicyBody>(body, |_| ()),
        4 => round_trip::<ReleaseBody>(body, |release| drop(release.check())),
        5 => drop(json::parse::<PredictBody>(body).map(|predict| predict.check(6))),
        _ => drop(safetensors::read(body)),
    }
});

/// What is understood is written and understood again, to the same document.
fn round_trip<T: DeserializeOwned + Serialize>(body: &[u8], check: impl Fn(&T)) {
    let Ok(document) = json::parse::<T>(body) else {
        return;
    };
    check(&document);
    let written = serde_json::to_vec(&document).expect("what was read can be written");
    let again: T = json::parse(&written)
        .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&written)));
    assert_eq!(serde_json::to_vec(&again).expect("twice"), written);
}
