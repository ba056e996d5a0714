//! A calibration of many rows is cancelled: whoever waits is heard at every stage.

use crate::support::data::paper_robot;
use crate::support::simulation::{Campaign, Normal, limited, measure, poses, true_robot};
use kincal::calibration::request::PreviousSession;
use kincal::calibration::{CalibrationRequest, Error, Event, calibrate};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

const ROWS: usize = 20_000;
/// Cancellation is heard within this, of the processor's time of the calibration: a release build is promised a second, and tests are built with
/// less optimisation, which takes these loops some five times as long.
const HEARD_WITHIN: Duration = Duration::from_secs(5);

/// What this thread has worked so far: on Linux the processor's time, which others on the machine do not lengthen.
fn worked(begun: Instant) -> Duration {
    let ns = || -> Option<u64> {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        text.split(' ').next()?.parse().ok()
    };
    ns().map_or_else(|| begun.elapsed(), Duration::from_nanos)
}

#[test]
fn cancellation_of_twenty_thousand_rows_is_heard_at_every_stage() {
    let begun = Instant::now();
    let nominal = limited(paper_robot());
    let mut random = Normal::new(23);
    let truth = true_robot(&nominal, 2, &mut random);
    let settings = Campaign {
        n_configurations: ROWS / 2,
        n_targets: 2,
        sag_rad: 2e-4,
        ..Campaign::PLAIN
    };
    let mut session = || {
        let q = poses(ROWS / 2, &mut random);
        let mut set = measure(&truth, &q, &settings, &mut random);
        set.points.iter_mut().for_each(|p| p.subset = None);
        set
    };
    let (before, now) = (session(), session());
    let request = CalibrationRequest {
        previous: Some(PreviousSession {
            set: before,
            frames: None,
            estimate: None,
        }),
        ..CalibrationRequest::new(nominal, now)
    };
    let mut stage = String::new();
    let (mut told, mut silence) = (worked(begun), (Duration::ZERO, String::new()));
    calibrate(&request, &mut |event| {
        let now = worked(begun);
        if now - told > silence.0 {
            silence = (now - told, stage.clone());
        }
        told = now;
        if let Event::StageStarted(name) = event {
            stage = name.to_owned();
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    assert!(silence.0 < HEARD_WITHIN, "{silence:?}");
    // a no while the points are screened ends the calibration there
    let (mut n_asked, mut n_asked_after) = (0, 0);
    let ended = calibrate(&request, &mut |_| {
        n_asked += 1;
        n_asked_after += usize::from(n_asked > 30);
        match n_asked < 30 {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(()),
        }
    });
    assert_eq!(ended.unwrap_err(), Error::Cancelled);
    assert_eq!(n_asked_after, 0, "nobody is asked again");
}
