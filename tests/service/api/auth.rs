use crate::app::{Answer, paper, text};
use crate::people::{guarded, key, revoke, with_key};
use kincal::http::auth::new_key;
use kincal::http::{ROUTES, Route};
use kincal::wire::key::Scope;
use reqwest::Method;
use serde_json::json;
use std::time::Duration;

#[tokio::test]
async fn without_a_key_nothing_but_health_and_contract_answers() {
    let (app, _dir) = guarded(0).await;
    for Route {
        method,
        path,
        scope,
        ..
    } in ROUTES
    {
        if scope.is_none() {
            let path = path.replace("{file}", "app.js");
            assert_eq!(app.get(&path).await.status, 200, "{path}");
            continue;
        }
        let path = path.replace("{robot_id}", "rob_1").replace("{id}", "x_1");
        let answer = Answer::of(app.request(method.clone(), &path)).await;
        answer.problem(401, "unauthorized");
        assert_eq!(
            answer.header("www-authenticate"),
            Some("Bearer realm=\"kincal\"")
        );
    }
    for value in ["Bearer nonsense", "Basic dTpw", "Bearer", "Bearer \u{e9}"] {
        let value = reqwest::header::HeaderValue::from_bytes(value.as_bytes()).unwrap();
        Answer::of(
            app.request(Method::GET, "/v1/robots")
                .header("authorization", value),
        )
        .await
        .problem(401, "unauthorized");
    }
}

#[tokio::test]
async fn each_route_takes_its_scope_and_no_other() {
    let (app, _dir) = guarded(0).await;
    let all = ["read", "upload", "identify", "release"];
    for Route {
        method,
        path,
        scope,
        ..
    } in ROUTES
    {
        let Some(scope) = scope else { continue };
        let path = path.replace("{robot_id}", "rob_1").replace("{id}", "x_1");
        for name in all.into_iter().chain(["admin"]) {
            let (key, _) = key(&app, &[name], None).await;
            let answer = with_key(&app, method.clone(), &path, &key, Vec::new()).await;
            if name == scope.as_str() || name == "admin" {
                assert!(
                    answer.status != 401 && answer.status != 403,
                    "{method} {path} with {name}: {}",
                    answer.text()
                );
            } else {
                answer.problem(403, "insufficient_scope");
                assert!(
                    answer
                        .header("www-authenticate")
                        .unwrap()
                        .contains(scope.as_str())
                );
            }
        }
    }
}

#[tokio::test]
async fn a_priority_above_0_takes_scope_admin_and_the_challenge_names_the_scope_alone() {
    let (app, _dir) = guarded(0).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let robot = with_key(
        &app,
        Method::POST,
        "/v1/robots",
        &admin,
        paper("robot.json"),
    )
    .await
    .ok(201);
    let (identify, _) = key(&app, &["identify"], None).await;
    let body = json!({"measurement_set_id": "set_0", "priority": 1})
        .to_string()
        .into_bytes();
    let answer = with_key(
        &app,
        Method::POST,
        &format!("/v1/robots/{}/jobs", text(&robot["id"])),
        &identify,
        body,
    )
    .await;
    let problem = answer.problem(403, "insufficient_scope");
    let challenge = "Bearer realm=\"kincal\", error=\"insufficient_scope\", scope=\"admin\"";
    assert_eq!(answer.header("www-authenticate"), Some(challenge));
    let detail = text(&problem["detail"]);
    assert!(
        detail.contains("a priority above 0") && detail.contains("--scope admin …"),
        "{detail}"
    );
}

#[test]
fn the_contract_has_the_routes_of_the_table_and_no_others() {
    let document = kincal::http::openapi();
    let items = document.paths.paths.iter();
    let documented: Vec<String> = items
        .flat_map(|(path, item)| {
            let all = [
                (Method::GET, &item.get),
                (Method::POST, &item.post),
                (Method::PUT, &item.put),
                (Method::DELETE, &item.delete),
                (Method::PATCH, &item.patch),
            ];
            let there = all.into_iter().filter(|(_, operation)| operation.is_some());
            there.map(move |(method, _)| format!("{method} {path}"))
        })
        .collect();
    assert_eq!(documented.len(), ROUTES.len());
    for Route { method, path, .. } in ROUTES {
        assert!(
            documented.contains(&format!("{method} {path}")),
            "{method} {path} is not in the contract"
        );
    }
}

#[tokio::test]
async fn a_scope_that_this_version_does_not_know_gives_no_right_and_takes_none() {
    let (app, _dir) = guarded(0).await;
    let (reader, _) = key(&app, &["of_a_newer_version", "read"], None).await;
    let me = with_key(&app, Method::GET, "/v1/me", &reader, vec![])
        .await
        .ok(200);
    assert_eq!(me["scopes"], json!(["read"]));
    let robot = || paper("robot.json");
    with_key(&app, Method::POST, "/v1/robots", &reader, robot())
        .await
        .problem(403, "insufficient_scope");
    let (nothing, _) = key(&app, &["of_a_newer_version"], None).await;
    with_key(&app, Method::GET, "/v1/robots", &nothing, vec![])
        .await
        .problem(403, "insufficient_scope");
}

