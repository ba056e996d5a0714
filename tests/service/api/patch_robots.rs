//! Edits of robots: what may change, and what rests on the robot as it was.

use crate::app::{Answer, TestApp, paper, text};
use crate::engines::for_each_engine;
use crate::fixtures::{a_candidate, a_job, a_robot, a_set};
use kincal::jobs::JobInputs;
use kincal::store::verify::{Options, verify};
use kincal::store::{Conflict, Error, RobotEdit, audit, robot_versions};
use reqwest::Method;
use serde_json::{Value, json};
use sqlx::AssertSqlSafe;

async fn patch(app: &TestApp, robot: &str, changes: &Value) -> Answer {
    let request = app
        .request(Method::PATCH, robot)
        .header("content-type", "application/json");
    Answer::of(request.body(changes.to_string())).await
}

#[tokio::test]
async fn what_is_given_changes_what_is_null_goes_and_the_rest_stays() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let before = app.get(&robot).await.ok(200);
    assert_eq!(before["version"], 1);
    let changes = json!({"name": "Cell 4, left", "serial_number": "SN-7", "mounting": "ceiling", "description": "new",
        "joint_limits_deg": [[-10, 10], null, [-20, 20], null, null, [-30.5, 30.5]],
        "joint_map": {"sign": [1, 1, -1, 1, 1, 1]}});
    let edited = patch(&app, &robot, &changes).await.ok(200);
    assert_eq!(app.get(&robot).await.ok(200), edited);
    for field in ["name", "serial_number", "mounting", "description"] {
        assert_eq!(edited[field], changes[field]);
    }
    assert_eq!(edited["version"], 2);
    assert_eq!(edited["joint_map"]["sign"][2], -1.0);
    assert_eq!(
        (
            &edited["links"][0]["joint_limits_deg"],
            &edited["links"][1]["joint_limits_deg"]
        ),
        (&json!([-10.0, 10.0]), &Value::Null)
    );
    assert_eq!(edited["links"][0]["d_mm"], before["links"][0]["d_mm"]);
    let found = app.get("/v1/robots?search=sn-7").await.ok(200);
    assert_eq!(found["items"][0]["name"], "Cell 4, left");

    let edited = patch(
        &app,
        &robot,
        &json!({"serial_number": null, "mounting": null, "joint_map": null}),
    )
    .await
    .ok(200);
    for field in ["serial_number", "mounting", "joint_map"] {
        assert!(edited[field].is_null(), "{edited}");
    }
    assert_eq!(
        (&edited["version"], &edited["description"]),
        (&json!(3), &json!("new"))
    );
    // What changes nothing makes no version.
    for changes in [json!({}), json!({"name": "Cell 4, left"})] {
        assert_eq!(patch(&app, &robot, &changes).await.ok(200), edited);
    }
    let entries = audit::list(&app.server.store, 0, 100).await.unwrap();
    let n = entries.iter().filter(|entry| entry.event == "robot_edited");
    assert_eq!(n.count(), 2);
    for check in verify(&app.server.store, &Options::default())
        .await
        .unwrap()
    {
        assert_eq!(check.violations, [""; 0], "{}", check.id);
    }
}

#[tokio::test]
async fn an_edit_that_cannot_be_made_says_why_and_changes_nothing() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let before = app.get(&robot).await.ok(200);
    for (changes, pointer) in [
        (json!({"name": ""}), "/name"),
        (json!({"name": null}), "/name"),
        (
            json!({"joint_limits_deg": [[-10, 10]]}),
            "/joint_limits_deg",
        ),
        (
            json!({"joint_limits_deg": [[10, -10], null, null, null, null, null]}),
            "/joint_limits_deg/0",
        ),
        (
            json!({"joint_map": {"sign": [2, 1, 1, 1, 1, 1]}}),
            "/joint_map/sign/0",
        ),
        (json!({"mounting": "shelf"}), "/mounting"),
        (json!({"serial": "x"}), "/serial"),
    ] {
        let answer = patch(&app, &robot, &changes).await;
        assert_eq!(answer.status, 422, "{changes}: {}", answer.text());
        assert_eq!(
            answer.json()["errors"][0]["pointer"],
            pointer,
            "{}",
            answer.text()
        );
    }
    let links = patch(&app, &robot, &json!({"links": before["links"]})).await;
    assert_eq!(links.status, 422, "{}", links.text());
    assert!(
        links.text().contains("store a new robot"),
        "{}",
        links.text()
    );
    assert_eq!(app.get(&robot).await.ok(200), before);
}

