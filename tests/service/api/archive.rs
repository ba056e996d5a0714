//! Archive and restore: what is put away is out of the way and stays readable, and what was released stays.

use crate::app::{Answer, TestApp, paper, text};
use crate::engines::for_each_engine;
use crate::fixtures::{a_candidate, a_robot, a_set, in_transaction, new_job, new_set};
use crate::process::run_beside;
use kincal::store::verify::{Options, verify};
use kincal::store::{
    Archivable, CheckedState, Conflict, Error, Release, RobotCheck, Store, archive, audit, jobs,
    measurement_sets, parameter_sets,
};
use kincal::wire::report_shape::Evidence;
use serde_json::{Value, json};
use sqlx::AssertSqlSafe;

/// A swarm that trains a network within a second.
fn small_swarm(set: &str) -> Value {
    json!({"measurement_set_id": set, "method": "pso", "options": {"n_particles": 10, "n_iterations": 5}})
}

async fn archive_it(app: &TestApp, path: &str) -> Answer {
    app.post(&format!("{path}/archive"), "", "").await
}

async fn restore_it(app: &TestApp, path: &str) -> Answer {
    app.post(&format!("{path}/restore"), "", "").await
}

#[tokio::test]
async fn a_parameter_set_says_when_its_job_was_archived() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let job = format!("/v1/jobs/{}", text(&job["id"]));
    let told = async || {
        let one = app.get(&set).await.ok(200);
        let mut all = vec![one["job_archived_at"].clone()];
        for list in ["parameter-sets", "history"] {
            let page = app.get(&format!("{robot}/{list}")).await.ok(200);
            assert_eq!(page["total"], 1, "{list}: the set itself is not archived");
            all.push(page["items"][0]["job_archived_at"].clone());
        }
        all
    };
    assert_eq!(told().await, vec![Value::Null; 3]);
    let archived = archive_it(&app, &job).await.ok(200);
    assert_eq!(told().await, vec![archived["archived_at"].clone(); 3]);
    restore_it(&app, &job).await.ok(200);
    assert_eq!(told().await, vec![Value::Null; 3]);
}

#[tokio::test]
async fn archived_items_leave_the_lists_and_are_read_by_id_as_before() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = app.run(&robot, &small_swarm(&set)).await;
    let id = |field: &str| text(&job[field]).to_owned();
    for (list, one) in [
        (
            format!("{robot}/measurement-sets"),
            format!("/v1/measurement-sets/{set}"),
        ),
        (format!("{robot}/jobs"), format!("/v1/jobs/{}", id("id"))),
        ("/v1/jobs".into(), format!("/v1/jobs/{}", id("id"))),
        (
            format!("{robot}/parameter-sets"),
            format!("/v1/parameter-sets/{}", id("parameter_set_id")),
        ),
        (
            format!("{robot}/networks"),
            format!("/v1/networks/{}", id("network_id")),
        ),
        ("/v1/robots".into(), robot.clone()),
    ] {
        let total =
            async |query: &str| app.get(&format!("{list}{query}")).await.ok(200)["total"].clone();
        let before = app.get(&one).await.ok(200);
        assert_eq!(total("").await, 1, "{list}");
        let archived = archive_it(&app, &one).await.ok(200);
        assert!(archived["archived_at"].is_string(), "{archived}");
        assert_eq!(archive_it(&app, &one).await.ok(200), archived, "{one}");
        for (query, n) in [("", 0), ("?archived=true", 1), ("?archived=all", 1)] {
            assert_eq!(total(query).await, n, "{list}{query}");
        }
        let mut read = app.get(&one).await.ok(200);
        assert_eq!(read, archived);
        read.as_object_mut().unwrap().remove("archived_at");
        assert_eq!(read, before);
        assert_eq!(restore_it(&app, &one).await.ok(200), before);
        assert_eq!(restore_it(&app, &one).await.ok(200), before);
        assert_eq!(total("").await, 1, "{list}");
    }
    let report = format!("/v1/jobs/{}/report", id("id"));
    archive_it(&app, &format!("/v1/jobs/{}", id("id")))
        .await
        .ok(200);
    app.get(&report).await.ok(200);
    // Once each, however often it was asked for.
    let entries = audit::list(&app.server.store, 0, 1000).await.unwrap();
    let n = |event: &str| entries.iter().filter(|entry| entry.event == event).count();
    assert_eq!((n("archived"), n("restored")), (7, 6));
    for check in verify(&app.server.store, &Options::default())
        .await
        .unwrap()
    {
        assert_eq!(check.violations, [""; 0], "{}", check.id);
    }
}

