use crate::api::jobs::first_csv_seen_by_the_instrument;
use crate::app::{Answer, TestApp, paper, text};
use crate::people::{Person, guarded};
use kincal::kinematics::{Link, t_base_flange};
use reqwest::Method;
use serde_json::{Value, json};

fn failed(refusal: &Value) -> Vec<&str> {
    refusal["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|issue| text(&issue["code"]))
        .collect()
}

fn path(job: &Value) -> String {
    format!("/v1/parameter-sets/{}", text(&job["parameter_set_id"]))
}

/// The refusal of a release of a job's parameter set.
async fn refused_release(app: &TestApp, job: &Value) -> Value {
    app.post_json(
        &format!("{}/release", path(job)),
        &json!({"reason": "it fits"}),
    )
    .await
    .problem(409, "release_refused")
}

#[tokio::test]
async fn each_rollback_goes_back_one_set() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.identified().await;
    let rollback = format!("{robot}/parameter-sets/rollback");
    let why = json!({"reason": "the cell makes scrap"});
    app.post_json(&rollback, &why)
        .await
        .problem(409, "nothing_to_roll_back_to");
    let mut jobs = vec![first];
    for seed in [1, 2] {
        let request = json!({"measurement_set_id": jobs[0]["measurement_set_id"], "method": "least_squares", "seed": seed});
        jobs.push(app.run(&robot, &request).await);
    }
    for job in &jobs {
        app.post_json(
            &format!("{}/release", path(job)),
            &json!({"reason": "better"}),
        )
        .await
        .ok(200);
    }
    app.post_json(&rollback, &json!({"reason": ""}))
        .await
        .problem(422, "invalid_reason");
    for back_to in [1, 0] {
        let active = app.post_json(&rollback, &why).await.ok(200);
        assert_eq!(
            (&active["id"], &active["status"]),
            (&jobs[back_to]["parameter_set_id"], &json!("released"))
        );
        assert_eq!(
            app.get(&format!("{robot}/parameter-sets/active"))
                .await
                .ok(200)["id"],
            active["id"]
        );
        assert_eq!(
            app.get(&path(&jobs[back_to + 1])).await.ok(200)["status"],
            "withdrawn"
        );
    }
    app.post_json(&rollback, &why)
        .await
        .problem(409, "nothing_to_roll_back_to");
}

#[tokio::test]
async fn the_gates_are_told_beforehand_as_a_release_will_find_them_and_nothing_changes() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let gates_now = async || app.get(&format!("{}/gates", path(&job))).await.ok(200);
    let names = |found: &Value, passed: bool| -> Vec<String> {
        let gates = found["gates"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|gate| gate["passed"] == passed);
        gates.map(|gate| text(&gate["gate"]).to_owned()).collect()
    };
    let found = gates_now().await;
    assert_eq!(
        (&found["releasable"], &found["evidence"]),
        (&json!(true), &json!("same_upload")),
        "{found}"
    );
    assert!(
        names(&found, false).is_empty() && names(&found, true).len() >= 11,
        "{found}"
    );
    assert!(found["uncertainty_mm"].as_f64().unwrap() > 0.0);
    // With a stricter policy the same gates fail as in the refused release.
    let policy = json!({"tolerance_mm": 1e-6, "independent_session_required": true, "second_person_required": true});
    let put = app
        .request(Method::PUT, &format!("{robot}/policy"))
        .header("content-type", "application/json")
        .body(policy.to_string());
    Answer::of(put).await.ok(200);
    let found = gates_now().await;
    assert_eq!(found["releasable"], false);
    let refused = refused_release(&app, &job).await;
    assert_eq!(names(&found, false), failed(&refused));
    assert!(
        names(&found, false).contains(&"second_person".to_owned()),
        "{found}"
    );
    assert_eq!(
        app.get(&path(&job)).await.ok(200)["status"],
        "candidate",
        "looking changes nothing"
    );
    let taken_back = app
        .post_json(
            &format!("{}/withdraw", path(&job)),
            &json!({"reason": "wrong"}),
        )
        .await
        .ok(200);
    assert_eq!(
        (&taken_back["withdraw_reason"], &taken_back["withdrawn_by"]),
        (&json!("wrong"), &json!("anonymous")),
        "{taken_back}"
    );
    assert!(
        taken_back["withdrawn_at"].is_string() && taken_back["release_reason"].is_null(),
        "{taken_back}"
    );
    let found = gates_now().await;
    assert_eq!(
        (&found["releasable"], names(&found, false)[0].as_str()),
        (&json!(false), "withdrawn")
    );
    app.get("/v1/parameter-sets/params_0/gates")
        .await
        .problem(404, "not_found");
}

