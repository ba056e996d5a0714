//! The bounds in `openapi.yaml` are the server's: for each bound of each field of each request, a value beyond it is refused at that field,
//! and the value at the bound is not.

use crate::app::{Answer, TestApp};
use reqwest::Method;
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;

/// Texts of refusals that are about bounds. Other refusals (such as an invalid rotation) may also come at a bound.
const OUT_OF_BOUNDS: [&str; 4] = ["out_of_range", "wrong_length", "invalid_body", "not_a_time"];
/// Longest list that is sent at its bound. For longer ones the server computes too long, so only a list beyond the bound is sent.
const LONG: u64 = 5_000;
/// Fields without bounds: they accept any number of their type.
const UNBOUNDED: [&str; 3] = [
    "JobRequestBody.seed",
    "PointBody.sequence",
    "PosePlanBody.seed",
];
/// Lists with one item per joint: at the general bound their length is wrong for the test's robot.
const PER_JOINT: [&str; 6] = [
    "/sign",
    "/offset_deg",
    "/coupling",
    "/q_deg",
    "/q_near_deg",
    "/joint_limits_deg",
];

/// The contract.
fn contract() -> Value {
    serde_json::from_str(kincal::http::json().unwrap()).unwrap()
}

/// Resolves a schema: follows references, and removes the `null` of an optional field.
fn resolved<'s>(contract: &'s Value, schema: &'s Value) -> Vec<&'s Value> {
    if let Some(name) = schema["$ref"].as_str() {
        let pointer = name.strip_prefix('#').unwrap();
        return resolved(contract, contract.pointer(pointer).unwrap());
    }
    match schema["oneOf"].as_array() {
        Some(variants) => variants
            .iter()
            .flat_map(|variant| resolved(contract, variant))
            .collect(),
        None => vec![schema],
    }
}

fn is(schema: &Value, kind: &str) -> bool {
    schema["type"] == kind
        || schema["type"]
            .as_array()
            .is_some_and(|kinds| kinds.iter().any(|known| known == kind))
}

/// A value to put at `pointer`, and whether the server should refuse it.
struct Case {
    pointer: String,
    value: Value,
    is_beyond: bool,
    of: String,
}

/// The cases of one value and of everything inside it.
fn cases(contract: &Value, schema: &Value, value: &Value, pointer: &str, cases_of: &mut Vec<Case>) {
    let number = |key: &str, schema: &Value| schema[key].as_f64();
    for schema in resolved(contract, schema) {
        let mut add = |bound: &str, value: Value, is_beyond: bool| {
            let (pointer, of) = (pointer.to_owned(), format!("{bound} {}", schema[bound]));
            cases_of.push(Case {
                pointer,
                value,
                is_beyond,
                of,
            });
        };
        match value {
            Value::Array(items) if is(schema, "array") => {
                let field = pointer.trim_end_matches("/0");
                let is_per_joint = PER_JOINT.iter().any(|name| field.ends_with(name));
                let last = items.last().expect("an example of each list has items");
                let of = |n: u64| Value::from(vec![last.clone(); usize::try_from(n).unwrap()]);
                if let Some(n) = schema["minItems"].as_u64() {
                    add("minItems", of(n - 1), true);
                    if !is_per_joint {
                        add("minItems", of(n), false);
                    }
                }
                if let Some(n) = schema["maxItems"].as_u64() {
                    add("maxItems", of(n + 1), true);
                    if n < LONG && !is_per_joint {
                        add("maxItems", of(n), false);
                    }
                }
                cases(
                    contract,
                    &schema["items"],
                    &items[0],
                    &format!("{pointer}/0"),
                    cases_of,
                );
            }
            Value::Object(fields) if is(schema, "object") => {
                for (name, value) in fields {
                    if let Some(field) = schema["properties"].get(name) {
                        cases(
                            contract,
                            field,
                            value,
                            &format!("{pointer}/{name}"),
                            cases_of,
                        );
                    }
                }
            }
            Value::String(_) if is(schema, "string") && schema["format"] == "date-time" => {
                add("format", "yesterday".into(), true);
                add("format", "2026-03-01T08:15:30Z".into(), false);
            }
            Value::String(_) if is(schema, "string") => {
                let text = |n: u64| Value::from("a".repeat(usize::try_from(n).unwrap()));
                if let Some(n) = schema["minLength"].as_u64() {
                    add("minLength", text(n - 1), true);
                    add("minLength", text(n), false);
                }
                if let Some(n) = schema["maxLength"].as_u64() {
                    add("maxLength", text(n + 1), true);
                    add("maxLength", text(n), false);
                }
            }
            Value::Number(_) if is(schema, "integer") => {
                for (bound, step) in [("minimum", -1), ("maximum", 1)] {
                    if let Some(n) = schema[bound].as_i64() {
                        add(bound, (n + step).into(), true);
                        add(bound, n.into(), false);
                    }
                }
            }
            Value::Number(_) if is(schema, "number") => {
                for (bound, sign) in [("minimum", -1.0), ("maximum", 1.0)] {
                    if let Some(x) = number(bound, schema) {
                        add(bound, (x + sign * x.abs().max(1e-9) * 1e-6).into(), true);
                        add(bound, x.into(), false);
                    }
                }
                for bound in ["exclusiveMinimum", "exclusiveMaximum"] {
                    if let Some(x) = number(bound, schema) {
                        add(bound, x.into(), true);
                    }
                }
            }
            _ => {}
        }
    }
}

