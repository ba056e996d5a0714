//! Examples in the OpenAPI document: one for each body of each operation. They are generated from the schemas, so a new field needs no change here.
//! The name of a field decides its value.

use crate::http::request_examples::{example_of_operation, example_of_shape};
use serde_json::{Map, Value, json};
use utoipa::openapi::path::Operation;
use utoipa::openapi::{Content, OpenApi, RefOr, Schema};

/// Deepest nesting of an example.
const MAX_DEPTH: usize = 12;

/// Beginning of a shape's name, and the prefix of its ids.
const IDS: [(&str, &str); 6] = [
    ("Robot", "rob_"),
    ("Set", "set_"),
    ("Job", "job_"),
    ("ParameterSet", "par_"),
    ("Network", "net_"),
    ("Frames", "frm_"),
];

/// Example of a text, by the name of its field and of the shape with this field.
fn text(field: &str, shape: &str) -> Value {
    let id = |prefix: &str| Value::from(format!("{prefix}0199b6a4c1d27a10b5e43c7f9d2e6a81"));
    match field {
        "id" => {
            let found = IDS.iter().rev().find(|(start, _)| shape.starts_with(start));
            id(found.map_or("key_", |(_, prefix)| prefix))
        }
        "robot_id" => id("rob_"),
        "measurement_set_id" => id("set_"),
        "frames_id" => id("frm_"),
        "parameter_set_id" | "with" | "parameter_set_from" => id("par_"),
        "job_id" | "check_job_id" => id("job_"),
        "network_id" => id("net_"),
        "by" | "released_by" | "withdrawn_by" => id("key_"),
        "sha256" | "result_sha256" => {
            "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08".into()
        }
        "name" if shape.starts_with("Robot") => "Cell 4".into(),
        "name" if shape.starts_with("Set") => "Monday".into(),
        "name" if shape.starts_with("WorkFrame") => "fixture".into(),
        "name" if shape.starts_with("NamedTool") => "gripper".into(),
        "name" if shape.starts_with("ColumnMapping") => "tracker".into(),
        "name" if shape.starts_with("Reference") => "scale bar 1".into(),
        "name" | "parameter" => "theta_offset_3".into(),
        "unit" => "deg".into(),
        "version" => "0.1.0".into(),
        "reason" => "verified on a second session".into(),
        _ if field.ends_with("_at") || field == "at" => "2026-03-01T08:15:30Z".into(),
        _ => field.into(),
    }
}

/// Schemas of the document by name.
pub struct Examples(Map<String, Value>);

impl Examples {
    /// The examples that follow from a document's schemas.
    pub fn new(document: &OpenApi) -> Self {
        let components = document.components.as_ref();
        let schemas = components.map(|components| serde_json::to_value(&components.schemas));
        match schemas {
            Some(Ok(Value::Object(schemas))) => Self(schemas),
            _ => Self(Map::new()),
        }
    }

    /// Writes an example into every body of an operation.
    pub fn write(&self, operation: &mut Operation) {
        let complete = |media_type: &str, content: &mut RefOr<Content>, own: Option<Value>| {
            let RefOr::T(content) = content else { return };
            if content.example.is_none() {
                let by_schema = || self.example_of_body(media_type, content.schema.as_ref());
                content.example = own.or_else(by_schema);
            }
            // the order of keys must not depend on the features that serde_json was built with
            if let Some(example) = &mut content.example {
                example.sort_all_objects();
            }
        };
        let id = operation.operation_id.clone().unwrap_or_default();
        if let Some(RefOr::T(body)) = &mut operation.request_body {
            for (media_type, content) in &mut body.content {
                complete(media_type, content, example_of_operation(&id, media_type));
            }
        }
        for (status, response) in &mut operation.responses.responses {
            if let (true, RefOr::T(response)) = (status.starts_with('2'), response) {
                for (media_type, content) in &mut response.content {
                    // every JSON answer has a schema, and its example follows from that
                    let own = (media_type != "application/json")
                        .then(|| example_of_operation(&id, media_type))
                        .flatten();
                    complete(media_type, content, own);
                }
            }
        }
    }

    fn example_of_body(&self, media_type: &str, schema: Option<&RefOr<Schema>>) -> Option<Value> {
        Some(match media_type {
            "application/json" => {
                let schema = serde_json::to_value(schema?).ok()?;
                self.example(&schema, "", "", 0)
            }
            "application/yaml" => json!({"openapi": "3.1.0"}),
            "text/html" => "<!doctype html><title>kincal</title>".into(),
            "text/plain" => "ok\n".into(),
            "multipart/form-data" => "--boundary\r\nContent-Disposition: form-data; name=\"robot\"; filename=\"log.csv\"\r\n\r\n".into(),
            _ => return None,
        })
    }

