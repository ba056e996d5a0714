//! Small sets: what an upload says that they can serve for is what a job finds.

use crate::api::sessions::{Row, codes, rows, scored, seen_by_a_tracker, with_noise};
use crate::app::{TestApp, paper, text};
use crate::simulation::Normal;
use kincal::kinematics::{Robot, t_base_flange};
use kincal::wire::robot::RobotBody;
use nalgebra::Vector3;
use serde_json::{Value, json};

/// A point of a reflector.
type Point = (Row, usize);

fn csv(points: &[Point]) -> String {
    let line = |(row, target): &Point| {
        let cells: Vec<String> = row.iter().map(|cell| format!("{cell:.4}")).collect();
        format!("{},{target}\n", cells.join(","))
    };
    let header = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm,target\n";
    header.to_owned() + &points.iter().map(line).collect::<String>()
}

/// The rows with a second reflector, 90 mm beside the first.
fn two_reflectors(rows: &[Row]) -> Vec<Point> {
    let body: RobotBody = serde_json::from_slice(&paper("robot.json")).unwrap();
    let robot = Robot::try_from(&body).unwrap();
    let both = |row: &Row| {
        let q_rad: Vec<f64> = row[..6].iter().map(|q| q.to_radians()).collect();
        let flange = t_base_flange(&robot.links, &robot.q_model_rad(&q_rad));
        let beside = flange.rotation * Vector3::new(90.0, -40.0, 0.0);
        let mut other = *row;
        (0..3).for_each(|axis| other[6 + axis] += beside[axis]);
        [(*row, 0), (other, 1)]
    };
    rows.iter().flat_map(both).collect()
}

fn one_reflector(rows: &[Row]) -> Vec<Point> {
    rows.iter().map(|row| (*row, 0)).collect()
}

/// Poses that hardly differ from one of the file, where the nominal robot has them.
fn narrow(n: usize) -> Vec<Row> {
    let body: RobotBody = serde_json::from_slice(&paper("robot.json")).unwrap();
    let robot = Robot::try_from(&body).unwrap();
    let first = rows("followup_unchanged.csv")[3];
    let near = |i: usize| {
        let mut row = first;
        for (joint, q_deg) in row[..6].iter_mut().enumerate() {
            *q_deg += 3.0 * ((1 + i * (joint + 2)) as f64).sin();
        }
        let q_rad: Vec<f64> = row[..6].iter().map(|q| q.to_radians()).collect();
        let flange = t_base_flange(&robot.links, &robot.q_model_rad(&q_rad));
        row[6..].copy_from_slice(flange.translation.vector.as_slice());
        row
    };
    (0..n).map(near).collect()
}

fn details(set: &Value, code: &str) -> String {
    let warnings = set["warnings"].as_array().unwrap().iter();
    let of_code = warnings.filter(|warning| warning["code"] == code);
    of_code.map(|warning| text(&warning["detail"])).collect()
}

async fn upload(app: &TestApp, robot: &str, frame: &str, points: &[Point]) -> Value {
    let path = format!("{robot}/measurement-sets?frame={frame}");
    app.post(&path, "text/csv", csv(points)).await.ok(201)
}

/// A robot with a set that was identified in this frame.
async fn identified(app: &TestApp, frame: &str, random: &mut Normal) -> (String, Value) {
    let robot = app.paper_robot().await;
    let first = with_noise(&rows("first.csv"), 0.03, random);
    let first = match frame {
        "instrument" => seen_by_a_tracker(&first, random),
        _ => first,
    };
    let set = upload(app, &robot, frame, &one_reflector(&first)).await;
    let request = json!({"measurement_set_id": set["id"], "method": "least_squares"});
    let job = app.run(&robot, &request).await;
    (robot, job["parameter_set_id"].clone())
}

