//! The overview: every robot with what it needs, in one request for hundreds of them.

use crate::api::suspicions::by_a_tracker;
use crate::app::{Answer, TestApp, paper, text};
use crate::people::{guarded, key, with_key};
use reqwest::Method;
use serde_json::{Value, json};

async fn post(app: &TestApp, key: &str, path: &str, kind: &str, body: Vec<u8>) -> Value {
    let request = app
        .request(Method::POST, path)
        .bearer_auth(key)
        .header("content-type", kind)
        .body(body);
    let answer = Answer::of(request).await;
    assert!(
        matches!(answer.status, 200..=202),
        "{path}: {}",
        answer.text()
    );
    answer.json()
}

async fn robot(app: &TestApp, key: &str) -> String {
    let made = post(
        app,
        key,
        "/v1/robots",
        "application/json",
        paper("robot.json"),
    )
    .await;
    text(&made["id"]).to_owned()
}

/// Runs a job on a set of the paper to its end.
async fn job(app: &TestApp, key: &str, robot: &str, file: &str, more: Value) -> Value {
    job_on(app, key, robot, ("frame=base", paper(file)), more).await
}

/// Runs a job on an upload to its end.
async fn job_on(
    app: &TestApp,
    key: &str,
    robot: &str,
    (query, csv): (&str, Vec<u8>),
    more: Value,
) -> Value {
    let at = format!("/v1/robots/{robot}");
    let path = format!("{at}/measurement-sets?{query}");
    let set = post(app, key, &path, "text/csv", csv).await;
    let mut request = json!({"measurement_set_id": set["id"]});
    for (name, value) in more.as_object().unwrap() {
        request[name] = value.clone();
    }
    let body = request.to_string().into_bytes();
    let mut job = post(app, key, &format!("{at}/jobs"), "application/json", body).await;
    while ["queued", "running"].contains(&text(&job["status"])) {
        let path = format!("/v1/jobs/{}?wait_s=30", text(&job["id"]));
        job = with_key(app, Method::GET, &path, key, vec![]).await.ok(200);
    }
    assert_eq!(job["status"], "succeeded", "{job}");
    job
}

#[tokio::test]
async fn each_robot_says_what_it_needs_most_and_which_job_shows_it() {
    let (app, _dir) = guarded(1).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let untouched = robot(&app, &admin).await;
    let (waiting, released) = (robot(&app, &admin).await, robot(&app, &admin).await);
    let candidate = job(&app, &admin, &waiting, "first_noisy.csv", json!({})).await;
    let active = job(&app, &admin, &released, "first_noisy.csv", json!({})).await;
    let path = format!(
        "/v1/parameter-sets/{}/release",
        text(&active["parameter_set_id"])
    );
    let reason = json!({"reason": "tried", "change_reason": "the first"});
    post(
        &app,
        &admin,
        &path,
        "application/json",
        reason.to_string().into_bytes(),
    )
    .await;
    let of = async |id: &str| {
        let page = with_key(&app, Method::GET, "/v1/overview?limit=200", &admin, vec![])
            .await
            .ok(200);
        let items = page["items"].as_array().unwrap().clone();
        assert_eq!((items.len(), &page["next_cursor"]), (3, &Value::Null));
        items
            .into_iter()
            .find(|item| item["robot_id"] == id)
            .unwrap()
    };
    let first = of(&untouched).await;
    assert_eq!(
        (&first["need"], first.get("last_job"), first.get("active")),
        (&json!("calibrate"), None, None)
    );
    let second = of(&waiting).await;
    assert_eq!(
        (&second["need"], &second["need_job_id"]),
        (&json!("review"), &candidate["id"])
    );
    let third = of(&released).await;
    assert_eq!(
        (&third["need"], &third["reason"]),
        (&json!("nothing"), &json!(""))
    );
    let report = with_key(
        &app,
        Method::GET,
        &format!("/v1/jobs/{}/report", text(&active["id"])),
        &admin,
        vec![],
    )
    .await
    .ok(200);
    assert_eq!(
        third["active"]["after_rms_mm"], report["verify"]["after"]["rms_mm"],
        "the figure of the report"
    );

    // A session of the drifted robot: the released set misses it, and the robot says so before anything else.
    let verify = json!({"kind": "verify", "parameter_set_id": active["parameter_set_id"]});
    let drifted = job(&app, &admin, &released, "followup_collision.csv", verify).await;
    let found = of(&released).await;
    assert!(
        ["drifted", "check_robot"].contains(&text(&found["need"])),
        "{found}"
    );
    assert_eq!(found["need_job_id"], drifted["id"], "{found}");
    assert!(!text(&found["reason"]).is_empty());

    // A robot whose released set was withdrawn has no parameters in its cell.
    for (action, body) in [
        ("release", &reason),
        ("withdraw", &json!({"reason": "bent"})),
    ] {
        let set = text(&candidate["parameter_set_id"]);
        let path = format!("/v1/parameter-sets/{set}/{action}");
        let body = body.to_string().into_bytes();
        post(&app, &admin, &path, "application/json", body).await;
    }
    let found = of(&waiting).await;
    assert_eq!(
        (&found["need"], &found["need_job_id"]),
        (&json!("withdrawn"), &candidate["id"]),
        "{found}"
    );
}

