//! A partial recalibration rests on the uploads of the set that it holds, too.

use crate::api::sessions::{
    Row, codes, csv, failed_gates, rows, scored, set_policy, upload, with_noise,
};
use crate::app::{TestApp, text};
use crate::people::{Person, guarded};
use crate::simulation::Normal;
use serde_json::{Value, json};

/// Identifies joint zeros anew on `set` and keeps all else of `held`.
fn partial(set: &str, held: &str) -> Value {
    json!({"measurement_set_id": set, "method": "least_squares", "parameter_set_id": held,
        "parameters": {"identify": ["theta_offset_2", "theta_offset_3"], "rest": "parameter_set"}})
}

/// A robot with a set from `first`, and one that holds it and was identified anew from `second`.
async fn held_set(app: &TestApp, first: &str, second: &str) -> (String, String, String) {
    let robot = app.paper_robot().await;
    let mut random = Normal::new(51);
    let mut noisy = |name: &str| with_noise(&rows(name), 0.03, &mut random);
    let first = upload(app, &robot, &noisy(first)).await;
    let request = json!({"measurement_set_id": first, "method": "least_squares"});
    let held = app.run(&robot, &request).await;
    let second = upload(app, &robot, &noisy(second)).await;
    let held = text(&held["parameter_set_id"]);
    let job = app.run(&robot, &partial(&second, held)).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    (
        robot,
        held.to_owned(),
        text(&job["parameter_set_id"]).to_owned(),
    )
}

#[tokio::test]
async fn the_upload_of_a_held_set_is_no_other_session() {
    let app = TestApp::with_workers(1).await;
    let (robot, _, partial_set) = held_set(&app, "first.csv", "followup_collision.csv").await;
    let set = json!(partial_set);
    // as it was uploaded for the held set, and as a new file with the same rows
    let mut random = Normal::new(51);
    let same = with_noise(&rows("first.csv"), 0.03, &mut random);
    let copy = upload(&app, &robot, &with_noise(&same, 0.01, &mut random)).await;
    let (_, report) = scored(&app, &robot, &copy, &set).await;
    assert_eq!(report["evidence"], "same_upload", "{report}");
    let fresh = rows("followup_unchanged.csv");
    let fresh = upload(&app, &robot, &with_noise(&fresh, 0.03, &mut random)).await;
    let (_, report) = scored(&app, &robot, &fresh, &set).await;
    assert_eq!(report["evidence"], "independent_session", "{report}");
}

#[tokio::test]
async fn no_release_rests_on_a_held_set_whose_upload_was_insisted_on_or_that_was_withdrawn() {
    let (app, _dir) = guarded(1).await;
    let all = ["read", "upload", "identify", "release", "admin"];
    let person = Person::new(&app, &all).await;
    let body: Value = serde_json::from_slice(&crate::app::paper("robot.json")).unwrap();
    let robot = person.post("/v1/robots", &body).await.ok(201);
    let robot = format!("/v1/robots/{}", text(&robot["id"]));
    let mut random = Normal::new(52);
    let good = csv(&with_noise(&rows("first.csv"), 0.03, &mut random));
    let later = csv(&with_noise(
        &rows("followup_unchanged.csv"),
        0.03,
        &mut random,
    ));

    // a right file that was refused cannot be made, so the stored set is marked as one
    let first = person.upload(&robot, &good).await;
    let request = json!({"measurement_set_id": first["id"], "method": "least_squares"});
    let held = person.job(&robot, &request).await;
    for sql in [
        "drop trigger measurement_set_insisted_stays",
        "update measurement_set set insisted_on = 'poor_alignment'",
    ] {
        let done = sqlx::query(sql).execute(app.server.store.readers()).await;
        done.unwrap();
    }
    let second = person.upload(&robot, &later).await;
    let request = partial(text(&second["id"]), text(&held["parameter_set_id"]));
    let job = person.job(&robot, &request).await;
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let report = format!("/v1/jobs/{}/report", text(&job["id"]));
    let report = person.get(&report).await.ok(200);
    assert_eq!(report["evidence"], "none", "{}", report["warnings"]);
    let release = json!({"reason": "seen", "change_reason": "seen"});
    let refused = person.post(&format!("{set}/release"), &release).await;
    let refused = refused.problem(409, "release_refused");
    let names = format!("{}", refused["errors"]);
    assert!(names.contains("upload_not_insisted"), "{names}");

    // what was withdrawn is not held, and what held it before needs another session
    let withdrawn = format!("/v1/parameter-sets/{}", text(&held["parameter_set_id"]));
    let withdraw = format!("{withdrawn}/withdraw");
    let reason = json!({"reason": "scrap"});
    person.post(&withdraw, &reason).await.ok(200);
    let refused = person.post(&format!("{robot}/jobs"), &request).await;
    refused.problem(409, "parameter_set_withdrawn");
    let (failed, _) = failed_gates_of(&person, &set).await;
    assert!(failed.contains(&"source_withdrawn".into()), "{failed:?}");
}