/// An example of each request body with every field that it may have: method, path, path in the contract, body.
async fn examples(app: &TestApp) -> Vec<(Method, String, &'static str, Value)> {
    let (robot, job) = app.identified().await;
    let set = format!(
        "/v1/parameter-sets/{}",
        job["parameter_set_id"].as_str().unwrap()
    );
    let measured = job["measurement_set_id"].as_str().unwrap();
    let mut body: Value = serde_json::from_slice(&crate::app::paper("robot.json")).unwrap();
    let n = body["links"].as_array().unwrap().len();
    let identity: Vec<Vec<f64>> = (0..n)
        .map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect())
        .collect();
    for (name, value) in [
        ("serial_number", json!("A-1")),
        ("description", json!("an arm")),
        (
            "mounting",
            json!({"gravity_in_base": [0, 0, -1], "std_deg": 2.0}),
        ),
        (
            "joint_map",
            json!({"sign": vec![1; n], "offset_deg": vec![0; n], "coupling": identity}),
        ),
    ] {
        body[name] = value;
    }
    body["links"][0]["beta_deg"] = json!(0.0);
    body["links"][0]["joint_limits_deg"] = json!([-170, 170]);
    let limits = vec![json!([-170, 170]); n];
    let patch = json!({"joint_limits_deg": limits, "joint_map": body["joint_map"], "name": "r", "serial_number": "A-1", "description": "an arm", "mounting": body["mounting"]});
    let q = vec![10.0; n];
    let payload = json!({"mass_kg": 5, "centre_mm": [0, 0, 50]});
    let point = json!({"q_deg": q, "position_mm": [1000, 100, 800], "configuration": "1", "target": 0, "subset": "identify", "std_mm": 0.05,
        "station": "s", "session": "s", "sequence": 1, "temperature_c": 20, "measured_at": "2026-03-01T08:15:30Z"});
    let mut pose = point.clone();
    (pose["quaternion"], pose["std_rotation_deg"]) = (json!([1, 0, 0, 0]), json!(0.01));
    let mut by_axes = point.clone();
    by_axes.as_object_mut().unwrap().remove("std_mm");
    by_axes["std_axes_mm"] = json!([0.05, 0.05, 0.1]);
    let fixture =
        |nominal_mm: [f64; 3]| json!({"nominal_mm": nominal_mm, "measured_mm": nominal_mm});
    let fixture: Vec<Value> = [[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0]]
        .map(fixture)
        .into();
    let cartesian =
        json!({"position_mm": [800, 0, 800], "quaternion": [1, 0, 0, 0], "q_near_deg": q});
    let prior = json!({"name": "a_1", "std": 0.1, "mean": 0, "min": -1e6, "max": 1e6});
    let mut job = json!({"measurement_set_id": measured, "seed": 1, "priority": 0, "payload": payload,
        "parameters": {"hold": ["a_2"], "priors": [prior]}, "verify": {"source": "fraction", "fraction": 0.5}});
    job["options"] = json!({"n_particles": 10, "n_iterations": 10, "inertia_weight": 0.5, "cognitive": 1, "social": 1,
        "search_half_width_mm": 1, "search_half_width_deg": 1, "stop_at_cost_mm2": 1});
    let with = |field: &str, value: Value| {
        let mut job = json!({"measurement_set_id": measured});
        job[field] = value;
        job
    };
    let jobs = [
        job,
        with("frames_id", json!("f")),
        with("network_id", json!("n")),
        with("residual_network_id", json!("n")),
        with("parameter_set_id", json!("p")),
        with(
            "verify",
            json!({"source": "set", "measurement_set_id": "m"}),
        ),
        with("parameters", json!({"identify": ["a_2"]})),
        json!({"measurement_set_ids": [measured, "m"]}),
    ];
    let plan = json!({"n_configurations": 300, "seed": 1, "target_mm": [0, 0, 100], "noise_std_mm": 0.05, "n_candidates": 310, "n_repeats": 3,
        "boxes": [{"min_mm": [-2000, -2000, -2000], "max_mm": [2000, 2000, 2000]}], "floor_z_mm": -5000,
        "base_cylinder": {"radius_mm": 1, "height_mm": 1}, "measured": [measured], "kind": "position", "noise_std_rotation_deg": 0.02,
        "keep_out": [{"min_mm": [-9000, 0, 0], "max_mm": [-8000, 1, 1]}], "target_axis": [0, 0, 1], "target_half_angle_deg": 180,
        "set_ups": [{"name": "a", "instrument_mm": [3000, 0, 1000], "boxes": [{"min_mm": [-2000, -2000, -2000], "max_mm": [2000, 2000, 2000]}]}]});
    let compensate = json!({"q_deg": [q], "tool": {"translation_mm": [0, 0, 100], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "payload": payload});
    let post = |path: String, template, body| (Method::POST, path, template, body);
    let mut all = vec![
        post("/v1/robots".into(), "/v1/robots", body),
        (Method::PATCH, robot.clone(), "/v1/robots/{robot_id}", patch),
        post(
            format!("{robot}/measurement-sets"),
            "/v1/robots/{robot_id}/measurement-sets",
            json!({"frame": "base", "name": "a set", "points": [point]}),
        ),
        post(
            format!("{robot}/measurement-sets"),
            "/v1/robots/{robot_id}/measurement-sets",
            json!({"frame": "base", "points": [pose]}),
        ),
        post(
            format!("{robot}/measurement-sets"),
            "/v1/robots/{robot_id}/measurement-sets",
            json!({"frame": "base", "points": [by_axes]}),
        ),
        post(
            format!("{robot}/checked"),
            "/v1/robots/{robot_id}/checked",
            json!({"reason": "r"}),
        ),
        (
            Method::PUT,
            format!("{robot}/work-frames/table"),
            "/v1/robots/{robot_id}/work-frames/{name}",
            json!({"points": fixture, "std_mm": 0.05}),
        ),
        (
            Method::PUT,
            format!("{robot}/work-frames/typed"),
            "/v1/robots/{robot_id}/work-frames/{name}",
            json!({"reference": "measuring", "measurement_set_id": measured, "translation_mm": [0, 0, 100], "quaternion": [1, 0, 0, 0]}),
        ),
        (
            Method::PUT,
            format!("{robot}/tools/gripper"),
            "/v1/robots/{robot_id}/tools/{name}",
            json!({"translation_mm": [0, 0, 100], "quaternion": [1, 0, 0, 0]}),
        ),
        post(
            format!("{robot}/references"),
            "/v1/robots/{robot_id}/references",
            json!({"name": "bar", "instrument": "AT960", "items": [{"name": "2 m", "nominal_mm": 2000, "measured_mm": 2000.01, "std_mm": 0.01}]}),
        ),
        post(
            format!("{set}/compensate"),
            "/v1/parameter-sets/{id}/compensate",
            json!({"targets": [cartesian], "frame": "base", "target": 0}),
        ),
        post(
            format!("{set}/compensate"),
            "/v1/parameter-sets/{id}/compensate",
            json!({"q_deg": [q], "tool_name": "gripper"}),
        ),
        post(
            format!("{robot}/pose-plans"),
            "/v1/robots/{robot_id}/pose-plans",
            plan,
        ),
        post(
            format!("{robot}/posture"),
            "/v1/robots/{robot_id}/posture",
            json!({"q_deg": q, "shown_position_mm": [1000, 0, 1000], "tool": {"translation_mm": [0, 0, 100]}}),
        ),
        (
            Method::PUT,
            format!("{robot}/policy"),
            "/v1/robots/{robot_id}/policy",
            json!({"tolerance_mm": 1.0}),
        ),
        post(
            format!("{set}/predict"),
            "/v1/parameter-sets/{id}/predict",
            json!({"q_deg": [q], "target": 0, "segment": 0, "payload": payload}),
        ),
        post(
            format!("{set}/compensate"),
            "/v1/parameter-sets/{id}/compensate",
            compensate,
        ),
        post(
            format!("{set}/compensate"),
            "/v1/parameter-sets/{id}/compensate",
            json!({"q_deg": [q], "target": 0}),
        ),
        post(
            format!("{set}/release"),
            "/v1/parameter-sets/{id}/release",
            json!({"reason": "r", "change_reason": "r"}),
        ),
        post(
            format!("{set}/withdraw"),
            "/v1/parameter-sets/{id}/withdraw",
            json!({"reason": "r"}),
        ),
        post(
            format!("{robot}/parameter-sets/rollback"),
            "/v1/robots/{robot_id}/parameter-sets/rollback",
            json!({"reason": "r"}),
        ),
    ];
    for job in jobs {
        let (path, template) = (format!("{robot}/jobs"), "/v1/robots/{robot_id}/jobs");
        all.push(post(path, template, job));
    }
    all
}