#[tokio::test]
async fn an_archived_robot_takes_nothing_new_and_is_still_rolled_back() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.identified().await;
    let request = json!({"measurement_set_id": first["measurement_set_id"], "method": "least_squares", "seed": 1});
    let second = app.run(&robot, &request).await;
    let third = app.run(&robot, &request).await;
    let path = |job: &Value| format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let why = json!({"reason": "it fits"});
    for job in [&first, &second] {
        app.post_json(&format!("{}/release", path(job)), &why)
            .await
            .ok(200);
    }
    archive_it(&app, &robot).await.ok(200);
    let sets = format!("{robot}/measurement-sets?frame=base");
    let put = async |path: &str, body: Value| {
        let request = app.request(reqwest::Method::PUT, &format!("{robot}/{path}"));
        Answer::of(request.json(&body)).await
    };
    let moved = json!({"translation_mm": [0.0, 0.0, 1.0]});
    for refused in [
        put("work-frames/fixture", moved.clone()).await,
        put("tools/gun", moved).await,
        put("columns/log", json!({"q1_deg": "J1"})).await,
        put("policy", json!({"tolerance_mm": 5.0})).await,
        app.post(&sets, "text/csv", paper("first.csv")).await,
        app.post(
            &format!("{robot}/frames"),
            "text/csv",
            paper("sweeps_instrument.csv"),
        )
        .await,
        app.post_json(&format!("{robot}/jobs"), &request).await,
        Answer::of(
            app.request(reqwest::Method::PATCH, &robot)
                .header("content-type", "application/json")
                .body("{\"name\":\"other\"}"),
        )
        .await,
    ] {
        let detail = refused.problem(409, "archived")["detail"].clone();
        assert!(text(&detail).contains("restore it first"), "{detail}");
    }
    let refused = app
        .post_json(&format!("{}/release", path(&third)), &why)
        .await
        .problem(409, "release_refused");
    assert_eq!(refused["errors"][0]["code"], "archived", "{refused}");
    assert!(text(&refused["errors"][0]["detail"]).contains("restore"));
    // The cell is served and can be brought back.
    let active = format!("{robot}/parameter-sets/active");
    assert_eq!(
        app.get(&active).await.ok(200)["id"],
        second["parameter_set_id"]
    );
    let rollback = format!("{robot}/parameter-sets/rollback");
    let back = app.post_json(&rollback, &why).await.ok(200);
    assert_eq!(back["id"], first["parameter_set_id"]);
    app.post_json(&format!("{}/withdraw", path(&first)), &why)
        .await
        .ok(200);

    restore_it(&app, &robot).await.ok(200);
    app.post(&sets, "text/csv", paper("first.csv"))
        .await
        .ok(201);
    // the third set was identified from the same points as the one that was withdrawn: nothing but that is in its way any more
    let refused = app
        .post_json(&format!("{}/release", path(&third)), &why)
        .await
        .problem(409, "release_refused");
    let failed = refused["errors"].as_array().unwrap();
    assert_eq!(failed.len(), 1, "{refused}");
    assert_eq!(failed[0]["code"], "source_withdrawn", "{refused}");
}

