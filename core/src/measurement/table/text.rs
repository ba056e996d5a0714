//! Decodes the bytes of a table: UTF-8, UTF-16 or Windows-1252 (which contains Latin-1). All other files are refused.

use crate::measurement::issue::{ParseError, whole};
use crate::measurement::programs::{self, ProgramRows};
use std::borrow::Cow;

/// Encoding of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// UTF-8, with or without a byte order mark.
    Utf8,
    /// UTF-16, little-endian.
    Utf16Le,
    /// UTF-16, big-endian.
    Utf16Be,
    /// Windows-1252, which contains Latin-1.
    Windows1252,
    /// A sheet of an xlsx workbook.
    Xlsx,
    /// A sheet of an ods workbook.
    Ods,
    /// Points of a robot's program: KUKA, ABB, FANUC or Universal Robots.
    Program,
}

impl Encoding {
    /// Its name in answers.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Utf8 => "utf-8",
            Self::Utf16Le => "utf-16le",
            Self::Utf16Be => "utf-16be",
            Self::Windows1252 => "windows-1252",
            Self::Xlsx => "xlsx",
            Self::Ods => "ods",
            Self::Program => "robot program",
        }
    }
}

/// A table as text.
#[derive(Clone, Debug)]
pub struct Source<'a> {
    /// The text, without a byte order mark.
    pub text: Cow<'a, str>,
    /// The encoding of the file.
    pub encoding: Encoding,
    /// For a robot program: the lines of its points, and the points that are not read.
    pub program: Option<ProgramRows>,
}

impl<'a> Source<'a> {
    /// Decodes a text file, and converts a robot program to a table.
    ///
    /// # Errors
    /// [`ParseError`] if the file is not text, or a program without joint values.
    pub fn from_bytes(bytes: &'a [u8]) -> Result<Self, ParseError> {
        let source = Self::decode(bytes)?;
        Ok(match programs::table(&source.text)? {
            Some((text, rows)) => Self {
                program: Some(rows),
                ..Self::from_sheet(text, Encoding::Program)
            },
            None => source,
        })
    }

    /// Decodes a text file.
    ///
    /// # Errors
    /// [`ParseError`] if the file is not text.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, ParseError> {
        if bytes.starts_with(b"PK\x03\x04") {
            return Err(whole(
                "not_csv",
                "this is a zip file, and no workbook".into(),
            ));
        }
        let source = decoded(bytes)?;
        if source.text.trim().is_empty() {
            return Err(whole("empty", "the file is empty".into()));
        }
        if is_page(&source.text) {
            let detail = "the file is a web page (HTML) or XML with a table in it, often under the name of a spreadsheet: open it in a spreadsheet program, and save it as xlsx or \
                          CSV (UTF-8)";
            return Err(whole("not_csv", detail.into()));
        }
        Ok(source)
    }

    /// A source from the text of a sheet: one line per row, with tabs between the cells.
    pub fn from_sheet(text: String, encoding: Encoding) -> Self {
        Self {
            text: text.into(),
            encoding,
            program: None,
        }
    }
}

/// Whether a text is HTML, or a spreadsheet in XML.
fn is_page(text: &str) -> bool {
    let begin: String = text.trim_start().chars().take(200).collect();
    let begin = begin.to_lowercase();
    let tags = ["<!doctype html", "<html", "<table", "<?xml", "<workbook"];
    tags.iter().any(|tag| begin.starts_with(tag))
}

fn decoded(bytes: &[u8]) -> Result<Source<'_>, ParseError> {
    match bytes {
        [0xFF, 0xFE, rest @ ..] => return utf16(rest, Encoding::Utf16Le),
        [0xFE, 0xFF, rest @ ..] => return utf16(rest, Encoding::Utf16Be),
        _ => {}
    }
    if let Some(encoding) = utf16_without_mark(bytes) {
        return utf16(bytes, encoding);
    }
    let plain = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let (text, encoding) = match std::str::from_utf8(plain) {
        Ok(text) => (
            Cow::Borrowed(text.trim_start_matches('\u{feff}')),
            Encoding::Utf8,
        ),
        Err(_) => (Cow::Owned(windows_1252(plain)?), Encoding::Windows1252),
    };
    if let Some(at) = text.bytes().position(is_control) {
        let detail = format!(
            "character {at} is a control character, so this is no table: save it as CSV (UTF-8), xlsx or ods"
        );
        return Err(whole("not_text", detail));
    }
    Ok(Source {
        text,
        encoding,
        program: None,
    })
}

fn is_control(byte: u8) -> bool {
    matches!(byte, 0..=8 | 11 | 12 | 14..=31 | 127)
}

