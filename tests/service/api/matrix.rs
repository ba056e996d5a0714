//! Role × route × robot: every route that needs a key with every scope, by a key for all robots, for the right robot and for another one, and by revoked
//! and unknown keys. The routes come from the table of routes, so a new route is in the matrix without a change here.

use crate::app::{Answer, TestApp, paper, text};
use crate::people::{guarded, key, revoke, with_key};
use kincal::http::ROUTES;
use kincal::wire::key::Scope;
use reqwest::Method;
use serde_json::{Value, json};

const SCOPES: [&str; 5] = ["read", "upload", "identify", "release", "admin"];
/// Routes about all robots: they refuse every key that is limited to some robots.
const NOT_FOR_LIMITED_KEYS: [(Method, &str); 2] =
    [(Method::POST, "/v1/robots"), (Method::GET, "/metrics")];
/// Routes without a robot in their path: the answer depends on the key.
const OF_NO_ROBOT: [&str; 8] = [
    "/v1/robots",
    "/v1/jobs",
    "/v1/me",
    "/v1/robot-imports",
    "/v1/robot-models",
    "/v1/robot-models/{id}",
    "/v1/overview",
    "/v1/session",
];

/// A robot with one resource of each kind.
struct Cell {
    robot: String,
    ids: Vec<(&'static str, String)>,
}

impl Cell {
    async fn new(app: &TestApp, admin: &str) -> Self {
        let post = async |path: String, content_type: &str, body: Vec<u8>| {
            let request = app
                .request(Method::POST, &path)
                .bearer_auth(admin)
                .header("content-type", content_type)
                .body(body);
            let answer = Answer::of(request).await;
            assert!(
                matches!(answer.status, 201 | 202),
                "{path}: {}",
                answer.text()
            );
            answer.json()
        };
        let robot =
            text(&post("/v1/robots".into(), "application/json", paper("robot.json")).await["id"])
                .to_owned();
        let at = format!("/v1/robots/{robot}");
        let set = post(
            format!("{at}/measurement-sets?frame=base"),
            "text/csv",
            paper("first.csv"),
        )
        .await;
        let frames = post(
            format!("{at}/frames"),
            "text/csv",
            paper("sweeps_instrument.csv"),
        )
        .await;
        let mapping = app
            .request(Method::PUT, &format!("{at}/columns/tracker"))
            .bearer_auth(admin)
            .header("content-type", "application/json")
            .body("{\"q1_deg\": \"J1\"}");
        Answer::of(mapping).await.ok(200);
        for path in ["work-frames/tracker", "tools/tracker"] {
            let named = app
                .request(Method::PUT, &format!("{at}/{path}"))
                .bearer_auth(admin)
                .header("content-type", "application/json")
                .body("{\"translation_mm\": [0, 0, 0]}");
            Answer::of(named).await.ok(200);
        }
        let bar = json!({"items": [{"name": "bar", "nominal_mm": 1000, "measured_mm": 1000.01, "std_mm": 0.01}]});
        let reference = post(
            format!("{at}/references"),
            "application/json",
            bar.to_string().into_bytes(),
        )
        .await;
        let request = json!({"measurement_set_id": set["id"], "method": "pso", "options": {"n_particles": 10, "n_iterations": 5}});
        let mut job = post(
            format!("{at}/jobs"),
            "application/json",
            request.to_string().into_bytes(),
        )
        .await;
        while ["queued", "running"].contains(&text(&job["status"])) {
            let path = format!("/v1/jobs/{}?wait_s=30", text(&job["id"]));
            job = with_key(app, Method::GET, &path, admin, Vec::new())
                .await
                .ok(200);
        }
        let id = |document: &Value, field: &str| text(&document[field]).to_owned();
        let ids = vec![
            ("/v1/measurement-sets/{id}", id(&set, "id")),
            ("/v1/frames/{id}", id(&frames, "id")),
            ("/v1/jobs/{id}", id(&job, "id")),
            ("/v1/parameter-sets/{id}", id(&job, "parameter_set_id")),
            ("/v1/networks/{id}", id(&job, "network_id")),
            ("/v1/robot-models/{id}", "ur_ur5e".into()),
            (
                "/v1/robots/{robot_id}/references/{id}",
                id(&reference, "id"),
            ),
        ];
        Self { robot, ids }
    }