/// Operations whose JSON body has no schema with bounds: a mapping of columns may have any names, an import takes tables of any kind.
const FREE_BODIES: [&str; 2] = ["/v1/robots/{robot_id}/columns/{name}", "/v1/robot-imports"];

#[tokio::test]
async fn every_json_body_of_the_contract_has_an_example_here() {
    let app = TestApp::with_workers(1).await;
    let contract = contract();
    let examples = examples(&app).await;
    let mut without = Vec::new();
    for (path, operations) in contract["paths"].as_object().unwrap() {
        for (method, operation) in operations.as_object().unwrap() {
            let has_body = !operation["requestBody"]["content"]["application/json"].is_null();
            let is_here = examples.iter().any(|(known, _, template, _)| {
                template == path && known.as_str().eq_ignore_ascii_case(method)
            });
            if has_body && !is_here && !FREE_BODIES.contains(&path.as_str()) {
                without.push(format!("{method} {path}"));
            }
        }
    }
    assert!(without.is_empty(), "{}", without.join(", "));
}

/// The schema of an operation's JSON body.
fn body_schema<'s>(contract: &'s Value, method: &Method, template: &str) -> &'s Value {
    let method = method.as_str().to_lowercase();
    &contract["paths"][template][method]["requestBody"]["content"]["application/json"]["schema"]
}

