//! Text of robot programs: code without comments, lists in brackets, words and numbers.

use std::ops::Range;

/// Maximum depth of a list: an array of targets, each of which is a list of lists of numbers, has three.
const MAX_DEPTH: usize = 6;

/// The code of a program. Comments and quoted texts are replaced by spaces, so that all bytes stay at their places. `comment` begins a
/// comment.
pub(super) fn code(text: &str, comment: char, quotes: &[char]) -> String {
    #[derive(Clone, Copy, PartialEq)]
    enum In {
        Code,
        Comment,
        Quotes(char),
    }
    let mut code = String::with_capacity(text.len());
    let mut before = In::Code;
    for c in text.chars() {
        let after = match (before, c) {
            // Comments and texts end with the line.
            (_, '\n' | '\r') => In::Code,
            (In::Code, c) if c == comment => In::Comment,
            (In::Code, c) if quotes.contains(&c) => In::Quotes(c),
            (In::Quotes(quote), c) if c == quote => In::Code,
            (other, _) => other,
        };
        match matches!(c, '\n' | '\r') || (before, after) == (In::Code, In::Code) {
            true => code.push(c),
            false => code.extend(std::iter::repeat_n(' ', c.len_utf8())),
        }
        before = after;
    }
    code
}

/// A part of a list in brackets.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Node {
    List(Vec<Node>),
    Item(Range<usize>),
}

impl Node {
    pub(super) fn list(&self) -> &[Node] {
        match self {
            Self::List(nodes) => nodes,
            Self::Item(_) => &[],
        }
    }

    /// The places of its items, if it is a list without nested lists.
    pub(super) fn items(&self) -> Option<Vec<Range<usize>>> {
        let item = |node: &Node| match node {
            Self::Item(at) => Some(at.clone()),
            Self::List(_) => None,
        };
        match self {
            Self::List(nodes) => nodes.iter().map(item).collect(),
            Self::Item(_) => None,
        }
    }
}

/// The list that begins with the bracket at `open`, and the place after it. None if the list is not closed.
pub(super) fn list(code: &str, open: usize) -> Option<(Node, usize)> {
    list_within(code, open, 1)
}

fn list_within(code: &str, open: usize, depth: usize) -> Option<(Node, usize)> {
    let mut nodes = Vec::new();
    let mut from = open + 1;
    let mut at = from;
    let mut is_list = false;
    loop {
        match code.as_bytes().get(at)? {
            b'[' if depth < MAX_DEPTH => {
                let (node, end) = list_within(code, at, depth + 1)?;
                nodes.push(node);
                is_list = true;
                at = end;
                continue;
            }
            b'[' => return None,
            mark @ (b',' | b']') => {
                if !is_list {
                    nodes.push(Node::Item(trimmed(code, from..at)));
                }
                if *mark == b']' {
                    return Some((Node::List(nodes), at + 1));
                }
                is_list = false;
                from = at + 1;
            }
            _ => {}
        }
        at += 1;
    }
}

/// The range without leading and trailing spaces.
pub(super) fn trimmed(text: &str, range: Range<usize>) -> Range<usize> {
    let part = &text[range.clone()];
    let start = range.start + (part.len() - part.trim_start().len());
    start..start + part.trim().len()
}

pub(super) fn is_word(c: char) -> bool {
    c.is_alphanumeric() || matches!(c, '_' | '$')
}

pub(super) fn last_word(text: &str) -> &str {
    let text = text.trim_end();
    &text[text.trim_end_matches(is_word).len()..]
}

/// Whether a text is a number as programs write it.
pub(super) fn is_number(text: &str) -> bool {
    let is_plain = |byte: u8| byte.is_ascii_digit() || b"+-.eE".contains(&byte);
    text.bytes().all(is_plain) && text.parse::<f64>().is_ok_and(f64::is_finite)
}

#[cfg(test)]
mod tests {
    use super::{Node, code, list};

    #[test]
    fn comments_and_texts_become_spaces_and_lines_stay() {
        let text = "a \"! é\" ! b\nc";
        let found = code(text, '!', &['"']);
        assert_eq!(found, format!("a{}\nc", " ".repeat(text.len() - 3)));
        assert_eq!(code("a \"b\nc ! d", '!', &['"']), "a   \nc    ");
    }

    #[test]
    fn lists_keep_the_places_of_their_items() {
        let text = "[ [1, 2.5],[] ,x]";
        let (found, end) = list(text, 0).unwrap();
        assert_eq!(end, text.len());
        let items = found.list()[0].items().unwrap();
        assert_eq!(&text[items[1].clone()], "2.5");
        assert_eq!(found.list()[2], Node::Item(15..16));
        assert!(list("[1,[2]", 0).is_none() && list("[[[[[[[[1]]]]]]]]", 0).is_none());
    }
}
