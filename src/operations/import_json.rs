//! Tables of link parameters in JSON: a list of objects whose fields are the columns of the CSV table.

use crate::kinematics::model::MAX_LINKS;
use crate::wire::issue::{Invalid, Issue};
use serde_json::{Map, Value};

/// Maximum number of fields of a row. A table has seven quantities and the number of the link.
const MAX_FIELDS: usize = 16;

/// Whether the bytes are JSON and not CSV.
pub fn is_json(bytes: &[u8]) -> bool {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    matches!(bytes.trim_ascii_start().first(), Some(b'[' | b'{'))
}

/// Converts a table in JSON to CSV. The rows are the list itself, or the list `rows` or `links` of an object.
pub fn csv_of_json(bytes: &[u8]) -> Result<Vec<u8>, Invalid> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let document: Value = serde_json::from_slice(bytes).map_err(|error| {
        Invalid::at(
            "",
            "unreadable_table",
            format!("the table is not JSON: {error}"),
        )
    })?;
    let (at, rows) = match &document {
        Value::Object(object) => match (object.get("rows"), object.get("links")) {
            (Some(rows), _) => ("/rows", rows),
            (None, Some(rows)) => ("/links", rows),
            (None, None) => ("", &document),
        },
        _ => ("", &document),
    };
    let all = rows.as_array().map(Vec::as_slice).unwrap_or_default();
    let rows: Vec<&Map<String, Value>> = all.iter().filter_map(Value::as_object).collect();
    if rows.is_empty() || rows.len() != all.len() || rows.len() > MAX_LINKS {
        let detail = format!(
            "a table is a list of 1 to {MAX_LINKS} objects, one per link, or {{\"rows\": [...]}}"
        );
        return Err(Invalid::at(at, "invalid_table", detail));
    }
    let mut names: Vec<&String> = Vec::new();
    for name in rows.iter().flat_map(|row| row.keys()) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let is_plain = |name: &&String| !name.contains([',', '"', '\n', '\r', ';', '\t']);
    if names.len() > MAX_FIELDS || !names.iter().all(is_plain) {
        let detail = "the fields of a row are the columns of a table: a_mm, alpha_deg, d_mm, theta_offset_deg and so on";
        return Err(Invalid::at(at, "unknown_column", detail));
    }
    let (mut lines, mut issues) = (Vec::new(), Vec::new());
    lines.push(
        names
            .iter()
            .map(|name| name.as_str())
            .collect::<Vec<_>>()
            .join(","),
    );
    for (i, row) in rows.iter().enumerate() {
        let cells: Vec<String> = names
            .iter()
            .map(|name| match row.get(*name) {
                None | Some(Value::Null) => String::new(),
                Some(Value::Number(number)) => number.to_string(),
                Some(other) => {
                    let detail = format!("{other} is not a number");
                    let pointer = format!("{at}/{i}/{name}");
                    issues.push(Issue::at(pointer, "not_a_number", detail));
                    String::new()
                }
            })
            .collect();
        lines.push(cells.join(","));
    }
    if issues.is_empty() {
        Ok((lines.join("\n") + "\n").into_bytes())
    } else {
        Err(Invalid {
            code: "invalid_table",
            issues,
        })
    }
}