/// True if an answer says that the value at `pointer`, or something that it is part of, is out of bounds.
fn is_about(answer: &Answer, pointer: &str, codes: &[&str]) -> bool {
    let errors = answer.json()["errors"].clone();
    errors.as_array().is_some_and(|errors| {
        errors.iter().any(|issue| {
            let at = issue["pointer"].as_str().unwrap_or("-");
            let code = issue["code"].as_str().unwrap_or_default();
            (pointer == at || pointer.starts_with(&format!("{at}/")))
                && (codes.is_empty() || codes.contains(&code))
        })
    })
}

#[tokio::test]
async fn the_bounds_in_the_contract_are_the_servers() {
    let app = TestApp::with_workers(1).await;
    let contract = contract();
    let (mut n_beyond, mut n_at, mut faults) = (0, 0, Vec::new());
    for (method, path, template, example) in examples(&app).await {
        let mut all = Vec::new();
        cases(
            &contract,
            body_schema(&contract, &method, template),
            &example,
            "",
            &mut all,
        );
        assert!(!all.is_empty(), "{template}");
        for Case {
            pointer,
            value,
            is_beyond,
            of,
        } in all
        {
            let mut body = example.clone();
            *body.pointer_mut(&pointer).unwrap() = value;
            let request = app
                .request(method.clone(), &path)
                .header("content-type", "application/json")
                .body(body.to_string());
            let answer = Answer::of(request).await;
            let is_right = if is_beyond {
                n_beyond += 1;
                matches!(answer.status, 400 | 422) && is_about(&answer, &pointer, &[])
            } else {
                n_at += 1;
                !is_about(&answer, &pointer, &OUT_OF_BOUNDS)
            };
            if !is_right {
                let side = if is_beyond { "beyond" } else { "at" };
                let excerpt: String = answer.text().chars().take(300).collect();
                faults.push(format!(
                    "{method} {template} {pointer}: {side} {of}: {} {excerpt}",
                    answer.status
                ));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(
        n_beyond > 150 && n_at > 120,
        "{n_beyond} beyond and {n_at} at a bound"
    );
}

/// Every field of a request schema without the bounds that its type can have.
fn unbounded(
    contract: &Value,
    schema: &Value,
    name: &str,
    found: &mut BTreeSet<String>,
    seen: &mut BTreeSet<String>,
) {
    for schema in resolved(contract, schema) {
        let has = |keys: &[&str]| keys.iter().any(|key| !schema[*key].is_null());
        let is_bounded = if is(schema, "array") {
            has(&["maxItems"])
        } else if is(schema, "string") {
            has(&["maxLength", "enum"])
        } else if is(schema, "number") || is(schema, "integer") {
            has(&["minimum", "exclusiveMinimum"]) && has(&["maximum", "exclusiveMaximum"])
        } else {
            true
        };
        if !is_bounded {
            found.insert(name.to_owned());
        }
        if is(schema, "array") {
            unbounded(contract, &schema["items"], name, found, seen);
        }
        for (field, of) in schema["properties"].as_object().unwrap_or(&Map::new()) {
            let named = of["$ref"].as_str().into_iter().chain(
                of["oneOf"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .filter_map(|variant| variant["$ref"].as_str()),
            );
            let inner = named.last().or(of["items"]["$ref"].as_str());
            let inner = inner.and_then(|path| path.rsplit('/').next());
            match inner {
                Some(inner) if seen.insert(inner.to_owned()) => {
                    unbounded(contract, of, inner, found, seen)
                }
                Some(_) => {}
                None => unbounded(
                    contract,
                    of,
                    &format!("{}.{field}", name.split('.').next().unwrap()),
                    found,
                    seen,
                ),
            }
        }
    }
}

#[test]
fn every_list_text_and_number_of_a_request_has_its_bounds_in_the_contract() {
    let contract = contract();
    let (mut found, mut seen, mut n) = (BTreeSet::new(), BTreeSet::new(), 0);
    for (_, item) in contract["paths"].as_object().unwrap() {
        for (_, operation) in item.as_object().unwrap() {
            let schema = &operation["requestBody"]["content"]["application/json"]["schema"];
            if let Some(path) = schema["$ref"].as_str() {
                n += 1;
                let name = path.rsplit('/').next().unwrap();
                unbounded(&contract, schema, name, &mut found, &mut seen);
            }
        }
    }
    assert!(n >= 9, "{n} request bodies");
    let found: Vec<&str> = found.iter().map(String::as_str).collect();
    assert_eq!(found, UNBOUNDED);
}