/// A gross error among the points to verify stands in the figure of all points, and not in the one beside it.
#[tokio::test(flavor = "multi_thread")]
async fn both_errors_of_the_verify_points_are_told() {
    let app = TestApp::with_workers(1).await;
    let robot = app.paper_robot().await;
    let file = String::from_utf8(paper("first_noisy.csv")).unwrap();
    let mut lines: Vec<String> = file.lines().map(Into::into).collect();
    let row = lines.iter_mut().find(|line| line.contains(",verify,"));
    let row = row.unwrap();
    *row = format!("{}9.0", row.rsplit_once(',').unwrap().0.to_owned() + ",");
    let answer = app.upload_csv(&robot, "frame=base", lines.join("\n")).await;
    let job = app
        .run(&robot, &json!({"measurement_set_id": answer["id"]}))
        .await;
    let report = format!("/v1/jobs/{}/report", text(&job["id"]));
    let report = app.get(&report).await.ok(200);
    let (all, without) = (&report["verify"], &report["verify_without_outliers"]);
    assert_eq!(
        (&all["n_points"], &without["n_points"]),
        (&json!(50), &json!(49))
    );
    assert!(all["after"]["max_mm"].as_f64().unwrap() > 50.0, "{all}");
    assert!(
        without["after"]["rms_mm"].as_f64().unwrap() < 0.2,
        "{without}"
    );
    let gates = app.get(&format!("{}/gates", path(&job))).await.ok(200);
    let mut gates = gates["gates"].as_array().unwrap().iter();
    let improved = gates.find(|gate| gate["gate"] == "verify_errors_improved");
    let detail = text(&improved.unwrap()["detail"]);
    assert!(
        detail.contains("all 50 points: ")
            && detail.contains("without the 1 that a warning names as outliers: "),
        "{detail}"
    );
}

#[tokio::test]
async fn a_set_that_another_session_shows_to_be_no_better_than_nominal_is_never_released() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    // A session of the nominal robot: there the nominal robot is right, and the identified one is not.
    let exact = predicted_by_nominal();
    let session = app.upload_csv(&robot, "frame=base", exact).await;
    let verify = json!({"kind": "verify", "measurement_set_id": session["id"], "parameter_set_id": job["parameter_set_id"]});
    let scored = app.run(&robot, &verify).await;
    assert_eq!(scored["status"], "succeeded");
    let report = app.report(&scored).await;
    assert_eq!(
        (&scored["parameter_set_from"], &report["parameter_set_from"]),
        (&verify["parameter_set_id"], &verify["parameter_set_id"])
    );
    let refused = refused_release(&app, &job).await;
    assert!(
        failed(&refused).contains(&"sessions_better_than_nominal"),
        "{refused}"
    );
    // Nor after many more sessions, each from another upload, in which it is better.
    for left_out in 0..9 {
        let better = rows_of("first.csv", |rows| drop(rows.remove(left_out)));
        let better = app.upload_csv(&robot, "frame=base", better).await;
        let better = json!({"kind": "verify", "measurement_set_id": better["id"], "parameter_set_id": job["parameter_set_id"]});
        assert_eq!(app.run(&robot, &better).await["status"], "succeeded");
    }
    let gates_now = app.get(&format!("{}/gates", path(&job))).await.ok(200);
    assert_eq!(gates_now["releasable"], false, "{gates_now}");
    let refused = refused_release(&app, &job).await;
    let in_doubt = ["check_robot", "sessions_fit"];
    assert!(
        in_doubt.iter().all(|gate| failed(&refused).contains(gate)),
        "{refused}"
    );
    // A reason alone is not enough: the set has fitted no session since.
    let why = json!({"reason": "the robot is as it was"});
    app.post_json(&format!("{robot}/checked"), &why)
        .await
        .ok(200);
    let refused = refused_release(&app, &job).await;
    assert_eq!(failed(&refused), ["sessions_better_than_nominal"]);
    assert!(
        refused["errors"][0]["detail"]
            .as_str()
            .unwrap()
            .contains(text(&scored["id"])),
        "{refused}"
    );
    // The schema refuses it too, even if the code did not check.
    let sql = "update parameter_set set status = 'released', released_at_ms = 1, release_checks_json = '[{\"passed\":true}]', release_n_passed = 1, release_n_failed = 0 where id = $1";
    let error = sqlx::query(sql)
        .bind(text(&job["parameter_set_id"]))
        .execute(app.server.store.readers())
        .await
        .unwrap_err();
    assert!(
        error.to_string().contains("no better than nominal"),
        "{error}"
    );
    app.get(&format!("{robot}/parameter-sets/active"))
        .await
        .problem(404, "no_active_parameter_set");
}

