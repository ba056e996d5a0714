//! Parses JSON request bodies. Errors have a JSON pointer.

use crate::wire::Invalid;
use serde::de::{
    Deserialize, DeserializeOwned, Deserializer, Error as _, IgnoredAny, SeqAccess, Visitor,
};
use serde_path_to_error::{Path, Segment};
use std::fmt;
use std::marker::PhantomData;

/// Why a body could not be parsed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The body is not JSON (HTTP status 400).
    #[error("the body is not JSON: {0}")]
    Syntax(String),
    /// The body is JSON with another structure (HTTP status 422).
    #[error(transparent)]
    Shape(#[from] Invalid),
}

/// Parses a body. Unknown fields, missing fields and wrong types are reported with a JSON pointer.
///
/// # Errors
/// [`Error::Syntax`] if the body is not JSON, [`Error::Shape`] if it is JSON with another structure.
pub fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Error> {
    // A list is refused here, because serde would accept it as the values of the fields in order.
    if bytes.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[') {
        return Err(Invalid::at(
            "",
            "invalid_body",
            "the body is a list; it has to be an object with named fields",
        )
        .into());
    }
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let pointer = pointer(error.path());
        explain(pointer, error.inner(), bytes)
    })?;
    reader
        .end()
        .map_err(|error| Error::Syntax(error.to_string()))?;
    Ok(value)
}

/// Parses a list of at most `MAX` items. Parsing stops at the first item beyond `MAX`, so that a longer list does not fill the memory.
///
/// # Errors
/// Errors of the parser, or an error that the list is too long.
pub fn at_most<'de, D: Deserializer<'de>, T: Deserialize<'de>, const MAX: usize>(
    reader: D,
) -> Result<Vec<T>, D::Error> {
    reader.deserialize_seq(List::<T, MAX>(PhantomData))
}

struct List<T, const MAX: usize>(PhantomData<T>);

impl<'de, T: Deserialize<'de>, const MAX: usize> Visitor<'de> for List<T, MAX> {
    type Value = Vec<T>;

    fn expecting(&self, out: &mut fmt::Formatter) -> fmt::Result {
        write!(out, "a list of at most {MAX} items")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Vec<T>, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element()? {
            if list.len() == MAX {
                return Err(A::Error::custom(format!("there are more than {MAX} items")));
            }
            list.push(item);
        }
        Ok(list)
    }
}

fn explain(pointer: String, error: &serde_json::Error, bytes: &[u8]) -> Error {
    use serde_json::error::Category;
    let text = error.to_string();
    let refused = |code, detail: String| Error::Shape(Invalid::at(&pointer, code, detail));
    if text.starts_with("number out of range") {
        let detail = format!("{text}: numbers must fit a 64-bit float");
        return refused("out_of_range", detail);
    }
    // serde_json reports null as a syntax error if an enum is expected. So null is detected at the position of the error.
    let line = bytes
        .split(|byte| *byte == b'\n')
        .nth(error.line().saturating_sub(1))
        .unwrap_or_default();
    let is_null = line
        .get(error.column().saturating_sub(1)..)
        .is_some_and(|rest| rest.starts_with(b"null"));
    match error.classify() {
        Category::Syntax if is_null => {
            let detail =
                format!("this field does not take null; leave it out if it has a default ({text})");
            refused("invalid_body", detail)
        }
        // serde_json also reports a fixed-size list with too many items as a syntax error.
        Category::Syntax if text.starts_with("trailing characters") && is_json(bytes) => refused(
            "invalid_body",
            format!("this list has too many items ({text})"),
        ),
        Category::Data => refused("invalid_body", text),
        Category::Syntax | Category::Eof | Category::Io => Error::Syntax(text),
    }
}

fn is_json(bytes: &[u8]) -> bool {
    serde_json::from_slice::<IgnoredAny>(bytes).is_ok()
}

/// JSON pointer of a path (RFC 6901): `~` and `/` inside a key are escaped.
fn pointer(path: &Path) -> String {
    let mut pointer = String::new();
    for segment in path.iter() {
        match segment {
            Segment::Seq { index } => pointer.push_str(&format!("/{index}")),
            Segment::Map { key } => {
                pointer.push_str(&format!("/{}", key.replace('~', "~0").replace('/', "~1")))
            }
            Segment::Enum { .. } | Segment::Unknown => {}
        }
    }
    pointer
}

