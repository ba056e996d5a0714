//! Elements of the XML files of a workbook.

use super::refusal::{Archive, unreadable};
use crate::wire::Invalid;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::io::BufReader;

/// Calls `take` with the start of every element of one file.
pub(super) fn each_element(
    archive: &mut Archive,
    path: &str,
    mut take: impl FnMut(&BytesStart),
) -> Result<(), Invalid> {
    let is_path = |name: &String| name.replace('\\', "/").eq_ignore_ascii_case(path);
    let mut names = archive.file_names().flatten().map(|name| name.into_owned());
    let name = names.find(is_path);
    drop(names);
    let name = name.ok_or_else(|| unreadable(&format!("it has no {path}")))?;
    let file = archive
        .by_name(&name)
        .map_err(|e| unreadable(&e.to_string()))?;
    let mut reader = Reader::from_reader(BufReader::new(file));
    // As in calamine's cell reader, the names of end tags are not checked.
    reader.config_mut().check_end_names = false;
    let mut buffer = Vec::new();
    loop {
        buffer.clear();
        let event = reader.read_event_into(&mut buffer);
        match event.map_err(|e| unreadable(&e.to_string()))? {
            Event::Start(start) | Event::Empty(start) => take(&start),
            Event::Eof => return Ok(()),
            _ => {}
        }
    }
}

/// The value of an attribute. `name` has its prefix, if the attribute has one.
pub(super) fn attribute(start: &BytesStart, name: &str) -> Option<String> {
    let found = start.try_get_attribute(name).ok()??;
    let value = found
        .normalized_value(quick_xml::XmlVersion::Implicit1_0)
        .ok()?;
    Some(value.into_owned())
}