/// Detects UTF-16 without a byte order mark: in mostly ASCII text, every other byte is zero.
fn utf16_without_mark(bytes: &[u8]) -> Option<Encoding> {
    let sample = &bytes[..bytes.len().min(400) / 2 * 2];
    let zeros = |odd: usize| {
        let at = sample.iter().skip(odd).step_by(2);
        at.filter(|byte| **byte == 0).count()
    };
    let most = sample.len() / 2 * 9 / 10;
    if sample.len() < 4 {
        return None;
    }
    match (zeros(0), zeros(1)) {
        (0, high) if high > most => Some(Encoding::Utf16Le),
        (high, 0) if high > most => Some(Encoding::Utf16Be),
        _ => None,
    }
}

fn utf16(bytes: &[u8], encoding: Encoding) -> Result<Source<'_>, ParseError> {
    let unit = |pair: &[u8]| match encoding {
        Encoding::Utf16Be => u16::from_be_bytes([pair[0], pair[1]]),
        _ => u16::from_le_bytes([pair[0], pair[1]]),
    };
    let units = bytes.chunks_exact(2).map(unit);
    let text: Result<String, _> = char::decode_utf16(units).collect();
    match text {
        Ok(text) if bytes.len().is_multiple_of(2) => Ok(Source {
            text: Cow::Owned(text),
            encoding,
            program: None,
        }),
        _ => Err(whole(
            "not_text",
            "the file begins as UTF-16 and is none: was it cut off? Save it as CSV (UTF-8)".into(),
        )),
    }
}

/// Encodes a text as the bytes of a file. `has_mark` states whether the file begins with a byte order mark. Workbooks and programs are
/// written as UTF-8.
pub fn encoded(text: &str, encoding: Encoding, has_mark: bool) -> Vec<u8> {
    let marked: String = has_mark.then_some('\u{feff}').into_iter().collect();
    let units = || marked.encode_utf16().chain(text.encode_utf16());
    let byte = |c: char| match HIGH.iter().position(|high| *high == c) {
        Some(at) => 0x80 + at as u8,
        None => u8::try_from(c).unwrap_or(b'?'),
    };
    match encoding {
        Encoding::Utf16Le => units().flat_map(u16::to_le_bytes).collect(),
        Encoding::Utf16Be => units().flat_map(u16::to_be_bytes).collect(),
        Encoding::Windows1252 => text.chars().map(byte).collect(),
        _ => [marked.as_bytes(), text.as_bytes()].concat(),
    }
}

/// Whether a file begins with a byte order mark.
pub fn has_mark(bytes: &[u8]) -> bool {
    [&b"\xEF\xBB\xBF"[..], b"\xFF\xFE", b"\xFE\xFF"]
        .iter()
        .any(|mark| bytes.starts_with(mark))
}

/// Characters 0x80 to 0x9F of Windows-1252. Five of these codes are not assigned (`\0`).
const HIGH: [char; 32] = [
    '€', '\0', '‚', 'ƒ', '„', '…', '†', '‡', 'ˆ', '‰', 'Š', '‹', 'Œ', '\0', 'Ž', '\0', '\0', '‘',
    '’', '“', '”', '•', '–', '—', '˜', '™', 'š', '›', 'œ', '\0', 'ž', 'Ÿ',
];

fn windows_1252(bytes: &[u8]) -> Result<String, ParseError> {
    let mut text = String::with_capacity(bytes.len() + bytes.len() / 8);
    for (at, &byte) in bytes.iter().enumerate() {
        let character = match byte {
            0x80..=0x9F => HIGH[usize::from(byte - 0x80)],
            byte => char::from(byte),
        };
        if character == '\0' && byte != 0 {
            let detail = format!(
                "byte {at} is neither UTF-8 nor Windows-1252 text; save the file as CSV (UTF-8)"
            );
            return Err(whole("not_text", detail));
        }
        text.push(character);
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::{Source, encoded, has_mark};

    #[test]
    fn a_text_is_written_in_the_encoding_in_which_it_was_read() {
        let utf16: Vec<u8> = "\u{feff}a °\n"
            .encode_utf16()
            .flat_map(u16::to_le_bytes)
            .collect();
        for bytes in [
            "\u{feff}a °\r\n".as_bytes(),
            "a °\n".as_bytes(),
            b"a \xB0 \x80\n",
            &utf16,
        ] {
            let source = Source::decode(bytes).unwrap();
            assert!(source.text.starts_with("a °"), "{:?}", source.text);
            let again = encoded(&source.text, source.encoding, has_mark(bytes));
            assert_eq!(again, bytes);
        }
    }
}
