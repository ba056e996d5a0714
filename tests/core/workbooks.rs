//! Workbooks as spreadsheets write them, as small as they can be.

use std::io::Write;
use zip::write::SimpleFileOptions;

pub fn zip(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer
            .start_file(*name, SimpleFileOptions::default())
            .unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

type Sheet<'a> = (&'a str, &'a [Vec<String>]);

pub fn xlsx(sheets: &[Sheet]) -> Vec<u8> {
    xlsx_with_hidden(sheets, "", &[])
}

/// As [`xlsx`], with one sheet and some rows hidden. Rows are counted from 1.
pub fn xlsx_with_hidden(sheets: &[Sheet], hidden: &str, hidden_rows: &[usize]) -> Vec<u8> {
    const MAIN: &str = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    const DOCUMENT: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006";
    let numbered = || sheets.iter().enumerate().map(|(i, sheet)| (i + 1, sheet));
    let list: String = numbered()
        .map(|(i, (name, _))| {
            let state = if *name == hidden { "hidden" } else { "visible" };
            format!("<sheet name=\"{name}\" sheetId=\"{i}\" state=\"{state}\" r:id=\"rId{i}\"/>")
        })
        .collect();
    let relations: String = numbered()
        .map(|(i, _)| {
            format!("<Relationship Id=\"rId{i}\" Type=\"{DOCUMENT}/worksheet\" Target=\"worksheets/sheet{i}.xml\"/>")
        })
        .collect();
    let mut files = vec![
        (
            "[Content_Types].xml".to_owned(),
            format!(
                "<Types xmlns=\"{PACKAGE}/content-types\"><Default Extension=\"xml\" ContentType=\"application/xml\"/></Types>"
            ),
        ),
        (
            "_rels/.rels".to_owned(),
            format!(
                "<Relationships xmlns=\"{PACKAGE}/relationships\"><Relationship Id=\"rId1\" Type=\"{DOCUMENT}/officeDocument\" Target=\"xl/workbook.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/workbook.xml".to_owned(),
            format!(
                "<workbook xmlns=\"{MAIN}\" xmlns:r=\"{DOCUMENT}\"><sheets>{list}</sheets></workbook>"
            ),
        ),
        (
            "xl/_rels/workbook.xml.rels".to_owned(),
            format!("<Relationships xmlns=\"{PACKAGE}/relationships\">{relations}</Relationships>"),
        ),
    ];
    for (i, (_, rows)) in numbered() {
        let rows: String = rows
            .iter()
            .enumerate()
            .map(|(r, row)| xlsx_row(r + 1, row, hidden_rows.contains(&(r + 1))))
            .collect();
        files.push((
            format!("xl/worksheets/sheet{i}.xml"),
            format!("<worksheet xmlns=\"{MAIN}\"><sheetData>{rows}</sheetData></worksheet>"),
        ));
    }
    let files: Vec<(&str, Vec<u8>)> = files
        .iter()
        .map(|(name, text)| (name.as_str(), text.clone().into_bytes()))
        .collect();
    zip(&files)
}

/// A workbook of one sheet, with a style of cells (number 1) that is struck through. `cell` writes the cell of a place such as `B7`.
pub fn xlsx_of_cells(rows: &[Vec<String>], cell: impl Fn(usize, &str, &str) -> String) -> Vec<u8> {
    const MAIN: &str = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    const DOCUMENT: &str = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    const PACKAGE: &str = "http://schemas.openxmlformats.org/package/2006";
    let row = |(at, row): (usize, &Vec<String>)| {
        let cells = row.iter().enumerate().map(|(c, text)| {
            let place = format!("{}{}", char::from(b'A' + c as u8), at + 1);
            cell(at, &place, text)
        });
        format!("<row r=\"{}\">{}</row>", at + 1, cells.collect::<String>())
    };
    let rows: String = rows.iter().enumerate().map(row).collect();
    let relation = |id: usize, what: &str, path: &str| {
        format!("<Relationship Id=\"rId{id}\" Type=\"{DOCUMENT}/{what}\" Target=\"{path}\"/>")
    };
    let relations = |inner: String| {
        format!("<Relationships xmlns=\"{PACKAGE}/relationships\">{inner}</Relationships>")
    };
    let files = [
        (
            "[Content_Types].xml",
            format!(
                "<Types xmlns=\"{PACKAGE}/content-types\"><Default Extension=\"xml\" ContentType=\"application/xml\"/></Types>"
            ),
        ),
        (
            "_rels/.rels",
            relations(relation(1, "officeDocument", "xl/workbook.xml")),
        ),
        (
            "xl/workbook.xml",
            format!(
                "<workbook xmlns=\"{MAIN}\" xmlns:r=\"{DOCUMENT}\"><sheets><sheet name=\"Data\" sheetId=\"1\" r:id=\"rId1\"/></sheets></workbook>"
            ),
        ),
        (
            "xl/_rels/workbook.xml.rels",
            relations(
                relation(1, "worksheet", "worksheets/sheet1.xml")
                    + relation(2, "styles", "styles.xml").as_str(),
            ),
        ),
        (
            "xl/styles.xml",
            format!(
                "<styleSheet xmlns=\"{MAIN}\"><fonts count=\"2\"><font/><font><b/><strike/></font></fonts><fills count=\"1\"><fill/></fills>\
                 <cellStyleXfs count=\"1\"><xf fontId=\"1\"/></cellStyleXfs><cellXfs count=\"2\"><xf fontId=\"0\"/><xf fontId=\"1\"/></cellXfs></styleSheet>"
            ),
        ),
        (
            "xl/worksheets/sheet1.xml",
            format!("<worksheet xmlns=\"{MAIN}\"><sheetData>{rows}</sheetData></worksheet>"),
        ),
    ];
    let files: Vec<(&str, Vec<u8>)> = (files.into_iter())
        .map(|(name, text)| (name, text.into_bytes()))
        .collect();
    zip(&files)
}

fn xlsx_row(number: usize, row: &[String], is_hidden: bool) -> String {
    let cells = row.iter().enumerate().map(|(c, cell)| {
        let place = format!("{}{number}", char::from(b'A' + c as u8));
        match cell.parse::<f64>() {
            Ok(value) => format!("<c r=\"{place}\"><v>{value}</v></c>"),
            Err(_) => format!("<c r=\"{place}\" t=\"inlineStr\"><is><t>{cell}</t></is></c>"),
        }
    });
    let hidden = if is_hidden { " hidden=\"1\"" } else { "" };
    format!(
        "<row r=\"{number}\"{hidden}>{}</row>",
        cells.collect::<String>()
    )
}

pub fn ods(sheets: &[Sheet]) -> Vec<u8> {
    ods_with_hidden(sheets, "", &[])
}

/// As [`ods`], with some rows that are not visible, but `filter` or `collapse`. Rows are counted from 1.
pub fn ods_with_hidden(sheets: &[Sheet], visibility: &str, hidden_rows: &[usize]) -> Vec<u8> {
    let cell = |cell: &String| match cell.parse::<f64>() {
        Ok(value) => format!(
            "<table:table-cell office:value-type=\"float\" office:value=\"{value}\"><text:p>{value:.1}</text:p></table:table-cell>"
        ),
        Err(_) => format!(
            "<table:table-cell office:value-type=\"string\"><text:p>{cell}</text:p></table:table-cell>"
        ),
    };
    let empty = "<table:table-cell table:number-columns-repeated=\"16000\"/>";
    let row = |(at, row): (usize, &Vec<String>)| {
        let visibility = match hidden_rows.contains(&(at + 1)) {
            true => format!(" table:visibility=\"{visibility}\""),
            false => String::new(),
        };
        format!(
            "<table:table-row{visibility}>{}{empty}</table:table-row>",
            row.iter().map(cell).collect::<String>()
        )
    };
    let table = |(name, rows): &Sheet| {
        format!(
            "<table:table table:name=\"{name}\">{}<table:table-row table:number-rows-repeated=\"1048000\">{empty}</table:table-row></table:table>",
            rows.iter().enumerate().map(row).collect::<String>()
        )
    };
    ods_content(&sheets.iter().map(table).collect::<String>())
}

pub fn ods_content(tables: &str) -> Vec<u8> {
    let content = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?><office:document-content xmlns:office=\"o\" xmlns:table=\"t\" xmlns:text=\"x\"><office:body>\
         <office:spreadsheet>{tables}</office:spreadsheet></office:body></office:document-content>"
    );
    let kind = b"application/vnd.oasis.opendocument.spreadsheet".to_vec();
    zip(&[("mimetype", kind), ("content.xml", content.into_bytes())])
}