#[tokio::test]
async fn what_was_released_and_what_still_runs_is_not_archived() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let set = format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]));
    let why = json!({"reason": "it fits"});
    // An archived candidate is not released until it is restored.
    archive_it(&app, &set).await.ok(200);
    let gates = app.get(&format!("{set}/gates")).await.ok(200);
    assert_eq!(
        (&gates["releasable"], &gates["gates"][0]["gate"]),
        (&json!(false), &json!("archived"))
    );
    app.post_json(&format!("{set}/release"), &why)
        .await
        .problem(409, "release_refused");
    restore_it(&app, &set).await.ok(200);
    app.post_json(&format!("{set}/release"), &why).await.ok(200);
    let refused = archive_it(&app, &set).await.problem(409, "not_archivable");
    assert!(text(&refused["detail"]).contains("history"), "{refused}");
    app.post_json(&format!("{set}/withdraw"), &why)
        .await
        .ok(200);
    archive_it(&app, &set).await.problem(409, "not_archivable");
    drop(robot);

    let idle = TestApp::spawn().await;
    let (robot, set) = idle.robot_with_set("first.csv").await;
    let job = idle
        .post_json(&format!("{robot}/jobs"), &small_swarm(&set))
        .await
        .ok(202);
    let job = format!("/v1/jobs/{}", text(&job["id"]));
    let refused = archive_it(&idle, &job).await.problem(409, "not_archivable");
    assert!(text(&refused["detail"]).contains("cancel"), "{refused}");
    idle.post_json(&format!("{job}/cancel"), &json!({}))
        .await
        .ok(200);
    archive_it(&idle, &job).await.ok(200);
    let nothing = archive_it(&idle, "/v1/jobs/job_0").await;
    nothing.problem(404, "not_found");
}

#[tokio::test]
async fn what_is_archived_is_used_by_no_new_job() {
    let app = TestApp::with_workers(1).await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    let job = app.run(&robot, &small_swarm(&set)).await;
    let network = text(&job["network_id"]).to_owned();
    let parameters = text(&job["parameter_set_id"]).to_owned();
    let jobs = format!("{robot}/jobs");
    let next = json!({"measurement_set_id": set, "method": "bpnn_pso", "options": {"n_particles": 10, "n_iterations": 5}});
    let mut named = next.clone();
    named["network_id"] = json!(network);
    let path = format!("/v1/networks/{network}");
    archive_it(&app, &path).await.ok(200);
    app.post_json(&jobs, &next).await.problem(409, "no_network");
    app.post_json(&jobs, &named).await.problem(409, "archived");
    restore_it(&app, &path).await.ok(200);
    assert_eq!(app.run(&robot, &next).await["status"], "succeeded");

    let verify =
        json!({"measurement_set_id": set, "kind": "verify", "parameter_set_id": parameters});
    let candidate = format!("/v1/parameter-sets/{parameters}");
    archive_it(&app, &candidate).await.ok(200);
    app.post_json(&jobs, &verify).await.problem(409, "archived");
    restore_it(&app, &candidate).await.ok(200);
    archive_it(&app, &format!("/v1/measurement-sets/{set}"))
        .await
        .ok(200);
    let refused = app.post_json(&jobs, &verify).await.problem(409, "archived");
    assert!(text(&refused["detail"]).contains(&set), "{refused}");
    // A set to verify on is a set, too.
    let other = app.upload(&robot, "followup_unchanged.csv").await;
    let request = json!({"measurement_set_id": other, "verify": {"source": "set", "measurement_set_id": set}});
    app.post_json(&jobs, &request)
        .await
        .problem(409, "archived");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_empty_list_says_that_there_are_archived_items() {
    let app = TestApp::spawn().await;
    let (robot, set) = app.robot_with_set("first.csv").await;
    archive_it(&app, &format!("/v1/measurement-sets/{set}"))
        .await
        .ok(200);
    let id = robot.rsplit('/').next().unwrap();
    let told = async |arguments: &[&str]| {
        let server = [("KINCAL_SERVER", app.server.url())];
        let (code, stdout, stderr) = run_beside(arguments, &server).await;
        assert_eq!(code, Some(0), "{stdout}{stderr}");
        stdout
    };
    let sets = told(&["sets", "--robot", id]).await;
    assert!(sets.contains("1 archived: --archived true"), "{sets}");
    let sets = told(&["sets", "--robot", id, "--archived", "true"]).await;
    assert!(sets.contains(&set), "{sets}");
    let other = told(&["sets", "--robot", id, "--search", "no such name"]).await;
    assert!(other.contains("no item matches these filters"), "{other}");
    let jobs = told(&["jobs", "--robot", id]).await;
    assert!(jobs.contains("no job yet"), "{jobs}");
    archive_it(&app, &robot).await.ok(200);
    let robots = told(&["robots"]).await;
    assert!(robots.contains("1 archived: --archived true"), "{robots}");
}

#[tokio::test]
async fn a_repeated_request_has_its_first_answer() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let send = async |action: &str, key: &str| {
        let request = app
            .request(reqwest::Method::POST, &format!("{robot}/{action}"))
            .header("idempotency-key", key);
        Answer::of(request).await
    };
    let first = send("archive", "k").await.ok(200);
    send("restore", "k").await.ok(200);
    let again = send("archive", "k").await;
    assert_eq!(again.header("idempotency-replayed"), Some("true"));
    assert_eq!(again.ok(200), first);
    assert!(app.get(&robot).await.ok(200)["archived_at"].is_null());
}

