//! Two files that are joined by time: continuous logs of both, frames of a camera, and times of day over midnight.

use super::{LOG, form, read, refusal};
use std::fmt::Write;

/// Share of the way after a share of the time, with slow ends.
fn smooth(share: f64) -> f64 {
    share * share * (3.0 - 2.0 * share)
}

/// The robot's clock minus the instrument's, s.
const OFFSET_S: f64 = 500.0;

/// A log of the robot with ten rows a second, and one of the instrument with a hundred. Joint 1 is at the number of the pose times 20°, and x at ten times
/// joint 1. `stand_s` is how long the robot stands at a pose; each motion takes 1.7 s.
fn logs(n: usize, stand_s: impl Fn(usize) -> f64) -> (String, String) {
    let at_deg = |time_s: f64| {
        let (mut from_s, mut pose) = (0.0, 0);
        loop {
            let stand_s = stand_s(pose);
            let last = pose + 1 == n;
            if time_s < from_s + stand_s || last {
                return 20.0 * pose as f64;
            }
            if time_s < from_s + stand_s + 1.7 {
                let share = (time_s - from_s - stand_s) / 1.7;
                return 20.0 * (pose as f64 + smooth(share));
            }
            (from_s, pose) = (from_s + stand_s + 1.7, pose + 1);
        }
    };
    let end_s: f64 = (0..n).map(|pose| stand_s(pose) + 1.7).sum();
    let (mut robot, mut instrument) = (
        LOG.replace("Point", "time [s]"),
        "time [s],x_mm,y_mm,z_mm\n".to_owned(),
    );
    for row in 0..(end_s * 10.0) as usize {
        let time_s = row as f64 / 10.0;
        writeln!(
            robot,
            "{:.1},{},2,3,4,5,6",
            time_s + OFFSET_S,
            at_deg(time_s)
        )
        .unwrap();
    }
    for row in 0..(end_s * 100.0) as usize {
        let time_s = row as f64 / 100.0 + 0.003;
        let x = 10.0 * at_deg(time_s);
        writeln!(instrument, "{time_s:.3},{x},{},3", 0.3 * x).unwrap();
    }
    (robot, instrument)
}

fn uneven(pose: usize) -> f64 {
    1.5 + 0.1 * ((pose * 7) % 19) as f64
}

#[test]
fn of_two_logs_only_rows_are_paired_in_which_both_stand() {
    let (robot, instrument) = logs(20, uneven);
    let body = form(robot.as_bytes(), instrument.as_bytes());
    let (set, reading) = read(&body, "").unwrap();
    assert_eq!(set.points.len(), 20);
    for point in &set.points {
        let pose = point.q_rad[0].to_degrees() / 20.0;
        assert!((pose - pose.round()).abs() < 1e-6, "moved: {pose}");
        assert!((point.position_mm.x - 200.0 * pose).abs() < 1e-6, "{pose}");
    }
    let reading = reading.unwrap();
    let json = serde_json::to_string(&reading).unwrap();
    let frame = kincal::measurement::Frame::Base;
    let again =
        kincal::wire::measurement::from_upload(super::BOUNDARY, Some(&json), &body, frame, 6);
    assert!(again.unwrap() == set);
    let join = reading.joined.unwrap().join;
    assert!(join.instrument_log && join.settled_standstills);
    assert!((join.clock_offset_s.unwrap() - OFFSET_S).abs() < 0.1);
    assert_eq!((join.leftover_robot.n, join.leftover_instrument.n), (0, 0));
}

#[test]
fn even_standstills_of_two_logs_are_asked_for_the_clocks() {
    let (robot, instrument) = logs(20, |_| 2.0);
    let (code, detail) = refusal(&robot, &instrument, "");
    assert_eq!(code, "two_readings", "{detail}");
    assert!(
        detail.contains("{\"join\": {\"clock_offset_s\": \"SECONDS\"}}"),
        "{detail}"
    );
    let body = form(robot.as_bytes(), instrument.as_bytes());
    let (set, _) = read(&body, "{\"join\": {\"clock_offset_s\": 500}}").unwrap();
    assert_eq!(set.points.len(), 20);
    let moving = LOG.replace("Point", "time [s]")
        + &(0..200)
            .map(|i| format!("{}.{},{i},2,3,4,5,6\n", i / 10, i % 10))
            .collect::<String>();
    let (_, detail) = refusal(&moving, &instrument, "");
    assert!(detail.contains("clock_offset_s"), "{detail}");
}

#[test]
fn frames_of_a_camera_are_times_where_their_rate_is_stated() {
    let (robot, instrument) = logs(20, uneven);
    let rows = instrument.lines().skip(1).zip(1..).map(|(row, frame)| {
        let (_, position) = row.split_once(',').unwrap();
        format!("{frame},0,{position}\n")
    });
    let rows: String = rows.collect();
    for (title, header) in [("Trajectories", "X,Y,Z"), ("Objects", "TX,TY,TZ")] {
        let head = |rate: &str| {
            format!("{title}\n{rate},,Cell:SMR,,\nFrame,Sub Frame,{header}\n,,mm,mm,mm\n{rows}")
        };
        let stated = head("100").replace("100,,Cell", "100\n,,Cell");
        let body = form(robot.as_bytes(), stated.as_bytes());
        let (set, reading) = read(&body, "").unwrap();
        assert_eq!(set.points.len(), 20, "{title}");
        let join = reading.unwrap().joined.unwrap().join;
        assert!((join.clock_offset_s.unwrap() - OFFSET_S).abs() < 0.1);
        let open = stated.replacen("\n100\n", "\n\n", 1);
        let (code, detail) = refusal(&robot, &open, "");
        assert_eq!(code, "join_unclear");
        assert!(
            detail.contains("{\"instrument\": {\"time_100hz\": \"Frame\"}}"),
            "{detail}"
        );
        let body = form(robot.as_bytes(), open.as_bytes());
        let said = "{\"instrument\": {\"time_100hz\": \"Frame\"}}";
        assert_eq!(read(&body, said).unwrap().0.points.len(), 20);
    }
}

#[test]
fn times_of_day_go_on_over_midnight_and_it_is_told() {
    let (mut robot, mut instrument) = (
        LOG.replace("Point", "Time"),
        String::from("Time,x_mm,y_mm,z_mm\n"),
    );
    let mut time_s = 86_300;
    for i in 1..=12 {
        let clock = |time_s: i32| {
            let of_day = time_s % 86_400;
            format!(
                "{:02}:{:02}:{:02}",
                of_day / 3600,
                of_day / 60 % 60,
                of_day % 60
            )
        };
        writeln!(robot, "{},{i},2,3,4,5,6", clock(time_s)).unwrap();
        writeln!(instrument, "{},{},2,3", clock(time_s - 3607), 10 * i).unwrap();
        time_s += 17 + 5 * i % 13;
    }
    let body = form(robot.as_bytes(), instrument.as_bytes());
    let (set, reading) = read(&body, "").unwrap();
    assert_eq!(set.points.len(), 12);
    for point in &set.points {
        assert!((10.0 * point.q_rad[0].to_degrees() - point.position_mm.x).abs() < 1e-6);
    }
    assert!(reading.unwrap().joined.unwrap().join.over_midnight);
}
