//! Rows that are hidden, by a filter or by hand. Nothing tells whether they count, so a sheet with such rows is refused.

use super::refusal::{Archive, refused};
use super::sheet::Sheet;
use super::xml::{attribute, each_element};
use crate::wire::Invalid;
use std::collections::BTreeSet;

/// Maximum number of rows that a refusal lists.
const MAX_LISTED: usize = 10;

/// Refuses a sheet with hidden rows that have cells.
pub(super) fn refuse_hidden_rows(sheet: &Sheet) -> Result<(), Invalid> {
    let n = sheet.hidden_rows.len();
    let Some(first) = sheet.hidden_rows.first() else {
        return Ok(());
    };
    let listed = sheet.hidden_rows.iter().take(MAX_LISTED);
    let listed: Vec<String> = listed.map(|row| (row + 1).to_string()).collect();
    let more = if n > MAX_LISTED { " …" } else { "" };
    let detail = format!(
        "{n} rows of sheet {:?} are hidden, by a filter or by hand: {}{more}. Nothing tells whether they count: show all rows, or delete those that do not count",
        sheet.name,
        listed.join(", ")
    );
    let mut error = refused("hidden_rows", detail);
    error.issues[0].line = Some(first + 1);
    Err(error)
}

/// The hidden rows of a sheet of an xlsx workbook, counted from 0. The reader of its cells does not tell them.
pub(super) fn of_xlsx(archive: &mut Archive, sheet: &str) -> Result<BTreeSet<usize>, Invalid> {
    let mut workbook = "xl/workbook.xml".to_owned();
    each_element(archive, "_rels/.rels", |element| {
        let is_workbook =
            attribute(element, "Type").is_some_and(|t| t.ends_with("/officeDocument"));
        if let Some(target) = attribute(element, "Target").filter(|_| is_workbook) {
            workbook = target.trim_start_matches('/').to_owned();
        }
    })?;
    let (folder, name) = workbook.rsplit_once('/').unwrap_or(("", &workbook));
    let in_folder = |path: &str| match folder {
        "" => path.to_owned(),
        folder => format!("{folder}/{path}"),
    };
    let mut id = None;
    each_element(archive, &workbook, |element| {
        if element.local_name().as_ref() == "sheet"
            && attribute(element, "name").is_some_and(|name| name == sheet)
        {
            let mut attributes = element.attributes().flatten();
            let own = attributes.find(|own| own.key.local_name().as_ref() == "id");
            id = own.map(|own| own.value.into_owned());
        }
    })?;
    let mut path = None;
    each_element(
        archive,
        &in_folder(&format!("_rels/{name}.rels")),
        |element| {
            if attribute(element, "Id").is_some_and(|own| Some(own) == id) {
                path = attribute(element, "Target");
            }
        },
    )?;
    let path = path.unwrap_or_default();
    let path = match path.strip_prefix('/') {
        Some(path) => path.to_owned(),
        None => in_folder(&path),
    };
    let (mut hidden, mut next) = (BTreeSet::new(), 0);
    each_element(archive, &path, |element| {
        if element.local_name().as_ref() != "row" {
            return;
        }
        let number = attribute(element, "r").and_then(|number| number.parse::<usize>().ok());
        let row = number
            .and_then(|number| number.checked_sub(1))
            .unwrap_or(next);
        next = row.saturating_add(1);
        if attribute(element, "hidden").is_some_and(|is| matches!(is.as_str(), "1" | "true")) {
            hidden.insert(row);
        }
    })?;
    Ok(hidden)
}