async fn archived(store: &Store, kind: Archivable, id: &str, robot_id: &str) -> Result<i64, Error> {
    let mut tx = store.begin().await?;
    let at_ms = archive::archive(&mut tx, kind, id, robot_id, "key_1").await?;
    tx.commit().await?;
    Ok(at_ms)
}

fn release(id: &str) -> Release {
    Release {
        id: id.into(),
        checked: CheckedState {
            robot: RobotCheck {
                version: 1,
                ..RobotCheck::default()
            },
            ..CheckedState::default()
        },
        reason: "it fits".into(),
        checks_json: r#"[{"gate":"x","passed":true}]"#.into(),
        n_passed: 1,
        n_failed: 0,
        released_by: "key_1".into(),
        evidence: Evidence::SameUpload,
        uncertainty_mm: None,
    }
}

#[test]
fn the_schema_keeps_what_was_released_and_refuses_what_is_archived() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let set = a_set(store, &robot).await;
        let candidate = a_candidate(store, &set).await;
        let released = async || {
            let mut tx = store.begin().await.unwrap();
            let released = parameter_sets::release(&mut tx, &release(&candidate.id)).await;
            match &released {
                Ok(_) => tx.commit().await.unwrap(),
                Err(_) => tx.rollback().await.unwrap(),
            }
            released.map(|row| row.id)
        };
        let refused_by_schema = |released: Result<String, Error>| {
            assert!(
                matches!(&released, Err(Error::Conflict(Conflict::RefusedBySchema { why })) if why.contains("archived")),
                "{released:?}"
            );
        };
        for (kind, id) in [
            (Archivable::ParameterSet, &candidate.id),
            (Archivable::Robot, &robot.id),
        ] {
            archived(store, kind, id, &robot.id).await.unwrap();
            refused_by_schema(released().await);
            if kind == Archivable::Robot {
                let mut tx = store.begin().await.unwrap();
                let upload = measurement_sets::insert(&mut tx, &new_set(&robot, b"other")).await;
                assert!(
                    matches!(upload, Err(Error::Conflict(Conflict::RobotArchived))),
                    "{upload:?}"
                );
                tx.rollback().await.unwrap();
                let mut tx = store.begin().await.unwrap();
                let job = jobs::insert(&mut tx, &new_job(&set, "{}"), None).await;
                assert!(
                    matches!(job, Err(Error::Conflict(Conflict::RobotArchived))),
                    "{job:?}"
                );
                tx.rollback().await.unwrap();
            }
            in_transaction(store, async |tx| {
                archive::restore(tx, kind, id, &robot.id).await
            })
            .await;
        }
        released().await.unwrap();
        let refused = archived(store, Archivable::ParameterSet, &candidate.id, &robot.id).await;
        assert!(
            matches!(
                refused,
                Err(Error::Conflict(Conflict::NotArchivable { .. }))
            ),
            "{refused:?}"
        );

        // Rows that were written past the service are reported.
        archived(store, Archivable::MeasurementSet, &set.id, &robot.id)
            .await
            .unwrap();
        let violations = async || {
            let checks = verify(store, &Options::default()).await.unwrap();
            let found = checks.into_iter().flat_map(|check| check.violations);
            found
                .filter(|what| what.contains("archived"))
                .collect::<Vec<_>>()
        };
        assert_eq!(violations().await, [""; 0]);
        for sql in [
            format!("delete from archived where id = '{}'", set.id),
            format!(
                "insert into archived (id, kind, robot_id, archived_by, archived_at_ms) values ('{0}', 'robot', '{0}', 'key_0', 5)",
                robot.id
            ),
        ] {
            sqlx::query(AssertSqlSafe(sql))
                .execute(store.readers())
                .await
                .unwrap();
        }
        let found = violations().await;
        for id in [&set.id, &robot.id] {
            assert!(found.iter().any(|what| what.contains(id)), "{found:?}");
        }
    });
}
