//! Finds codes of warnings and gates in source text, and the codes that have a text in `web/words.js`.

const WORDS: &str = include_str!("../../web/words.js");

/// The codes with a text in a table of `web/words.js`.
pub fn worded(table: &str) -> Vec<&'static str> {
    texts(table).into_iter().map(|(code, _)| code).collect()
}

/// The codes of a table of `web/words.js` with their texts.
pub fn texts(table: &str) -> Vec<(&'static str, &'static str)> {
    let (_, rest) = WORDS
        .split_once(&format!("export const {table} = {{\n"))
        .unwrap_or_else(|| panic!("no table {table}"));
    let (body, _) = rest.split_once("\n};").unwrap();
    body.lines()
        .map(|line| {
            let (code, text) = line
                .trim()
                .split_once(": \"")
                .unwrap_or_else(|| panic!("not a code with its words: {line}"));
            (code, text.trim_end_matches("\","))
        })
        .collect()
}

/// Codes of the warnings in a source file: `code: "…"`, `Warning::new("…"`, `warning("…"`, `const NAME: &str = "…"`, and tables of `("…", "words")`, in files about
/// warnings or suspicions.
pub fn warnings(text: &str) -> Vec<&str> {
    if !["Warning", "warning("]
        .iter()
        .any(|word| text.contains(word))
    {
        return vec![];
    }
    literals(text)
        .filter(|(before, _, after)| is_code(before) || is_chosen(before, after))
        .map(|(_, code, _)| code)
        .collect()
}

fn is_code(before: &str) -> bool {
    ["code:", "Warning::new(", "warning(", ": &str ="]
        .iter()
        .any(|opens| before.ends_with(opens))
}

fn is_chosen(before: &str, after: &str) -> bool {
    let opens = before
        .strip_suffix('(')
        .is_some_and(|rest| !rest.ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == '!'));
    let next = after.strip_prefix(',').unwrap_or_default().trim_start();
    opens && (next.starts_with('"') || next.starts_with("format!"))
}

/// Names of the gates in a source file: `Gate::new("…"` and, in files that create gates, `let name = "…"`.
pub fn gates(text: &str) -> Vec<&str> {
    if !text.contains("Gate::new(") {
        return vec![];
    }
    literals(text)
        .filter(|(before, ..)| before.ends_with("Gate::new(") || before.ends_with("let name ="))
        .map(|(_, code, _)| code)
        .collect()
}

/// Literals that look like codes, with the text before and after them.
fn literals(text: &str) -> impl Iterator<Item = (&str, &str, &str)> {
    let quotes: Vec<usize> = text.match_indices('"').map(|(at, _)| at).collect();
    let pairs: Vec<(usize, usize)> = quotes.windows(2).map(|pair| (pair[0], pair[1])).collect();
    pairs.into_iter().filter_map(move |(from, to)| {
        let literal = &text[from + 1..to];
        let plain = literal.starts_with(|c: char| c.is_ascii_lowercase())
            && literal
                .chars()
                .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
        plain.then(|| {
            (
                text[..from].trim_end(),
                literal,
                text[to + 1..].trim_start(),
            )
        })
    })
}
