use crate::app::{Answer, TestApp, text};
use serde_json::Value;
use std::collections::BTreeSet;

/// The fields and values of a schema, one per line. Fields of a schema that it includes (`allOf`) count as its own.
fn fields(document: &Value, schema: &Value, name: &str, lines: &mut BTreeSet<String>) {
    for (field, of_field) in schema["properties"].as_object().into_iter().flatten() {
        let name = format!("{name}.{field}");
        fields(document, of_field, &name, lines);
        lines.insert(name);
    }
    if schema["items"].is_object() {
        fields(document, &schema["items"], &format!("{name}[]"), lines);
    }
    for kind in ["oneOf", "anyOf", "allOf"] {
        for part in schema[kind].as_array().into_iter().flatten() {
            let named = part["$ref"].as_str().filter(|_| kind == "allOf");
            let part = named
                .and_then(|named| document.pointer(named.strip_prefix('#')?))
                .unwrap_or(part);
            fields(document, part, name, lines);
        }
    }
    for value in schema["enum"].as_array().into_iter().flatten() {
        lines.insert(format!("{name}={}", value.as_str().unwrap_or("None")));
    }
}

/// Everything that the contract promises: routes, their parameters and answers, schemas, their fields and values.
fn promises(document: &Value) -> BTreeSet<String> {
    let mut lines = BTreeSet::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for method in ["get", "post", "put", "delete", "patch"] {
            let operation = &item[method];
            let Some(answers) = operation["responses"].as_object() else {
                continue;
            };
            lines.insert(format!("{method} {path}"));
            lines.extend(
                answers
                    .keys()
                    .map(|status| format!("{method} {path} -> {status}")),
            );
            for parameter in operation["parameters"].as_array().into_iter().flatten() {
                let [place, name] = ["in", "name"].map(|key| parameter[key].as_str().unwrap());
                lines.insert(format!("{method} {path} {place} {name}"));
            }
        }
    }
    for (name, schema) in document["components"]["schemas"].as_object().unwrap() {
        lines.insert(name.clone());
        fields(document, schema, name, &mut lines);
    }
    lines
}

#[test]
fn the_contract_keeps_every_route_field_and_value_that_it_had() {
    let document = serde_json::to_value(kincal::http::openapi()).unwrap();
    let now = promises(&document);
    let before = include_str!("../../data/openapi_d61237a.txt")
        .lines()
        .skip(1);
    let missing: Vec<&str> = before.filter(|line| !now.contains(*line)).collect();
    assert!(missing.is_empty(), "gone from the contract: {missing:?}");
    // The check detects a removed field, a removed value and a removed route.
    for gone in [
        "/paths/~1v1~1robots/post",
        "/components/schemas/RobotAnswer/properties",
        "/components/schemas/Method/enum",
    ] {
        let mut less = document.clone();
        *less.pointer_mut(gone).unwrap_or_else(|| panic!("{gone}")) = Value::Null;
        assert!(promises(&less).len() < now.len(), "{gone}");
    }
}

#[test]
fn openapi_yaml_is_what_the_code_says() {
    let stored = include_str!("../../../openapi.yaml");
    let printed = kincal::http::yaml().unwrap();
    let difference = stored
        .lines()
        .zip(printed.lines())
        .position(|(a, b)| a != b);
    assert!(
        stored == printed,
        "openapi.yaml differs from the code from line {:?} on; make it anew: cargo run -- openapi > openapi.yaml",
        difference.map(|line| line + 1)
    );
}

#[tokio::test]
async fn the_server_hands_out_its_contract_and_a_page_that_needs_nothing_else() {
    let app = TestApp::spawn().await;
    let contract = app.get("/openapi.yaml").await;
    assert_eq!(
        (contract.status, contract.header("content-type")),
        (200, Some("application/yaml"))
    );
    assert_eq!(contract.text(), include_str!("../../../openapi.yaml"));
    let page = app.get("/").await;
    assert!(
        page.header("content-type")
            .unwrap()
            .starts_with("text/html")
    );
    assert!(
        page.header("content-security-policy")
            .unwrap()
            .contains("default-src 'none'")
    );
    assert!(
        page.text().contains("/openapi.yaml")
            && !page.text().contains("http://")
            && !page.text().contains("https://")
    );
    assert_eq!(
        app.get("/openapi.json").await.ok(200)["info"]["title"],
        "kincal"
    );
    assert_eq!(
        (
            app.get("/healthz").await.text(),
            app.get("/readyz").await.text()
        ),
        ("ok\n".into(), "ready\n".into())
    );
}

#[tokio::test]
async fn nothing_in_any_answer_is_to_be_run_framed_guessed_at_or_kept() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let posted = app.post("/v1/robots", "application/json", "{").await;
    posted.problem(400, "malformed_json");
    let mut answers = vec![posted];
    for path in [
        "/",
        "/docs",
        "/healthz",
        "/openapi.yaml",
        "/metrics",
        "/v1/robots",
        robot.as_str(),
        "/v1/jobs/job_0",
        "/nowhere",
    ] {
        answers.push(app.get(path).await);
    }
    for answer in answers {
        assert_eq!(
            answer.header("x-content-type-options"),
            Some("nosniff"),
            "{}",
            answer.text()
        );
        assert_eq!(
            (
                answer.header("x-frame-options"),
                answer.header("referrer-policy")
            ),
            (Some("DENY"), Some("no-referrer"))
        );
        let policy = answer.header("content-security-policy").unwrap();
        assert!(
            policy.contains("default-src 'none'")
                && policy.contains("frame-ancestors 'none'")
                && !policy.contains("unsafe"),
            "{policy}"
        );
        assert!(
            answer.header("cache-control").is_some() && answer.header("x-request-id").is_some()
        );
    }
}

