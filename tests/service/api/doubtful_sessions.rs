//! Sessions that fit and show less than they seem to: of a base that they do not see, of poses that repeat, and several times worse than the set's
//! own points.

use crate::api::sessions::{
    Row, codes, csv, failed_gates, rows, scored, seen_by_a_tracker, set_policy, upload, with_noise,
};
use crate::app::{TestApp, text};
use crate::simulation::Normal;
use serde_json::{Value, json};

/// A base frame that was set up wrongly by this much, mm.
const BASE_OFF_MM: f64 = 1.5;

async fn upload_in(app: &TestApp, robot: &str, frame: &str, rows: &[Row]) -> String {
    let path = format!("{robot}/measurement-sets?frame={frame}");
    let set = app.post(&path, "text/csv", csv(rows)).await.ok(201);
    text(&set["id"]).to_owned()
}

async fn identified(app: &TestApp, robot: &str, request: Value) -> (Value, Value) {
    let job = app.run(robot, &request).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let path = format!("/v1/jobs/{}/report", text(&job["id"]));
    (
        job["parameter_set_id"].clone(),
        app.get(&path).await.ok(200),
    )
}

/// What a gate found.
async fn gate(app: &TestApp, parameter_set: &Value, name: &str) -> Value {
    let path = format!("/v1/parameter-sets/{}/gates", text(parameter_set));
    let answer = app.get(&path).await.ok(200);
    let mut gates = answer["gates"].as_array().unwrap().iter();
    gates.find(|gate| gate["gate"] == name).unwrap().clone()
}

#[tokio::test]
async fn a_session_in_the_instruments_frame_says_nothing_of_the_base_of_a_set_from_the_base_frame()
{
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(40);
    let robot = app.paper_robot().await;
    let strict = json!({"independent_session_required": true});
    set_policy(&app, &robot, strict.clone()).await;
    let mut off = with_noise(&rows("first.csv"), 0.03, &mut random);
    off.iter_mut().for_each(|row| row[6] += BASE_OFF_MM);
    let fresh = with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random);
    let seen = seen_by_a_tracker(&fresh, &mut random);
    for model in ["paper", "complete"] {
        let set = upload_in(&app, &robot, "base", &off).await;
        let session = upload_in(&app, &robot, "instrument", &seen).await;
        let request = json!({"measurement_set_id": set, "model": model, "method": "least_squares"});
        let (parameter_set, _) = identified(&app, &robot, request.clone()).await;
        let (_, report) = scored(&app, &robot, &session, &parameter_set).await;
        assert_eq!(codes(&report), ["base_not_checked"], "{model}");
        assert_eq!(report["evidence"], "none", "{model}");
        let (failed, evidence) = failed_gates(&app, &parameter_set).await;
        assert!(failed.contains(&"evidence".into()), "{model}: {failed:?}");
        assert_eq!(evidence, "same_upload", "{model}");
        let detail = gate(&app, &parameter_set, "evidence").await["detail"].clone();
        assert!(
            text(&detail).contains("base was not checked")
                && text(&detail).contains("a session in the base frame"),
            "{detail}"
        );
        let release = format!("/v1/parameter-sets/{}/release", text(&parameter_set));
        let why = json!({"reason": "it fits", "change_reason": "none"});
        let refused = app.post_json(&release, &why).await;
        refused.problem(409, "release_refused");
        // The same in one job: no more than points held out of the upload.
        let mut both = request;
        both["verify"] = json!({"source": "set", "measurement_set_id": session});
        let (parameter_set, report) = identified(&app, &robot, both).await;
        assert!(codes(&report).contains(&"base_not_checked"), "{model}");
        assert_eq!(report["evidence"], "same_upload", "{model}");
        let (_, evidence) = failed_gates(&app, &parameter_set).await;
        assert_eq!(evidence, "same_upload", "{model}");
    }
    // A session in the base frame shows it.
    let set = upload_in(&app, &robot, "base", &off).await;
    let request = json!({"measurement_set_id": set, "model": "paper", "method": "least_squares"});
    let (parameter_set, _) = identified(&app, &robot, request).await;
    let session = upload_in(&app, &robot, "base", &fresh).await;
    let (_, report) = scored(&app, &robot, &session, &parameter_set).await;
    assert!(codes(&report).contains(&"set_far_off"), "{report}");
}

#[tokio::test]
async fn sets_and_sessions_in_the_same_frame_verify_each_other_as_before() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(41);
    let first = with_noise(&rows("first.csv"), 0.03, &mut random);
    let fresh = with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random);
    for (identified_in, verified_in, expected) in [
        ("instrument", "instrument", "independent_session"),
        ("base", "base", "independent_session"),
        // A set from an instrument's frame rests on no base.
        ("instrument", "base", "independent_session"),
    ] {
        let robot = app.paper_robot().await;
        set_policy(&app, &robot, json!({"independent_session_required": true})).await;
        let mut seen = |frame: &str, rows: &[Row]| match frame {
            "instrument" => seen_by_a_tracker(rows, &mut random),
            _ => rows.to_vec(),
        };
        let (first, fresh) = (seen(identified_in, &first), seen(verified_in, &fresh));
        let set = upload_in(&app, &robot, identified_in, &first).await;
        let request = json!({"measurement_set_id": set, "method": "least_squares"});
        let (parameter_set, _) = identified(&app, &robot, request).await;
        let session = upload_in(&app, &robot, verified_in, &fresh).await;
        let (_, report) = scored(&app, &robot, &session, &parameter_set).await;
        let what = format!("{identified_in}, {verified_in}");
        assert_eq!(report["evidence"], expected, "{what}: {report}");
        assert_eq!(codes(&report), [""; 0], "{what}");
        let found = gate(&app, &parameter_set, "evidence").await;
        assert_eq!(found["passed"], true, "{what}: {found}");
    }
}