/// Poses of the paper's set with the nominal robot's positions.
fn predicted_by_nominal() -> String {
    let robot: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    let of = |link: &Value, key: &str| link[key].as_f64().unwrap_or(0.0);
    let link = |link: &Value| Link {
        a_mm: of(link, "a_mm"),
        alpha_rad: of(link, "alpha_deg").to_radians(),
        d_mm: of(link, "d_mm"),
        theta_offset_rad: of(link, "theta_offset_deg").to_radians(),
        beta_rad: 0.0,
    };
    let links: Vec<Link> = robot["links"]
        .as_array()
        .unwrap()
        .iter()
        .map(link)
        .collect();
    let mut text = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n".to_owned();
    for line in String::from_utf8(paper("first.csv"))
        .unwrap()
        .lines()
        .skip(1)
    {
        let q: Vec<f64> = line
            .split(',')
            .skip(2)
            .take(6)
            .map(|cell| cell.parse().unwrap())
            .collect();
        let q_rad: Vec<f64> = q.iter().map(|q| q.to_radians()).collect();
        let p = t_base_flange(&links, &q_rad).translation.vector;
        let cells: Vec<String> = q
            .into_iter()
            .chain([p.x, p.y, p.z])
            .map(|x| format!("{x:.6}"))
            .collect();
        text += &(cells.join(",") + "\n");
    }
    text
}

#[tokio::test]
async fn a_set_that_is_worse_than_the_active_one_on_the_same_points_is_not_released() {
    let app = TestApp::with_workers(1).await;
    let (robot, first) = app.identified().await;
    app.post_json(
        &format!("{}/release", path(&first)),
        &json!({"reason": "first"}),
    )
    .await
    .ok(200);
    let active = app
        .get(&format!("{robot}/parameter-sets/active"))
        .await
        .ok(200);
    assert_eq!(
        (&active["release_reason"], &active["released_by"]),
        (&json!("first"), &json!("anonymous")),
        "{active}"
    );
    // Identified with only two parameters: better than nominal, and worse than the active set.
    let few = json!({"measurement_set_id": first["measurement_set_id"], "method": "least_squares", "parameters": {"identify": ["theta_offset_2", "theta_offset_3"]}});
    let second = app.run(&robot, &few).await;
    let refused = app
        .post_json(
            &format!("{}/release", path(&second)),
            &json!({"reason": "simpler"}),
        )
        .await
        .problem(409, "release_refused");
    assert_eq!(failed(&refused), ["improved_on_active"]);
    assert_eq!(
        app.get(&format!("{robot}/parameter-sets/active"))
            .await
            .ok(200)["id"],
        first["parameter_set_id"]
    );
}

#[tokio::test]
async fn a_superseded_set_is_compared_with_the_active_one_unless_it_is_a_rollback() {
    let app = TestApp::with_workers(1).await;
    let (robot, full) = app.identified().await;
    let few = json!({"measurement_set_id": full["measurement_set_id"], "method": "least_squares", "parameters": {"identify": ["theta_offset_2", "theta_offset_3"]}});
    let worse = app.run(&robot, &few).await;
    for job in [&worse, &full] {
        app.post_json(
            &format!("{}/release", path(job)),
            &json!({"reason": "better", "change_reason": "all parameters are identified now"}),
        )
        .await
        .ok(200);
    }
    assert_eq!(app.get(&path(&worse)).await.ok(200)["status"], "superseded");
    let gates_now = app.get(&format!("{}/gates", path(&worse))).await.ok(200);
    assert_eq!(gates_now["releasable"], false, "{gates_now}");
    let again = app
        .post_json(
            &format!("{}/release", path(&worse)),
            &json!({"reason": "again"}),
        )
        .await;
    assert_eq!(
        failed(&again.problem(409, "release_refused")),
        ["improved_on_active"]
    );
    assert_eq!(
        app.get(&format!("{robot}/parameter-sets/active"))
            .await
            .ok(200)["id"],
        full["parameter_set_id"]
    );
    let back = app
        .post_json(
            &format!("{robot}/parameter-sets/rollback"),
            &json!({"reason": "the cell makes scrap"}),
        )
        .await
        .ok(200);
    assert_eq!(back["id"], worse["parameter_set_id"]);
}