/// Paths of `src="…"` and `href="…"` on this server.
fn linked(page: &str) -> Vec<String> {
    let attributes = page.split('"').zip(page.split('"').skip(1));
    let own = attributes.filter(|(before, value)| {
        (before.ends_with("src=") || before.ends_with("href=")) && value.starts_with("/assets/")
    });
    own.map(|(_, value)| value.to_owned()).collect()
}

#[tokio::test]
async fn pages_are_served_with_a_strict_policy_and_their_files_are_there() {
    let app = TestApp::spawn().await;
    for path in ["/", "/docs"] {
        let page = app.get(path).await;
        let policy = page.header("content-security-policy").unwrap().to_owned();
        assert!(
            policy.contains("script-src 'self'")
                && !policy.contains("unsafe")
                && !policy.contains('*'),
            "{policy}"
        );
        let files = linked(&page.text());
        assert!(files.len() >= 3, "{path}: {files:?}");
        for file in files {
            let answer = app.get(&file).await;
            assert_eq!(answer.status, 200, "{file}");
            let tag = answer.header("etag").unwrap().to_owned();
            let again = Answer::of(
                app.request(reqwest::Method::GET, &file)
                    .header("if-none-match", tag),
            )
            .await;
            assert_eq!((again.status, again.bytes.len()), (304, 0), "{file}");
        }
    }
    app.get("/assets/no-such-file.js")
        .await
        .problem(404, "not_found");
}

#[tokio::test]
async fn the_front_page_says_whether_a_key_is_needed() {
    let app = TestApp::spawn().await;
    assert!(app.get("/").await.text().contains("data-auth=\"none\""));
    assert_eq!(
        app.get("/v1/me").await.ok(200)["scopes"],
        serde_json::json!(["admin"])
    );
}

/// The set's id in the examples.
const SET_ID: &str = "set_0199b6a4c1d27a10b5e43c7f9d2e6a81";

/// What an example needs beside its body: the query.
fn query_of(operation: &str, media_type: &str) -> &'static str {
    match (operation, media_type) {
        ("createMeasurementSet", "text/csv" | "multipart/form-data") => "?frame=base",
        ("importRobot", "application/xml") => "?format=urdf",
        ("importRobot", _) => "?format=mdh",
        ("patchUrdf", _) => "?format=urdf",
        ("compensateProgram", _) => "?tool_z_mm=100",
        _ => "",
    }
}

/// The order of the operations that need the state that others leave behind: they come last.
fn turn_of(operation: &str) -> usize {
    let last = [
        "createJob",
        "rollBackParameterSet",
        "withdrawParameterSet",
        "putPolicy",
    ];
    last.iter()
        .position(|known| *known == operation)
        .map_or(0, |at| at + 1)
}

/// Content type and bytes of an example.
fn body_of(media_type: &str, example: &Value) -> (String, String) {
    match (media_type, example) {
        ("multipart/form-data", Value::Object(files)) => {
            let part = |(name, text): (&String, &Value)| {
                let text = text.as_str().unwrap();
                format!("--b\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n{text}\r\n")
            };
            let parts: String = files.iter().map(part).collect();
            (
                "multipart/form-data; boundary=b".into(),
                parts + "--b--\r\n",
            )
        }
        (_, Value::String(text)) => (media_type.into(), text.clone()),
        _ => (media_type.into(), example.to_string()),
    }
}

#[tokio::test]
async fn every_example_of_a_request_is_taken_for_the_papers_robot() {
    let app = TestApp::with_workers(1).await;
    let (robot, job) = app.identified().await;
    let first = text(&job["parameter_set_id"]).to_owned();
    let set = text(&job["measurement_set_id"]).to_owned();
    let mut requests = Vec::new();
    let document = serde_json::to_value(kincal::http::openapi()).unwrap();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let bodies = operation["requestBody"]["content"].as_object();
            for (media_type, content) in bodies.into_iter().flatten() {
                let id = text(&operation["operationId"]).to_owned();
                if let Some(example) = content.get("example") {
                    requests.push((id, method, path, media_type, example));
                }
            }
        }
    }
    assert!(requests.len() >= 27, "{}", requests.len());
    requests.sort_by_key(|(id, ..)| turn_of(id));
    for (id, method, path, media_type, example) in requests {
        let path = path
            .replace("/v1/robots/{robot_id}", &robot)
            .replace("{name}", "example")
            .replace("{id}", &first);
        let example: Value =
            serde_json::from_str(&example.to_string().replace(SET_ID, &set)).unwrap();
        if id == "createJob" {
            let second = app.run(&robot, &example).await;
            assert_eq!(second["status"], "succeeded", "{second}");
            let path = format!(
                "/v1/parameter-sets/{}/release",
                text(&second["parameter_set_id"])
            );
            let reason = serde_json::json!({"reason": "verified"});
            app.post_json(&path, &reason).await.ok(200);
            continue;
        }
        let (content_type, body) = body_of(media_type, &example);
        let method = method.to_uppercase().parse().unwrap();
        let path = format!("{path}{}", query_of(&id, media_type));
        let request = app
            .request(method, &path)
            .header("content-type", content_type)
            .header("idempotency-key", format!("{id}-{media_type}"))
            .body(body);
        let answer = Answer::of(request).await;
        assert!(
            (200..300).contains(&answer.status),
            "{id} {path} {media_type}: {}\n{example}",
            answer.text()
        );
    }
}