#[tokio::test]
async fn a_key_limited_to_a_robot_sees_no_other() {
    let (app, _dir) = guarded(0).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let mut ids = Vec::new();
    for _ in 0..2 {
        ids.push(
            text(
                &with_key(
                    &app,
                    Method::POST,
                    "/v1/robots",
                    &admin,
                    paper("robot.json"),
                )
                .await
                .ok(201)["id"],
            )
            .to_owned(),
        );
    }
    let set = json!({"frame": "base", "points": [{"q_deg": [0, 0, 0, 0, 0, 0], "position_mm": [1, 2, 3]}]}).to_string().into_bytes();
    let other_set = with_key(
        &app,
        Method::POST,
        &format!("/v1/robots/{}/measurement-sets", ids[1]),
        &admin,
        set.clone(),
    )
    .await
    .ok(201);
    let (limited, _) = key(&app, &["read", "upload", "identify"], Some(vec![&ids[0]])).await;
    let list = with_key(&app, Method::GET, "/v1/robots", &limited, Vec::new())
        .await
        .ok(200);
    assert_eq!(
        list["items"]
            .as_array()
            .unwrap()
            .iter()
            .map(|robot| text(&robot["id"]))
            .collect::<Vec<_>>(),
        [ids[0].as_str()]
    );
    for path in [
        format!("/v1/robots/{}", ids[1]),
        format!("/v1/robots/{}/jobs", ids[1]),
        format!("/v1/measurement-sets/{}", text(&other_set["id"])),
    ] {
        with_key(&app, Method::GET, &path, &limited, Vec::new())
            .await
            .problem(404, "not_found");
    }
    with_key(
        &app,
        Method::POST,
        &format!("/v1/robots/{}/measurement-sets", ids[1]),
        &limited,
        set.clone(),
    )
    .await
    .problem(404, "not_found");
    with_key(
        &app,
        Method::POST,
        "/v1/robots",
        &limited,
        paper("robot.json"),
    )
    .await
    .problem(403, "forbidden");
    with_key(
        &app,
        Method::POST,
        &format!("/v1/robots/{}/measurement-sets", ids[0]),
        &limited,
        set,
    )
    .await
    .ok(201);
}

#[tokio::test]
async fn a_revoked_key_is_refused_at_once() {
    let (app, _dir) = guarded(0).await;
    let (key, id) = key(&app, &["read"], None).await;
    with_key(&app, Method::GET, "/v1/robots", &key, Vec::new())
        .await
        .ok(200);
    revoke(&app, &id).await;
    with_key(&app, Method::GET, "/v1/robots", &key, Vec::new())
        .await
        .problem(401, "unauthorized");
}

#[tokio::test]
async fn a_stream_of_events_ends_with_its_key() {
    let (app, _dir) = guarded(0).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let robot = with_key(
        &app,
        Method::POST,
        "/v1/robots",
        &admin,
        paper("robot.json"),
    )
    .await
    .ok(201);
    let robot = format!("/v1/robots/{}", text(&robot["id"]));
    let upload = app
        .request(
            Method::POST,
            &format!("{robot}/measurement-sets?frame=base"),
        )
        .bearer_auth(&admin);
    let set = Answer::of(
        upload
            .header("content-type", "text/csv")
            .body(paper("first.csv")),
    )
    .await
    .ok(201);
    let body = json!({"measurement_set_id": set["id"]})
        .to_string()
        .into_bytes();
    let job = with_key(&app, Method::POST, &format!("{robot}/jobs"), &admin, body)
        .await
        .ok(202);
    let (reader, id) = key(&app, &["read"], None).await;
    let events = format!("/v1/jobs/{}/events", text(&job["id"]));
    let mut stream = app
        .request(Method::GET, &events)
        .bearer_auth(&reader)
        .send()
        .await
        .unwrap();
    assert!(
        stream
            .chunk()
            .await
            .unwrap()
            .unwrap()
            .starts_with(b"event: progress")
    );
    revoke(&app, &id).await;
    // Without workers the job stays queued, so that nothing else ends the stream; a comment comes only after 15 s.
    let end = tokio::time::timeout(Duration::from_secs(10), stream.chunk())
        .await
        .expect("the stream ends");
    assert_eq!(end.unwrap(), None);
}

#[tokio::test]
async fn one_holders_idempotency_keys_are_not_anothers() {
    let (app, _dir) = guarded(0).await;
    let mut ids = Vec::new();
    for _ in 0..2 {
        let (key, _) = key(&app, &["upload"], None).await;
        let request = app
            .request(Method::POST, "/v1/robots")
            .bearer_auth(key)
            .header("idempotency-key", "same");
        ids.push(
            Answer::of(
                request
                    .header("content-type", "application/json")
                    .body(paper("robot.json")),
            )
            .await
            .ok(201)["id"]
                .clone(),
        );
    }
    assert_ne!(ids[0], ids[1]);
}

#[test]
fn a_key_has_256_random_bits() {
    let key = new_key().unwrap();
    assert_eq!(key.text.len(), "kincal_".len() + 64);
    let hash = kincal::wire::canonical::sha256_hex(key.text.as_bytes());
    assert_eq!(key.sha256, hash);
    assert_ne!(new_key().unwrap().text, key.text);
    assert_eq!(serde_json::json!(Scope::Upload), Scope::Upload.as_str());
}