/// The gates that columns decide, in the order in which the overview names them.
const BY_COLUMNS: [&str; 12] = [
    "joint_map_changed",
    "upload_not_insisted",
    "fits",
    "check_robot",
    "verified",
    "verify_errors_improved",
    "uncertainty_within_tolerance",
    "verify_errors_within_tolerance",
    "sessions_fit",
    "sessions_better_than_nominal",
    "measured_since_check",
    "evidence",
];

/// The gate by which the overview says that the newest set is refused. When all gates are asked, it is the first of those that columns decide and that
/// fail.
async fn refused_by(app: &TestApp, key: &str, robot: &str, set: &Value) -> Value {
    let get = async |path: &str| with_key(app, Method::GET, path, key, vec![]).await.ok(200);
    let page = get("/v1/overview?limit=200").await;
    let mut items = page["items"].as_array().unwrap().iter();
    let item = items.find(|item| item["robot_id"] == robot).unwrap();
    let told = item["newest"]["refused_by"].clone();
    let answer = get(&format!("/v1/parameter-sets/{}/gates", text(set))).await;
    let fails = |name: &&str| {
        let mut gates = answer["gates"].as_array().unwrap().iter();
        gates.any(|gate| gate["gate"] == *name && gate["passed"] == false)
    };
    let first = BY_COLUMNS.iter().find(|name| fails(name));
    assert_eq!(told, json!(first), "{answer}");
    told
}

#[tokio::test]
async fn a_candidate_says_which_stored_fact_refuses_its_release() {
    let (app, _dir) = guarded(1).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let robot = robot(&app, &admin).await;
    let candidate = job(&app, &admin, &robot, "first_noisy.csv", json!({})).await;
    let set = &candidate["parameter_set_id"];
    let told = async || refused_by(&app, &admin, &robot, set).await;
    let change = async |method: Method, path: &str, body: Value| {
        let path = format!("/v1/robots/{robot}{path}");
        let body = body.to_string().into_bytes();
        with_key(&app, method, &path, &admin, body).await.ok(200);
    };
    assert_eq!(told().await, Value::Null);
    let path = format!("/v1/jobs/{}/report", text(&candidate["id"]));
    let report = with_key(&app, Method::GET, &path, &admin, vec![])
        .await
        .ok(200);
    let uncertainty_mm = report["tool_uncertainty_mm"]["max"].as_f64().unwrap();
    for (policy, gate) in [
        (
            json!({"tolerance_mm": 0.000_1}),
            "uncertainty_within_tolerance",
        ),
        (
            json!({"tolerance_mm": 1.001 * uncertainty_mm}),
            "verify_errors_within_tolerance",
        ),
        (json!({"independent_session_required": true}), "evidence"),
    ] {
        change(Method::PUT, "/policy", policy).await;
        assert_eq!(told().await, gate);
    }
    change(Method::PUT, "/policy", json!({})).await;
    assert_eq!(told().await, Value::Null);

    // a session of the changed robot: the set misses it
    let verify = json!({"kind": "verify", "parameter_set_id": set});
    job(&app, &admin, &robot, "followup_collision.csv", verify).await;
    assert_ne!(told().await, Value::Null);
    let reason = json!({"reason": "the tool was bent, and is straight again"});
    let path = format!("/v1/robots/{robot}/checked");
    let body = reason.to_string().into_bytes();
    post(&app, &admin, &path, "application/json", body).await;
    told().await;
    let map = json!({"joint_map": {"sign": [1, 1, -1, 1, 1, 1]}});
    change(Method::PATCH, "", map).await;
    assert_eq!(told().await, "joint_map_changed");
}

