//! Parses a `multipart/form-data` body (RFC 7578). The body is stored as it was received and is parsed again from the stored bytes, so this parser is
//! synchronous and needs no async runtime.

use crate::wire::Invalid;
use utoipa::ToSchema;

/// Maximum number of parts of an upload: two files, a mapping, and one spare part.
const MAX_PARTS: usize = 4;
/// Maximum length of the headers of a part, bytes.
const MAX_HEADERS: usize = 4096;

/// The bytes of a file. This type exists only for the OpenAPI document: without it, generated clients would get a list of numbers.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
pub struct FileBytes(#[expect(dead_code)] Vec<u8>);

/// The parts of an upload form: either `robot` and `instrument`, or `table`; `columns` is optional.
#[derive(ToSchema)]
#[expect(dead_code)]
pub struct UploadForm {
    /// The robot's file, if there are two files.
    #[schema(value_type = Option<String>, format = Binary)]
    robot: Option<Vec<u8>>,
    /// The instrument's file, if there are two files.
    #[schema(value_type = Option<String>, format = Binary)]
    instrument: Option<Vec<u8>>,
    /// The only file.
    #[schema(value_type = Option<String>, format = Binary)]
    table: Option<Vec<u8>>,
    /// The column mapping, in JSON.
    columns: Option<String>,
}

/// One part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part<'a> {
    /// The field's name.
    pub name: String,
    /// The file's name, if it has one.
    pub file_name: Option<String>,
    /// Its content.
    pub body: &'a [u8],
}

/// Whether the content type is `multipart/form-data`.
pub fn is_multipart(content_type: &str) -> bool {
    let media_type = content_type.split(';').next().unwrap_or_default();
    media_type
        .trim()
        .eq_ignore_ascii_case("multipart/form-data")
}

/// The parts of a body.
pub fn parts<'a>(content_type: &str, body: &'a [u8]) -> Result<Vec<Part<'a>>, Invalid> {
    let boundary = parameter(content_type, "boundary")
        .filter(|boundary| (1..=70).contains(&boundary.len()))
        .ok_or_else(|| malformed("the content type has no boundary"))?;
    let delimiter = format!("\r\n--{boundary}");
    // The first delimiter has no line break before it.
    let first = &delimiter.as_bytes()[2..];
    let mut rest = match body.strip_prefix(first) {
        Some(rest) => rest,
        None => {
            let at = find(body, delimiter.as_bytes())
                .ok_or_else(|| malformed("the boundary of the content type is not in the body"))?;
            &body[at + delimiter.len()..]
        }
    };
    let mut found = Vec::new();
    while !rest.starts_with(b"--") {
        if found.len() == MAX_PARTS {
            return Err(malformed(&format!("more than {MAX_PARTS} parts")));
        }
        let line = find(rest, b"\r\n").filter(|at| rest[..*at].iter().all(|b| b" \t".contains(b)));
        let line = line.ok_or_else(|| malformed("a boundary does not end its line"))?;
        rest = &rest[line..];
        let end = find(&rest[..rest.len().min(MAX_HEADERS)], b"\r\n\r\n")
            .ok_or_else(|| malformed("a part has no end of its headers"))?;
        let headers = std::str::from_utf8(&rest[..end])
            .map_err(|_| malformed("the headers of a part are not UTF-8"))?;
        rest = &rest[end + 4..];
        let length = match rest.starts_with(first) {
            true => 0,
            false => find(rest, delimiter.as_bytes())
                .ok_or_else(|| malformed("a part has no end: was the body cut off?"))?,
        };
        let skipped = if rest.starts_with(first) {
            first.len()
        } else {
            delimiter.len()
        };
        found.push(part(headers, &rest[..length])?);
        rest = &rest[length + skipped..];
    }
    Ok(found)
}

fn part<'a>(headers: &str, body: &'a [u8]) -> Result<Part<'a>, Invalid> {
    let disposition = headers.split("\r\n").find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.trim()
            .eq_ignore_ascii_case("content-disposition")
            .then_some(value)
    });
    let disposition = disposition.ok_or_else(|| malformed("a part has no Content-Disposition"))?;
    let name = parameter(disposition, "name").ok_or_else(|| malformed("a part has no name"))?;
    Ok(Part {
        name,
        file_name: parameter(disposition, "filename"),
        body,
    })
}

/// A parameter of a header, with or without quotes.
fn parameter(header: &str, wanted: &str) -> Option<String> {
    let mut rest = header.split_once(';')?.1;
    loop {
        let (name, value) = rest.split_once('=')?;
        let (value, after) = match value.trim_start().strip_prefix('"') {
            Some(quoted) => {
                let (value, after) = quoted.split_once('"')?;
                (value, after.split_once(';').map_or("", |(_, after)| after))
            }
            None => value.split_once(';').unwrap_or((value, "")),
        };
        if name.trim().eq_ignore_ascii_case(wanted) {
            return Some(value.trim().to_owned());
        }
        rest = after;
    }
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    let first = *wanted.first()?;
    let mut from = 0;
    while let Some(at) = bytes.get(from..)?.iter().position(|byte| *byte == first) {
        if bytes[from + at..].starts_with(wanted) {
            return Some(from + at);
        }
        from += at + 1;
    }
    None
}

fn malformed(why: &str) -> Invalid {
    let detail =
        format!("{why}; a form has the parts robot and instrument, or table, and perhaps columns");
    Invalid::at("", "malformed_multipart", detail)
}

#[cfg(test)]
mod tests {
    use super::parts;

    const TYPE: &str = "multipart/form-data; charset=utf-8; boundary=\"x y\"";

    #[test]
    fn parts_are_found_with_their_bytes() {
        let body = b"--x y\r\nContent-Disposition: form-data; name=\"robot\"; filename=\"a;b=1.csv\"\r\nContent-Type: text/csv\r\n\r\n1\r\n--x\r\n\r\n--x y\r\ncontent-disposition: form-data; name=columns\r\n\r\n\r\n--x y--\r\n";
        let found = parts(TYPE, body).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!(
            (found[0].name.as_str(), found[0].body),
            ("robot", &b"1\r\n--x\r\n"[..])
        );
        assert_eq!(found[0].file_name.as_deref(), Some("a;b=1.csv"));
        assert_eq!(
            (found[1].name.as_str(), found[1].body),
            ("columns", &b""[..])
        );
    }

    #[test]
    fn what_is_cut_off_is_refused() {
        let body = b"--x y\r\nContent-Disposition: form-data; name=\"robot\"\r\n\r\nabc\r\n--x y--";
        for end in 0..body.len() {
            let cut = parts(TYPE, &body[..end]);
            assert!(cut.is_err(), "{end}");
        }
        assert!(parts("multipart/form-data", body).is_err());
    }
}
