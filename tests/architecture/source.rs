//! Reads Rust text as far as the architecture rules need it: tokens without comments, literals and test code,
//! and the paths that they spell. It is a scanner, not a compiler: macros are not expanded.

/// The path of a source file below `src` of its package: `core/src/frames/mod.rs` is `frames/mod.rs`.
pub fn within_sources(path: &str) -> &str {
    path.trim_start_matches("core/").trim_start_matches("src/")
}

/// An identifier, `::`, or one character of punctuation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    pub text: String,
    /// 1-based.
    pub line: usize,
}

impl Token {
    fn is_ident(&self) -> bool {
        self.text
            .starts_with(|c: char| c.is_alphabetic() || c == '_')
    }

    /// An identifier that can stand in a path: `use ::std` starts one, `a::std` does not.
    fn is_name(&self) -> bool {
        self.is_ident()
            && ![
                "use", "in", "as", "impl", "for", "dyn", "mut", "return", "match", "if", "else",
            ]
            .contains(&self.text.as_str())
    }
}

/// A path as written (`crate::a::B`, `super::c`, `tokio::spawn`), groups of a `use` spread out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsedPath {
    pub segments: Vec<String>,
    /// Names of the inline `mod x { … }` around it, outermost first.
    pub inline_modules: Vec<String>,
    pub line: usize,
}

/// The tokens of production code: no comments, no literals, nothing under `#[cfg(test)]`.
pub fn production_tokens(text: &str) -> Vec<Token> {
    without_test_items(&tokens(&without_comments_and_literals(text)))
}

/// Same length and lines, with comments and the insides of literals blanked.
fn without_comments_and_literals(text: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    let mut out = String::with_capacity(text.len());
    let mut i = 0;
    while i < chars.len() {
        let end = match chars[i] {
            '/' if chars.get(i + 1) == Some(&'/') => line_end(&chars, i),
            '/' if chars.get(i + 1) == Some(&'*') => block_comment_end(&chars, i),
            '"' => string_end(&chars, i + 1),
            '\'' => char_literal_end(&chars, i),
            'r' | 'b' | 'c' if !after_ident(&chars, i) => prefixed_string_end(&chars, i),
            _ => i,
        };
        if end == i {
            out.push(chars[i]);
            i += 1;
        } else {
            out.extend(
                chars[i..end]
                    .iter()
                    .map(|&c| if c == '\n' { '\n' } else { ' ' }),
            );
            i = end;
        }
    }
    out
}

fn after_ident(chars: &[char], i: usize) -> bool {
    i > 0 && (chars[i - 1].is_alphanumeric() || chars[i - 1] == '_')
}

fn line_end(chars: &[char], from: usize) -> usize {
    (from..chars.len())
        .find(|&i| chars[i] == '\n')
        .unwrap_or(chars.len())
}

fn block_comment_end(chars: &[char], from: usize) -> usize {
    let mut depth = 0;
    let mut i = from;
    while i + 1 < chars.len() {
        match (chars[i], chars[i + 1]) {
            ('/', '*') => (depth, i) = (depth + 1, i + 2),
            ('*', '/') => (depth, i) = (depth - 1, i + 2),
            _ => i += 1,
        }
        if depth == 0 {
            return i;
        }
    }
    chars.len()
}

/// One past the closing quote of a string whose inside starts at `from`.
fn string_end(chars: &[char], from: usize) -> usize {
    let mut i = from;
    while i < chars.len() && chars[i] != '"' {
        i += if chars[i] == '\\' { 2 } else { 1 };
    }
    (i + 1).min(chars.len())
}

/// `'x'` and `'\n'` are literals, `'a` is a lifetime: for the latter `from` itself comes back.
fn char_literal_end(chars: &[char], from: usize) -> usize {
    if chars.get(from + 1) == Some(&'\\') {
        return (from + 3..chars.len())
            .find(|&i| chars[i] == '\'')
            .map_or(chars.len(), |i| i + 1);
    }
    if chars.get(from + 2) == Some(&'\'') {
        from + 3
    } else {
        from
    }
}

/// `r"…"`, `r#"…"#`, `b"…"`, `br#"…"#`, `c"…"`; `from` itself if it is none of them.
fn prefixed_string_end(chars: &[char], from: usize) -> usize {
    let mut i = from;
    while matches!(chars.get(i), Some('r' | 'b' | 'c')) && i < from + 2 {
        i += 1;
    }
    let raw = chars[i - 1] == 'r';
    let hashes = chars[i..].iter().take_while(|&&c| c == '#').count();
    if chars.get(i + hashes) != Some(&'"') || (hashes > 0 && !raw) {
        return from;
    }
    let inside = i + hashes + 1;
    if !raw {
        return string_end(chars, inside);
    }
    let closes = |&at: &usize| {
        chars[at] == '"' && chars[at + 1..].iter().take_while(|&&c| c == '#').count() >= hashes
    };
    (inside..chars.len())
        .find(closes)
        .map_or(chars.len(), |at| at + 1 + hashes)
}

fn tokens(code: &str) -> Vec<Token> {
    let mut out: Vec<Token> = Vec::new();
    for (index, text) in code.lines().enumerate() {
        let line = index + 1;
        let chars: Vec<char> = text.chars().collect();
        let mut i = 0;
        while i < chars.len() {
            let start = i;
            if chars[i].is_alphanumeric() || chars[i] == '_' {
                while i < chars.len() && (chars[i].is_alphanumeric() || chars[i] == '_') {
                    i += 1;
                }
            } else if chars[i] == ':' && chars.get(i + 1) == Some(&':') {
                i += 2;
            } else {
                i += 1;
            }
            if !chars[start].is_whitespace() {
                out.push(Token {
                    text: chars[start..i].iter().collect(),
                    line,
                });
            }
        }
    }
    out
}