#[cfg(test)]
mod tests {
    use super::{Error, parse};
    use crate::wire::robot::RobotBody;

    fn issue_of(body: &str) -> (Option<String>, String) {
        match parse::<RobotBody>(body.as_bytes()) {
            Err(Error::Shape(invalid)) => (
                invalid.issues[0].pointer.clone(),
                invalid.issues[0].code.clone(),
            ),
            other => panic!("expected a shape error, got {other:?}"),
        }
    }

    #[test]
    fn a_number_that_would_become_infinite_is_refused_where_it_stands() {
        let body = r#"{"name": "x", "links": [{"a_mm": 1e400, "alpha_deg": 0, "d_mm": 0, "theta_offset_deg": 0}]}"#;
        assert_eq!(
            issue_of(body),
            (Some("/links/0/a_mm".into()), "out_of_range".into())
        );
    }

    #[test]
    fn null_in_place_of_a_word_is_no_fault_of_syntax() {
        match parse::<crate::wire::job::JobRequestBody>(
            br#"{"measurement_set_id": "set_1", "method": null}"#,
        ) {
            Err(Error::Shape(invalid)) => {
                assert_eq!(invalid.issues[0].pointer.as_deref(), Some("/method"))
            }
            other => panic!("expected a shape error, got {other:?}"),
        }
        assert!(matches!(
            parse::<RobotBody>(br#"{"name": "\ud800", "links": []}"#),
            Err(Error::Syntax(_))
        ));
    }

    #[test]
    fn a_list_with_too_many_items_is_no_fault_of_syntax() {
        let link = r#"{"a_mm": 1, "alpha_deg": 0, "d_mm": 0, "theta_offset_deg": 0, "joint_limits_deg": [1, 2, 3]}"#;
        let body = format!(r#"{{"name": "x", "links": [{link}]}}"#);
        assert_eq!(
            issue_of(&body),
            (
                Some("/links/0/joint_limits_deg".into()),
                "invalid_body".into()
            )
        );
        let cut_off = &body[..body.len() - 1];
        assert!(matches!(
            parse::<RobotBody>(cut_off.as_bytes()),
            Err(Error::Syntax(_))
        ));
    }

    #[test]
    fn an_unknown_field_is_refused_where_it_stands() {
        let body = r#"{"name": "x", "links": [{"a_mm": 1, "alpha_rad": 0, "d_mm": 0, "theta_offset_deg": 0}]}"#;
        assert_eq!(
            issue_of(body),
            (Some("/links/0/alpha_rad".into()), "invalid_body".into())
        );
    }

    #[test]
    fn a_list_in_place_of_an_object_is_said_to_be_one() {
        #[derive(Debug, Default, serde::Deserialize)]
        #[serde(default)]
        struct Policy {
            _tolerance_mm: Option<f64>,
        }
        for list in ["[]", " [0.3]", "[[1, 2]]"] {
            let refused = parse::<Policy>(list.as_bytes()).unwrap_err();
            assert!(
                matches!(&refused, Error::Shape(invalid) if invalid.code == "invalid_body"),
                "{refused:?}"
            );
        }
    }

    #[test]
    fn text_after_the_document_and_deep_nesting_are_syntax_errors() {
        assert!(matches!(
            parse::<serde_json::Value>(b"{\"a\": 1} {}"),
            Err(Error::Syntax(_))
        ));
        let deep = format!("{{\"a\": {}", "[".repeat(1_000_000));
        assert!(matches!(
            parse::<serde_json::Value>(deep.as_bytes()),
            Err(Error::Syntax(_))
        ));
        let deep = format!("{deep}1{}}}", "]".repeat(1_000_000));
        assert!(matches!(
            parse::<serde_json::Value>(deep.as_bytes()),
            Err(Error::Syntax(_))
        ));
        assert!(matches!(
            parse::<serde_json::Value>(b"{\"a\": NaN}"),
            Err(Error::Syntax(_))
        ));
    }
}