#[tokio::test]
async fn a_candidate_that_nobody_verified_or_that_was_insisted_on_says_so() {
    let (app, _dir) = guarded(1).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let all_identify = String::from_utf8(paper("first_noisy.csv")).unwrap();
    let all_identify = all_identify.replace("verify", "identify");
    for (query, csv, gate) in [
        ("frame=base", all_identify, "verified"),
        (
            "frame=base&insist=frame_suspect",
            by_a_tracker("first_noisy.csv"),
            "upload_not_insisted",
        ),
    ] {
        let robot = robot(&app, &admin).await;
        let more = json!({"method": "least_squares", "verify": {"source": "subset"}});
        let upload = (query, csv.into_bytes());
        let candidate = job_on(&app, &admin, &robot, upload, more).await;
        let set = &candidate["parameter_set_id"];
        assert_eq!(refused_by(&app, &admin, &robot, set).await, gate);
    }
}

#[tokio::test]
async fn what_was_archived_asks_for_nothing() {
    let (app, _dir) = guarded(1).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    for what in ["parameter-sets", "jobs"] {
        let robot = robot(&app, &admin).await;
        let candidate = job(&app, &admin, &robot, "first_noisy.csv", json!({})).await;
        let id = match what {
            "jobs" => text(&candidate["id"]),
            _ => text(&candidate["parameter_set_id"]),
        };
        let path = format!("/v1/{what}/{id}/archive");
        post(&app, &admin, &path, "application/json", vec![]).await;
        let page = with_key(&app, Method::GET, "/v1/overview?limit=200", &admin, vec![])
            .await
            .ok(200);
        let items = page["items"].as_array().unwrap().iter();
        let found = items.into_iter().find(|item| item["robot_id"] == robot);
        let found = found.unwrap();
        assert_eq!(
            (&found["need"], found.get("newest")),
            (&json!("calibrate"), None),
            "{what}: {found}"
        );
    }
}

#[tokio::test]
async fn the_overview_has_pages_and_only_the_robots_of_the_key() {
    let (app, _dir) = guarded(0).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let mut ids = Vec::new();
    for _ in 0..5 {
        ids.push(robot(&app, &admin).await);
    }
    let (mut seen, mut cursor) = (Vec::new(), String::new());
    loop {
        let path = format!("/v1/overview?limit=2{cursor}");
        let page = with_key(&app, Method::GET, &path, &admin, vec![])
            .await
            .ok(200);
        let items = page["items"].as_array().unwrap();
        seen.extend(items.iter().map(|item| text(&item["robot_id"]).to_owned()));
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break,
        }
    }
    ids.reverse();
    assert_eq!(seen, ids, "newest first, each once");
    let (limited, _) = key(&app, &["read"], Some(vec![&ids[1], &ids[3]])).await;
    let page = with_key(&app, Method::GET, "/v1/overview", &limited, vec![])
        .await
        .ok(200);
    let seen: Vec<&str> = page["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|item| text(&item["robot_id"]))
        .collect();
    assert_eq!(seen, [ids[1].as_str(), ids[3].as_str()]);
}