#[tokio::test]
async fn the_same_points_uploaded_again_are_no_independent_session() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let policy = json!({"tolerance_mm": null, "independent_session_required": true, "second_person_required": false});
    let put = app
        .request(Method::PUT, &format!("{robot}/policy"))
        .header("content-type", "application/json")
        .body(policy.to_string());
    Answer::of(put).await.ok(200);
    // The same points in other bytes: without the last row and in another order; rounded by a spreadsheet; with a joint a turn further.
    let reversed = rows_of("first.csv", |rows| {
        rows.pop();
        rows.reverse();
    });
    let rounded = rows_of("first.csv", |rows| {
        rows.iter_mut().for_each(|row| {
            (0..9)
                .for_each(|i| row[i] = format!("{:.*}", if i < 6 { 3 } else { 2 }, number(&row[i])))
        })
    });
    let turned = rows_of("first.csv", |rows| {
        rows.iter_mut()
            .for_each(|row| row[0] = (number(&row[0]) + 360.0).to_string())
    });
    // One pose that was measured anew, read ten times.
    let one_pose = rows_of("followup_unchanged.csv", |rows| {
        let row = rows[0].clone();
        rows.clear();
        rows.extend((0..10).map(|i| {
            let mut row = row.clone();
            row[6] = (number(&row[6]) + 0.01 * f64::from(i)).to_string();
            row
        }));
    });
    // The readings of that single pose drift, which is no step: the base is not placed again, and the set is better than the nominal robot.
    let not_anew = ("same_upload", &["evidence"][..]);
    let too_little = ("none", &["evidence"][..]);
    let sets = [
        (reversed, not_anew),
        (rounded, not_anew),
        (turned, not_anew),
        (one_pose, too_little),
    ];
    for (again, (evidence, gates)) in sets {
        let again = app.upload_csv(&robot, "frame=base", again).await;
        let verify = json!({"kind": "verify", "measurement_set_id": again["id"], "parameter_set_id": job["parameter_set_id"]});
        let verified = app.run(&robot, &verify).await;
        assert_eq!(app.report(&verified).await["evidence"], evidence);
        let refused = app
            .post_json(
                &format!("{}/release", path(&job)),
                &json!({"reason": "verified"}),
            )
            .await
            .problem(409, "release_refused");
        assert_eq!(failed(&refused), gates, "{refused}");
    }
}

fn number(cell: &str) -> f64 {
    cell.parse().unwrap()
}

/// A set of the paper's robot, its rows changed: six joints in degrees and three coordinates in mm.
fn rows_of(name: &str, change: impl FnOnce(&mut Vec<Vec<String>>)) -> String {
    let file = String::from_utf8(paper(name)).unwrap();
    let (header, rows) = file.split_once('\n').unwrap();
    let at = header
        .split(',')
        .position(|column| column == "q1_deg")
        .unwrap();
    let mut rows: Vec<Vec<String>> = rows
        .lines()
        .map(|row| row.split(',').skip(at).map(String::from).collect())
        .collect();
    change(&mut rows);
    let header: Vec<&str> = header.split(',').skip(at).collect();
    let rows: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
    format!("{}\n{}\n", header.join(","), rows.join("\n"))
}

#[tokio::test]
async fn repeats_of_a_good_session_do_not_displace_a_bad_one() {
    let app = TestApp::with_workers(1).await;
    // From points with noise: a session is compared with the set's errors on its held-out points.
    let (robot, set) = app.robot_with_set("first_noisy.csv").await;
    let identify = json!({"measurement_set_id": set, "method": "least_squares"});
    let job = app.run(&robot, &identify).await;
    let policy = json!({"tolerance_mm": 0.3, "independent_session_required": false, "second_person_required": false});
    let put = app
        .request(Method::PUT, &format!("{robot}/policy"))
        .header("content-type", "application/json")
        .body(policy.to_string());
    Answer::of(put).await.ok(200);
    let bad = rows_of("followup_unchanged.csv", |rows| {
        rows.iter_mut().enumerate().for_each(|(i, row)| {
            row[6] = (number(&row[6]) + if i % 2 == 0 { 0.4 } else { -0.4 }).to_string()
        })
    });
    let bad = app.upload_csv(&robot, "frame=base", bad).await;
    let verify = |set: &Value| json!({"kind": "verify", "measurement_set_id": set, "parameter_set_id": job["parameter_set_id"]});
    assert_eq!(
        app.run(&robot, &verify(&bad["id"])).await["status"],
        "succeeded"
    );
    for _ in 0..9 {
        assert_eq!(
            app.run(&robot, &verify(&job["measurement_set_id"])).await["status"],
            "succeeded"
        );
    }
    let refused = app
        .post_json(
            &format!("{}/release", path(&job)),
            &json!({"reason": "verified"}),
        )
        .await
        .problem(409, "release_refused");
    assert_eq!(failed(&refused), ["verify_errors_within_tolerance"]);
}