    fn example(&self, schema: &Value, field: &str, shape: &str, depth: usize) -> Value {
        if depth > MAX_DEPTH {
            return Value::Null;
        }
        if let Some(name) = schema["$ref"]
            .as_str()
            .and_then(|path| path.rsplit('/').next())
        {
            let found = self.0.get(name).unwrap_or(&Value::Null);
            return example_of_shape(name)
                .unwrap_or_else(|| self.example(found, field, name, depth + 1));
        }
        for choice in ["oneOf", "anyOf"] {
            if let Some(variants) = schema[choice].as_array() {
                let first = variants.iter().find(|variant| variant["type"] != "null");
                return self.example(first.unwrap_or(&Value::Null), field, shape, depth + 1);
            }
        }
        if let Some(parts) = schema["allOf"].as_array() {
            let mut whole = Map::new();
            for part in parts {
                if let Value::Object(fields) = self.example(part, field, shape, depth + 1) {
                    whole.extend(fields);
                }
            }
            return whole.into();
        }
        if let Some(values) = schema["enum"].as_array() {
            let first = values.iter().find(|value| !value.is_null());
            return first.cloned().unwrap_or_default();
        }
        match (field, kind(&schema["items"])) {
            ("rotation", Some("array")) => {
                return json!([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
            }
            ("quaternion", Some("number")) => return json!([1.0, 0.0, 0.0, 0.0]),
            _ => {}
        }
        match kind(schema) {
            Some("object") => self.object(schema, shape, depth),
            Some("array") => {
                let n = schema["minItems"].as_u64().unwrap_or(1).max(1);
                let one = self.example(&schema["items"], field, shape, depth + 1);
                vec![one; usize::try_from(n).unwrap_or(1)].into()
            }
            Some("integer") => number(schema, 1.0)
                .as_f64()
                .map_or(Value::Null, |n| json!(n as i64)),
            Some("number") => number(schema, 0.5),
            Some("boolean") => true.into(),
            Some("string") => bounded(schema, text(field, shape)),
            _ => json!({}),
        }
    }

    fn object(&self, schema: &Value, shape: &str, depth: usize) -> Value {
        let required: Vec<&str> = schema["required"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
            .collect();
        let fields = schema["properties"].as_object().into_iter().flatten();
        fields
            .filter(|(name, _)| required.contains(&name.as_str()))
            .map(|(name, of_field)| {
                let value = self.example(of_field, name, shape, depth + 1);
                (name.clone(), value)
            })
            .collect::<Map<_, _>>()
            .into()
    }
}

/// The type of a schema, without `null`.
fn kind(schema: &Value) -> Option<&str> {
    match &schema["type"] {
        Value::String(kind) => Some(kind),
        Value::Array(kinds) => kinds
            .iter()
            .filter_map(Value::as_str)
            .find(|k| *k != "null"),
        _ => schema["properties"].is_object().then_some("object"),
    }
}

/// A number near `wanted` within the schema's bounds.
fn number(schema: &Value, wanted: f64) -> Value {
    let bound = |name: &str| schema[name].as_f64();
    if let Some(default) = bound("default") {
        return json!(default);
    }
    let mut value = wanted;
    if let Some(smallest) = bound("minimum") {
        value = value.max(smallest);
    }
    if let Some(largest) = bound("maximum").or(bound("exclusiveMaximum")) {
        value = value.min(largest);
    }
    json!(value)
}

/// A text within the schema's bounds.
fn bounded(schema: &Value, text: Value) -> Value {
    let most = schema["maxLength"].as_u64();
    match (text.as_str(), most) {
        (Some(text), Some(most)) => {
            let most = usize::try_from(most).unwrap_or(usize::MAX);
            text.chars().take(most).collect::<String>().into()
        }
        _ => text,
    }
}

/// A reference to a shape, for tests.
#[cfg(test)]
fn reference(name: &str) -> Value {
    json!({"$ref": format!("#/components/schemas/{name}")})
}

#[cfg(test)]
mod tests {
    use super::{Examples, reference};
    use crate::http::openapi;
    use crate::wire::job::JobRequestBody;
    use crate::wire::robot::{Robot, RobotBody};
    use crate::wire::robot_patch::RobotPatchBody;
    use serde_json::from_value;

    #[test]
    fn the_examples_of_requests_are_requests() {
        let examples = Examples::new(&openapi());
        let of = |name: &str| examples.example(&reference(name), "", "", 0);
        let robot: RobotBody = from_value(of("RobotBody")).unwrap();
        Robot::try_from(&robot).unwrap();
        let job: JobRequestBody = from_value(of("JobRequestBody")).unwrap();
        assert!(job.set_ids()[0].starts_with("set_"));
        let patch: RobotPatchBody = from_value(of("RobotPatchBody")).unwrap();
        assert_ne!(patch, RobotPatchBody::default());
    }

    #[test]
    fn every_operation_with_a_body_has_an_example() {
        let document = serde_json::to_value(openapi()).unwrap();
        for (path, item) in document["paths"].as_object().unwrap() {
            for (method, operation) in item.as_object().unwrap() {
                let bodies = operation["requestBody"]["content"].as_object();
                let answers = operation["responses"].as_object().into_iter().flatten();
                let answers = answers.filter(|(status, _)| status.starts_with('2'));
                let answers = answers.filter_map(|(_, answer)| answer["content"].as_object());
                for (media_type, content) in bodies.into_iter().chain(answers).flatten() {
                    let schema = content["schema"]["$ref"].as_str().unwrap_or_default();
                    let is_binary =
                        media_type == "application/octet-stream" || schema.ends_with("/FileBytes");
                    let is_stream = media_type == "text/event-stream";
                    let is_asset = path == "/assets/{file}";
                    assert!(
                        is_binary || is_stream || is_asset || content.get("example").is_some(),
                        "{method} {path}: {media_type}"
                    );
                }
            }
        }
    }
}