#[tokio::test]
async fn results_keep_the_robot_that_they_were_computed_with() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let poses = json!({"q_deg": [[10, 20, 30, 40, 50, 60]]});
    let predicted = app
        .post_json(&format!("{set}/predict"), &poses)
        .await
        .ok(200);
    // The third joint counts the other way: what was identified so far cannot be released any more.
    let sign = json!({"joint_map": {"sign": [1, 1, -1, 1, 1, 1]}});
    patch(&app, &robot, &sign).await.ok(200);
    let read = app.get(&format!("/v1/jobs/{}", text(&job["id"]))).await;
    assert_eq!(read.ok(200), job, "version 1 needs no mention");
    let again = app
        .post_json(&format!("{set}/predict"), &poses)
        .await
        .ok(200);
    assert_eq!(again, predicted);
    let why = json!({"reason": "it fits"});
    let refused = app
        .post_json(&format!("{set}/release"), &why)
        .await
        .problem(409, "release_refused");
    assert_eq!(refused["errors"][0]["code"], "joint_map_changed");
    let verification = json!({"measurement_set_id": job["measurement_set_id"], "kind": "verify", "parameter_set_id": job["parameter_set_id"]});
    app.post_json(&format!("{robot}/jobs"), &verification)
        .await
        .problem(409, "joint_map_changed");
    // As it was at first, the controller's values mean the same again; versions count on all the same.
    patch(&app, &robot, &json!({"joint_map": null}))
        .await
        .ok(200);
    app.post_json(&format!("{set}/release"), &why)
        .await
        .problem(409, "release_refused");
    let request =
        json!({"measurement_set_id": job["measurement_set_id"], "method": "least_squares"});
    let new = app.run(&robot, &request).await;
    assert_eq!(
        (&new["status"], &new["robot_version"]),
        (&json!("succeeded"), &json!(3))
    );
    let new_set = format!("/v1/parameter-sets/{}", text(&new["parameter_set_id"]));
    assert_eq!(
        app.get(&new_set).await.ok(200)["sha256"],
        app.get(&set).await.ok(200)["sha256"],
        "the same robot, the same points"
    );
    app.post_json(&format!("{new_set}/release"), &why)
        .await
        .ok(200);
    // From here on the joint map stays; the rest may change.
    let refused = patch(&app, &robot, &sign)
        .await
        .problem(409, "joint_map_released");
    assert!(text(&refused["detail"]).contains("new robot"), "{refused}");
    patch(
        &app,
        &robot,
        &json!({"joint_map": {"sign": [1, 1, 1, 1, 1, 1]}, "mounting": "wall", "name": "renamed"}),
    )
    .await
    .ok(200);
    app.get(&format!("/v1/jobs/{}/report.html", text(&job["id"])))
        .await;
    for check in verify(&app.server.store, &Options::default())
        .await
        .unwrap()
    {
        assert_eq!(check.violations, [""; 0], "{}", check.id);
    }
}