#[tokio::test]
async fn a_policy_is_stored_checked_and_read_back() {
    let app = TestApp::spawn().await;
    let path = format!("{}/policy", app.paper_robot().await);
    let asks_nothing = json!({"tolerance_mm": null, "decision_rule": "guarded_acceptance", "independent_session_required": false, "second_person_required": false});
    assert_eq!(app.get(&path).await.ok(200), asks_nothing);
    let put = async |body: Value| {
        let request = app
            .request(Method::PUT, &path)
            .header("content-type", "application/json")
            .body(body.to_string());
        Answer::of(request).await
    };
    let strict = json!({"tolerance_mm": 0.25, "decision_rule": "simple_acceptance", "independent_session_required": true, "second_person_required": true});
    assert_eq!(put(strict.clone()).await.ok(200), strict);
    assert_eq!(app.get(&path).await.ok(200), strict);
    for wrong in [0.0, -1.0, 1e6] {
        put(json!({"tolerance_mm": wrong}))
            .await
            .problem(422, "invalid_policy");
    }
    put(json!({"tolerance": 1.0}))
        .await
        .problem(422, "invalid_body");
    // Written as fields in order, it would require nothing.
    put(json!([])).await.problem(422, "invalid_body");
    assert_eq!(app.get(&path).await.ok(200), strict);
    app.get("/v1/robots/rob_0/policy")
        .await
        .problem(404, "not_found");
}

#[tokio::test]
async fn an_upload_for_another_serial_number_is_refused() {
    let app = TestApp::spawn().await;
    let mut body: Value = serde_json::from_slice(&paper("robot.json")).unwrap();
    body["serial_number"] = json!("R-1234");
    let robot = format!(
        "/v1/robots/{}",
        text(&app.post_json("/v1/robots", &body).await.ok(201)["id"])
    );
    let upload = async |serial: &str| {
        app.post(
            &format!("{robot}/measurement-sets?frame=base&serial_number={serial}"),
            "text/csv",
            paper("first.csv"),
        )
        .await
    };
    upload("R-1234").await.ok(201);
    let refused = upload("R-9999").await.problem(422, "robot_mismatch");
    assert!(text(&refused["detail"]).contains("R-1234"), "{refused}");
    assert_eq!(
        app.get(&format!("{robot}/measurement-sets")).await.ok(200)["items"]
            .as_array()
            .unwrap()
            .len(),
        1
    );
}

#[tokio::test]
async fn the_uploader_of_the_sweeps_cannot_be_the_second_person() {
    let (app, _dir) = guarded(1).await;
    let scopes = ["read", "upload", "identify", "release"];
    let (a, b, c) = (
        Person::new(&app, &scopes).await,
        Person::new(&app, &scopes).await,
        Person::new(&app, &["read", "release", "admin"]).await,
    );
    let robot = a
        .send(
            Method::POST,
            "/v1/robots",
            "application/json",
            paper("robot.json"),
        )
        .await
        .ok(201);
    let robot = format!("/v1/robots/{}", text(&robot["id"]));
    c.put(
        &format!("{robot}/policy"),
        &json!({"second_person_required": true}),
    )
    .await
    .ok(200);
    let frames = b
        .send(
            Method::POST,
            &format!("{robot}/frames"),
            "text/csv",
            paper("sweeps_instrument.csv"),
        )
        .await
        .ok(201);
    let set = format!("{robot}/measurement-sets?frame=instrument");
    let set = a
        .send(
            Method::POST,
            &set,
            "text/csv",
            first_csv_seen_by_the_instrument(),
        )
        .await
        .ok(201);
    let request = json!({"measurement_set_id": set["id"], "frames_id": frames["id"], "method": "least_squares"});
    let job = a.post(&format!("{robot}/jobs"), &request).await.ok(202);
    let job = a
        .get(&format!("/v1/jobs/{}?wait_s=20", text(&job["id"])))
        .await
        .ok(200);
    let job = if job["status"] == "running" {
        a.get(&format!("/v1/jobs/{}?wait_s=20", text(&job["id"])))
            .await
            .ok(200)
    } else {
        job
    };
    let release = format!("{}/release", path(&job));
    for person in [&a, &b] {
        let refused = person
            .post(&release, &json!({"reason": "seen"}))
            .await
            .problem(409, "release_refused");
        assert_eq!(failed(&refused), ["second_person"]);
    }
    c.post(&release, &json!({"reason": "seen"})).await.ok(200);
}