    /// A route's path for this robot's resources.
    fn path(&self, route: &str) -> String {
        let id = self
            .ids
            .iter()
            .find(|(prefix, _)| route.starts_with(prefix))
            .map(|(_, id)| id.as_str());
        assert!(
            id.is_some() || !route.contains("{id}"),
            "{route}: what is its id? add one to this matrix"
        );
        // A missing query is reported before the key's robots are checked.
        let query = match route {
            "/v1/parameter-sets/{id}/compare" => format!("?with={}", id.unwrap_or_default()),
            "/v1/parameter-sets/{id}/export" => "?format=urdf".into(),
            _ => String::new(),
        };
        route
            .replace("{robot_id}", &self.robot)
            .replace("{name}", "tracker")
            .replace("{id}", id.unwrap_or_default())
            + &query
    }
}

/// Routes that need a key.
fn guarded_routes() -> impl Iterator<Item = (Method, &'static str, Scope)> {
    ROUTES
        .iter()
        .filter_map(|route| Some((route.method.clone(), route.path, route.scope?)))
}

#[tokio::test]
async fn every_role_on_every_route_for_every_robot() {
    let (app, _dir) = guarded(1).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let (cell, other) = (Cell::new(&app, &admin).await, Cell::new(&app, &admin).await);
    let mut n_asked = 0;
    for (method, route, scope) in guarded_routes() {
        let path = cell.path(route);
        for name in SCOPES {
            let may = name == scope.as_str() || name == "admin";
            for robots in [None, Some(&cell.robot), Some(&other.robot)] {
                let (key, _) = key(&app, &[name], robots.map(|robot| vec![robot.as_str()])).await;
                let answer = with_key(&app, method.clone(), &path, &key, b"{}".to_vec()).await;
                let said = format!(
                    "{method} {route} with {name} for {robots:?}: {} {}",
                    answer.status,
                    said_of(&answer)
                );
                let code = if answer.status >= 400 {
                    text(&answer.json()["code"]).to_owned()
                } else {
                    String::new()
                };
                let is_other = robots == Some(&other.robot);
                if !may {
                    assert_eq!(
                        (answer.status, code.as_str()),
                        (403, "insufficient_scope"),
                        "{said}"
                    );
                } else if robots.is_some()
                    && NOT_FOR_LIMITED_KEYS.contains(&(method.clone(), route))
                {
                    assert_eq!((answer.status, code.as_str()), (403, "forbidden"), "{said}");
                } else if OF_NO_ROBOT.contains(&route) {
                    assert!(
                        !is_other || !said_of(&answer).contains(&cell.robot),
                        "{said}"
                    );
                } else if is_other {
                    assert_eq!((answer.status, code.as_str()), (404, "not_found"), "{said}");
                } else {
                    assert!(
                        !matches!(answer.status, 401 | 403 | 429 | 500..) && code != "not_found",
                        "{said}"
                    );
                }
                n_asked += 1;
            }
        }
        for answer in [
            without_a_key(&app, &method, &path).await,
            with_a_revoked_key(&app, &method, &path).await,
        ] {
            // An address that tries many keys gets 429 instead of 401; it is refused either way.
            assert!(
                matches!(answer.status, 401 | 429),
                "{method} {route}: {}",
                answer.text()
            );
            n_asked += 1;
        }
    }
    assert!(
        n_asked >= 31 * 17,
        "{n_asked}: the contract has become smaller?"
    );
}

/// Text of an answer; weights have none.
fn said_of(answer: &Answer) -> String {
    String::from_utf8_lossy(&answer.bytes)
        .chars()
        .take(20_000)
        .collect()
}

async fn without_a_key(app: &TestApp, method: &Method, path: &str) -> Answer {
    Answer::of(
        app.request(method.clone(), path)
            .header("content-type", "application/json")
            .body("{}"),
    )
    .await
}

async fn with_a_revoked_key(app: &TestApp, method: &Method, path: &str) -> Answer {
    let (key, id) = key(app, &["admin"], None).await;
    revoke(app, &id).await;
    with_key(app, method.clone(), path, &key, b"{}".to_vec()).await
}

#[tokio::test]
async fn what_another_robot_has_cannot_be_told_from_what_nobody_has() {
    let (app, _dir) = guarded(1).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let (cell, other) = (Cell::new(&app, &admin).await, Cell::new(&app, &admin).await);
    let (limited, _) = key(&app, &["identify"], Some(vec![&cell.robot])).await;
    let jobs = format!("/v1/robots/{}/jobs", cell.robot);
    let own = &cell.ids[0].1;
    let request = |field: &str, id: &str| match field {
        "verify" => {
            json!({"measurement_set_id": own, "verify": {"source": "set", "measurement_set_id": id}})
        }
        "parameter_set_id" => {
            json!({"measurement_set_id": own, "kind": "verify", "parameter_set_id": id})
        }
        "network_id" => json!({"measurement_set_id": own, "method": "bpnn_pso", "network_id": id}),
        "frames_id" => json!({"measurement_set_id": own, "frames_id": id}),
        _ => json!({"measurement_set_id": id}),
    };
    for (field, at, nobodys) in [
        (
            "measurement_set_id",
            0,
            "set_00000000000000000000000000000000",
        ),
        ("verify", 0, "set_00000000000000000000000000000000"),
        ("frames_id", 1, "frames_00000000000000000000000000000000"),
        (
            "parameter_set_id",
            3,
            "params_00000000000000000000000000000000",
        ),
        ("network_id", 4, "network_00000000000000000000000000000000"),
    ] {
        let mut answers = Vec::new();
        for id in [other.ids[at].1.as_str(), nobodys] {
            let answer = with_key(
                &app,
                Method::POST,
                &jobs,
                &limited,
                request(field, id).to_string().into_bytes(),
            )
            .await;
            assert!(answer.status >= 400, "{field}: {}", answer.text());
            answers.push((answer.status, answer.text().replace(id, "ID")));
        }
        assert_eq!(answers[0], answers[1], "{field}");
    }
}