#[tokio::test]
async fn what_an_upload_says_of_a_small_set_is_what_a_job_finds() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(50);
    let fresh = with_noise(&rows("followup_unchanged.csv"), 0.02, &mut random);
    for frame in ["base", "instrument"] {
        let (robot, parameter_set) = identified(&app, frame, &mut random).await;
        let mut files: Vec<(String, Vec<Point>)> = (1..=10)
            .map(|n| (format!("{n} points"), one_reflector(&fresh[..n])))
            .collect();
        files.push(("8 poses close together".into(), one_reflector(&narrow(8))));
        if frame == "instrument" {
            for n in 4..=7 {
                let points = two_reflectors(&fresh[..n]);
                files.push((format!("{n} configurations, two reflectors"), points));
            }
        }
        for (name, mut points) in files {
            if frame == "instrument" {
                let moved: Vec<Row> = points.iter().map(|(row, _)| *row).collect();
                let moved = seen_by_a_tracker(&moved, &mut random);
                points.iter_mut().zip(moved).for_each(|(p, row)| p.0 = row);
            }
            let set = upload(&app, &robot, frame, &points).await;
            let said = details(&set, "under_determined");
            let verify = json!({"measurement_set_id": set["id"], "kind": "verify", "parameter_set_id": parameter_set});
            let posted = app.post_json(&format!("{robot}/jobs"), &verify).await;
            let is_scored = posted.json()["status"] != 422;
            let is_evidence = match is_scored {
                true => {
                    let (_, report) = scored(&app, &robot, text(&set["id"]), &parameter_set).await;
                    report["evidence"] == "independent_session"
                }
                false => false,
            };
            let what = format!("{frame}, {name}: {said}");
            if said.is_empty() {
                continue; // enough to identify from
            }
            assert_eq!(
                said.contains("it can serve to verify"),
                is_evidence,
                "{what}"
            );
            assert_eq!(said.contains("and to verify on"), !is_scored, "{what}");
            assert_eq!(
                said.contains("no evidence"),
                is_scored && !is_evidence,
                "{what}"
            );
        }
    }
    // Which set it can verify is said, too.
    let (robot, _) = identified(&app, "base", &mut random).await;
    let set = upload(&app, &robot, "base", &two_reflectors(&fresh[..5])).await;
    let said = details(&set, "under_determined");
    assert!(
        said.contains("identified in the base frame with 2 targets or more"),
        "{said}"
    );
}

#[tokio::test]
async fn one_pose_that_was_read_thirty_times_is_told_to_be_too_few_and_asks_for_no_check() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(51);
    for frame in ["base", "instrument"] {
        let (robot, parameter_set) = identified(&app, frame, &mut random).await;
        let once = vec![rows("followup_unchanged.csv")[5]; 30];
        let read = with_noise(&once, 0.1, &mut random);
        let read = match frame {
            "instrument" => seen_by_a_tracker(&read, &mut random),
            _ => read,
        };
        let set = upload(&app, &robot, frame, &one_reflector(&read)).await;
        let all = set["warnings"].to_string();
        assert!(!all.contains("does not fit"), "{frame}: {all}");
        let said = details(&set, "under_determined");
        assert!(
            said.contains("too small to identify from") && !said.contains("it can serve"),
            "{frame}: {said}"
        );
        for scored_set in [&parameter_set, &Value::Null] {
            let verify = json!({"measurement_set_id": set["id"], "kind": "verify", "parameter_set_id": scored_set});
            let posted = app
                .post_json(&format!("{robot}/jobs"), &verify)
                .await
                .json();
            if posted["status"] == 422 {
                assert_eq!(frame, "instrument", "{posted}");
                continue;
            }
            let (_, report) = scored(&app, &robot, text(&set["id"]), scored_set).await;
            assert_eq!(report["evidence"], "none", "{frame}");
            let told = codes(&report);
            assert!(!told.contains(&"session_does_not_fit"), "{frame}: {told:?}");
        }
        assert_eq!(app.get(&robot).await.ok(200)["state"], "ok", "{frame}");
    }
}