#[tokio::test]
async fn a_job_that_waits_is_computed_with_the_robot_that_it_was_checked_with() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let post = async || {
        let request = json!({"measurement_set_id": set});
        app.post_json(&format!("{robot}/jobs"), &request)
            .await
            .ok(202)
    };
    let before = post().await;
    patch(&app, &robot, &json!({"mounting": "wall"}))
        .await
        .ok(200);
    let after = post().await;
    assert_eq!(
        (&before["robot_version"], &after["robot_version"]),
        (&Value::Null, &json!(2))
    );
    let body = async |job: &Value| {
        let inputs = JobInputs::load(&app.server.store, text(&job["id"])).await;
        serde_json::from_str::<Value>(&inputs.unwrap().robot.body_json).unwrap()
    };
    let sent: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    assert_eq!(body(&before).await["mounting"], sent["mounting"]);
    assert_eq!(body(&after).await["mounting"], "wall");
}

fn edit(version: i64, name: &str, changes_joint_map: bool) -> RobotEdit {
    RobotEdit {
        edited_version: version,
        name: name.into(),
        body_json: format!("{{\"name\":\"{name}\"}}"),
        changes_joint_map,
        changed: vec!["name"],
    }
}

#[test]
fn versions_are_kept_by_the_schema_and_covered_by_the_chain() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "first").await;
        let set = a_set(store, &robot).await;
        let try_edit = async |changes: RobotEdit| {
            let mut tx = store.begin().await.unwrap();
            let edited = robot_versions::edit(&mut tx, &robot.id, &changes, "key_1").await;
            match &edited {
                Ok(_) => tx.commit().await.unwrap(),
                Err(_) => tx.rollback().await.unwrap(),
            }
            edited
        };
        let second = try_edit(edit(1, "second", true)).await.unwrap();
        assert_eq!((second.version, second.joint_map_version), (2, 2));
        assert_eq!(second.name, "second");
        // Somebody else's edit came first.
        let late = try_edit(edit(1, "late", false)).await;
        assert!(
            matches!(late, Err(Error::Conflict(Conflict::RobotChanged))),
            "{late:?}"
        );
        let third = try_edit(edit(2, "third", false)).await.unwrap();
        assert_eq!((third.version, third.joint_map_version), (3, 2));
        let first = robot_versions::robot_at(store, &robot.id, 1).await.unwrap();
        assert_eq!(first.body_json, robot.body_json);

        // A set of version 1 has another joint map than the robot.
        let job = a_job(store, &set, "{}").await;
        assert_eq!(job.robot_version, 1);
        let candidate = a_candidate(store, &set).await;
        assert_eq!(
            (candidate.robot_version, candidate.joint_map_version),
            (1, 1)
        );
        let sql = format!(
            "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[]', release_n_passed = 1, release_n_failed = 0
             where id = '{}'",
            candidate.id
        );
        let refused = sqlx::query(AssertSqlSafe(sql))
            .execute(store.readers())
            .await
            .unwrap_err()
            .to_string();
        assert!(refused.contains("joint map"), "{refused}");
        for sql in [
            "update robot_version set body_json = '[]'",
            "delete from robot_version",
        ] {
            assert!(sqlx::query(sql).execute(store.readers()).await.is_err());
        }
        let violations = async || {
            let checks = verify(store, &Options::default()).await.unwrap();
            checks
                .into_iter()
                .flat_map(|check| check.violations)
                .filter(|what| what.contains(&robot.id))
                .collect::<Vec<_>>()
        };
        assert_eq!(violations().await, [""; 0]);
        // Written past the service: another name, another version, one version more.
        for sql in [
            "update robot set name = 'forged'".to_owned(),
            "update robot set version = 2".into(),
            format!(
                "insert into robot_version (robot_id, version, joint_map_version, body_json, changed_by, changed_at_ms) values ('{}', 9, 2, '[]', 'x', 1)",
                robot.id
            ),
        ] {
            let before = violations().await.len();
            sqlx::query(AssertSqlSafe(sql.clone()))
                .execute(store.readers())
                .await
                .unwrap();
            let found = violations().await;
            assert!(found.len() > before, "{sql}: {found:?}");
        }
    });
}