#[tokio::test]
async fn poses_that_are_measured_again_are_told_to_be_other_poses_next_time() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(42);
    let robot = app.paper_robot().await;
    let policy = json!({"independent_session_required": true});
    set_policy(&app, &robot, policy).await;
    let first = with_noise(&rows("first.csv"), 0.03, &mut random);
    let set = upload_in(&app, &robot, "base", &first).await;
    let request = json!({"measurement_set_id": set, "method": "least_squares"});
    let (parameter_set, _) = identified(&app, &robot, request).await;
    let again = upload(&app, &robot, &with_noise(&first, 0.03, &mut random)).await;
    let (_, report) = scored(&app, &robot, &again, &parameter_set).await;
    assert_eq!(report["evidence"], "same_upload");
    let found = gate(&app, &parameter_set, "evidence").await;
    assert_eq!(found["passed"], false, "{found}");
    assert!(
        text(&found["detail"]).contains("measure other poses"),
        "{found}"
    );
}

#[tokio::test]
async fn a_copy_with_a_constant_on_joint_1_or_6_supports_no_release() {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(43);
    let robot = app.paper_robot().await;
    let policy = json!({"independent_session_required": true});
    set_policy(&app, &robot, policy).await;
    let first = with_noise(&rows("first.csv"), 0.03, &mut random);
    let first = seen_by_a_tracker(&first, &mut random);
    let set = upload_in(&app, &robot, "instrument", &first).await;
    let request = json!({"measurement_set_id": set, "method": "least_squares"});
    let (parameter_set, _) = identified(&app, &robot, request).await;
    for (joint_1_deg, joint_6_deg, std_mm) in [(7.0, 0.0, 0.0), (0.0, -25.0, 0.0), (0.5, 3.0, 0.02)]
    {
        let mut copy = with_noise(&first, std_mm, &mut random);
        for row in &mut copy {
            row[0] += joint_1_deg;
            row[5] += joint_6_deg;
        }
        let copy = upload_in(&app, &robot, "instrument", &copy).await;
        let (_, report) = scored(&app, &robot, &copy, &parameter_set).await;
        assert_eq!(
            report["evidence"], "same_upload",
            "{joint_1_deg}° on joint 1, {joint_6_deg}° on joint 6"
        );
    }
    let (failed, _) = failed_gates(&app, &parameter_set).await;
    assert!(failed.contains(&"evidence".into()), "{failed:?}");
}

#[tokio::test]
async fn a_session_several_times_worse_than_the_held_out_points_is_told_and_supports_nothing_without_a_tolerance()
 {
    let app = TestApp::with_workers(1).await;
    let mut random = Normal::new(44);
    let robot = app.paper_robot().await;
    set_policy(&app, &robot, json!({"independent_session_required": true})).await;
    let first = with_noise(&rows("first.csv"), 0.03, &mut random);
    let set = upload_in(&app, &robot, "base", &first).await;
    let request = json!({"measurement_set_id": set, "method": "least_squares"});
    let (parameter_set, report) = identified(&app, &robot, request).await;
    let held_out_mm = report["verify"]["after"]["rms_mm"].as_f64().unwrap();
    // 0.3 mm to both sides: between five and nine times as much.
    let mut worse = with_noise(&rows("followup_unchanged.csv"), 0.03, &mut random);
    worse.iter_mut().enumerate().for_each(|(i, row)| {
        row[6] += if i % 2 == 0 { 0.3 } else { -0.3 };
    });
    let session = upload_in(&app, &robot, "base", &worse).await;
    let (_, report) = scored(&app, &robot, &session, &parameter_set).await;
    let times = report["verify"]["after"]["rms_mm"].as_f64().unwrap() / held_out_mm;
    assert!((4.0..9.0).contains(&times), "{times}");
    assert_eq!(codes(&report), ["worse_than_identified"], "{report}");
    let found = gate(&app, &parameter_set, "evidence").await;
    assert_eq!(found["passed"], false, "{found}");
    let detail = text(&found["detail"]);
    assert!(
        detail.contains("times those of the points held out") && detail.contains("tolerance"),
        "{detail}"
    );
    // Where the policy says what is good enough, it decides.
    for (tolerance_mm, expected) in [(0.5, &[][..]), (0.28, &["verify_errors_within_tolerance"])] {
        let policy = json!({"independent_session_required": true, "tolerance_mm": tolerance_mm});
        set_policy(&app, &robot, policy).await;
        let (failed, _) = failed_gates(&app, &parameter_set).await;
        assert_eq!(failed, expected, "{tolerance_mm} mm");
        let found = gate(&app, &parameter_set, "evidence").await;
        assert_eq!(
            (&found["passed"], &found["warning"]),
            (&json!(true), &json!(true))
        );
    }
}