/// Drops every item under an attribute `#[cfg(test)]` or `#[cfg(all(test, …))]`.
fn without_test_items(tokens: &[Token]) -> Vec<Token> {
    let mut out = Vec::new();
    let mut i = 0;
    while i < tokens.len() {
        if starts_with(&tokens[i..], &["#", "!", "["]) && is_cfg_test(&tokens[i + 3..]) {
            return out;
        }
        if starts_with(&tokens[i..], &["#", "["]) && is_cfg_test(&tokens[i + 2..]) {
            i = item_end(tokens, group_end(tokens, i + 1));
        } else {
            out.push(tokens[i].clone());
            i += 1;
        }
    }
    out
}

fn is_cfg_test(attribute: &[Token]) -> bool {
    let arguments = || attribute.iter().take_while(|t| t.text != "]");
    starts_with(attribute, &["cfg", "("])
        && arguments().any(|t| t.text == "test")
        && !arguments().any(|t| t.text == "not")
}

/// One past the item that starts at `from`: its block, or its semicolon if that comes first.
fn item_end(tokens: &[Token], from: usize) -> usize {
    let mut i = from;
    while i < tokens.len() {
        match tokens[i].text.as_str() {
            "(" | "[" => i = group_end(tokens, i),
            "{" => return group_end(tokens, i),
            ";" => return i + 1,
            _ => i += 1,
        }
    }
    i
}

/// One past the bracket that closes the one at `open`.
fn group_end(tokens: &[Token], open: usize) -> usize {
    let mut depth = 0;
    for (i, token) in tokens.iter().enumerate().skip(open) {
        match token.text.as_str() {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" | "}" => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return i + 1;
        }
    }
    tokens.len()
}

pub fn starts_with(tokens: &[Token], texts: &[&str]) -> bool {
    tokens.len() >= texts.len()
        && tokens
            .iter()
            .zip(texts)
            .all(|(token, text)| token.text == *text)
}

/// Every path that the tokens spell, also those of a single name after `use` or `extern crate`.
pub fn used_paths(tokens: &[Token]) -> Vec<UsedPath> {
    let mut out = Vec::new();
    let mut inline: Vec<(String, usize)> = Vec::new();
    let mut depth = 0;
    let mut i = 0;
    while i < tokens.len() {
        match tokens[i].text.as_str() {
            "{" => depth += 1,
            "}" => {
                depth -= 1;
                inline.retain(|(_, opened_at)| *opened_at < depth + 1);
            }
            "mod" if tokens.get(i + 2).is_some_and(|t| t.text == "{") => {
                inline.push((tokens[i + 1].text.clone(), depth + 1))
            }
            _ if starts_path(tokens, i) => {
                let inline_modules: Vec<String> =
                    inline.iter().map(|(name, _)| name.clone()).collect();
                let (found, end) = path_tree(tokens, i, &[]);
                out.extend(found.into_iter().map(|(segments, line)| UsedPath {
                    segments,
                    inline_modules: inline_modules.clone(),
                    line,
                }));
                i = end;
                continue;
            }
            _ => {}
        }
        i += 1;
    }
    out
}

fn starts_path(tokens: &[Token], i: usize) -> bool {
    let before = |n: usize| i.checked_sub(n).map(|at| tokens[at].text.as_str());
    let continues =
        before(1) == Some("::") && i >= 2 && (tokens[i - 2].is_name() || tokens[i - 2].text == ">");
    let imported =
        before(1) == Some("use") || (before(1) == Some("crate") && before(2) == Some("extern"));
    let longer = tokens.get(i + 1).is_some_and(|t| t.text == "::");
    tokens[i].is_name() && !continues && (longer || imported)
}

/// Reads `a::b`, `a::{b, c::d}`, `a::*` at `from`, with `prefix` in front: the paths, and one past the last token read.
fn path_tree(
    tokens: &[Token],
    from: usize,
    prefix: &[String],
) -> (Vec<(Vec<String>, usize)>, usize) {
    let mut segments = prefix.to_vec();
    let mut i = from;
    let line = tokens[from].line;
    loop {
        match tokens.get(i).map(|t| t.text.as_str()) {
            Some("{") => return group_of_paths(tokens, i, &segments),
            Some("*") => {
                segments.push("*".into());
                return (vec![(segments, line)], i + 1);
            }
            Some(text) if tokens[i].is_ident() => segments.push(text.into()),
            _ => return (vec![(segments, line)], i),
        }
        i += 1;
        if tokens.get(i).is_none_or(|t| t.text != "::") {
            return (vec![(segments, line)], i);
        }
        i += 1;
    }
}

fn group_of_paths(
    tokens: &[Token],
    open: usize,
    prefix: &[String],
) -> (Vec<(Vec<String>, usize)>, usize) {
    let end = group_end(tokens, open);
    let mut out = Vec::new();
    let mut i = open + 1;
    while i + 1 < end {
        if tokens[i].is_ident() || tokens[i].text == "*" {
            let (found, next) = path_tree(tokens, i, prefix);
            out.extend(found);
            i = next;
            // `as name` renames; the name is not a path of its own
            if tokens.get(i).is_some_and(|t| t.text == "as") {
                i += 2;
            }
        } else {
            i += 1;
        }
    }
    (out, end)
}