async fn failed_gates_of(person: &Person<'_>, set: &str) -> (Vec<String>, Value) {
    let found = person.get(&format!("{set}/gates")).await.ok(200);
    let gates = found["gates"].as_array().unwrap().iter();
    let failed = gates.filter(|gate| gate["passed"] == false);
    let names = failed.map(|gate| text(&gate["gate"]).to_owned()).collect();
    (names, found)
}

#[tokio::test]
async fn who_uploaded_what_a_set_holds_is_no_second_person() {
    let (app, _dir) = guarded(1).await;
    let all = ["read", "upload", "identify", "release", "admin"];
    let (one, other) = (Person::new(&app, &all).await, Person::new(&app, &all).await);
    let third = Person::new(&app, &all).await;
    let body: Value = serde_json::from_slice(&crate::app::paper("robot.json")).unwrap();
    let robot = one.post("/v1/robots", &body).await.ok(201);
    let robot = format!("/v1/robots/{}", text(&robot["id"]));
    let policy = json!({"second_person_required": true});
    one.put(&format!("{robot}/policy"), &policy).await.ok(200);
    let mut random = Normal::new(53);
    let mut noisy = |name: &str| csv(&with_noise(&rows(name), 0.03, &mut random));
    let first = one.upload(&robot, &noisy("first.csv")).await;
    let request = json!({"measurement_set_id": first["id"], "method": "least_squares"});
    let held = one.job(&robot, &request).await;
    let second = other.upload(&robot, &noisy("followup_unchanged.csv")).await;
    let request = partial(text(&second["id"]), text(&held["parameter_set_id"]));
    let job = one.job(&robot, &request).await;
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    for (person, expected) in [(&one, false), (&other, false), (&third, true)] {
        let (failed, found) = failed_gates_of(person, &set).await;
        let is_second = !failed.contains(&"second_person".into());
        assert_eq!(is_second, expected, "{found}");
    }
}

#[tokio::test]
async fn a_set_with_too_few_parameters_is_verified_by_no_session() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    set_policy(&app, &robot, json!({"independent_session_required": true})).await;
    let mut random = Normal::new(54);
    let collided = with_noise(&rows("followup_collision.csv"), 0.02, &mut random);
    let every_other = |first: usize| collided.iter().skip(first).step_by(2).cloned().collect();
    let (one, other): (Vec<Row>, Vec<Row>) = (every_other(0), every_other(1));
    let set = upload(&app, &robot, &one).await;
    let request = json!({"measurement_set_id": set, "method": "least_squares", "corrections": "off",
        "parameters": {"identify": ["theta_offset_5"]}});
    let job = app.run(&robot, &request).await;
    let session = upload(&app, &robot, &other).await;
    let (_, report) = scored(&app, &robot, &session, &job["parameter_set_id"]).await;
    assert!(codes(&report).contains(&"misses_session"), "{report}");
    let (failed, evidence) = failed_gates(&app, &job["parameter_set_id"]).await;
    assert!(failed.contains(&"evidence".into()), "{failed:?}");
    assert_ne!(evidence, "independent_session");
}
