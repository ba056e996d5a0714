//! Limits on XML, checked in one pass over the text before it is parsed. roxmltree compares each attribute of an element with all others of the
//! element, and searches all declared namespaces for each name. Without limits, parsing a short text can take minutes.

use crate::wire::issue::Invalid;

/// Maximum number of attributes of one element. Elements of a URDF have up to four.
pub const MAX_ATTRIBUTES: usize = 64;
/// Maximum number of attributes of all elements together.
pub const MAX_ALL_ATTRIBUTES: usize = 200_000;
/// Maximum number of namespace declarations of all elements together. A URDF has a few, all at its root.
pub const MAX_NAMESPACES: usize = 64;
/// Maximum depth of nested elements. A URDF has five levels; with the extensions of a simulator it has fifteen.
pub const MAX_DEPTH: usize = 100;
/// Maximum number of elements. Large descriptions have some thousand.
pub const MAX_ELEMENTS: usize = 100_000;

/// Counts of everything that has a limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of elements.
    pub n_elements: usize,
    /// Deepest nesting of elements.
    pub depth: usize,
    /// Largest number of attributes of an element, including namespace declarations.
    pub most_attributes: usize,
    /// Number of attributes of all elements.
    pub n_attributes: usize,
    /// Number of namespace declarations.
    pub n_namespaces: usize,
}

/// Counts elements and attributes. Fails at the first place where a limit is exceeded. The counts are correct up to the first syntax error, which the
/// parser reports later.
///
/// # Errors
/// [`Invalid`] with the line and the limit.
pub fn check(text: &str) -> Result<Counts, Invalid> {
    let mut counts = Counts::default();
    let mut n_open: usize = 0;
    let mut at = 0;
    while let Some(start) = text[at..].find('<').map(|found| at + found) {
        let rest = &text[start..];
        let end = if rest.starts_with("<!--") {
            index_after(rest, "<!--".len(), "-->")
        } else if rest.starts_with("<![CDATA[") {
            index_after(rest, "<![CDATA[".len(), "]]>")
        } else if rest.starts_with("<?") {
            index_after(rest, "<?".len(), "?>")
        } else if rest.starts_with("<!") {
            return Err(too_much(
                text,
                start,
                "not_xml",
                "there is a DTD; a URDF has none".into(),
            ));
        } else if rest.starts_with("</") {
            n_open = n_open.saturating_sub(1);
            index_after(rest, "</".len(), ">")
        } else {
            let tag = start_tag(text, start, &mut counts)?;
            counts.n_elements += 1;
            counts.depth = counts.depth.max(n_open + 1);
            n_open += usize::from(tag.stays_open);
            refuse_too_many(text, start, &counts)?;
            tag.end
        };
        // Without an end the text is not well-formed, which the parser reports.
        let Some(end) = end else { break };
        at = start + end;
    }
    Ok(counts)
}

/// Index after the next `mark` at or after `from`.
fn index_after(text: &str, from: usize, mark: &str) -> Option<usize> {
    Some(from + text[from..].find(mark)? + mark.len())
}

struct StartTag {
    /// Length of the tag, if it has an end.
    end: Option<usize>,
    stays_open: bool,
}

/// Counts the attributes of the tag at `start`: each quoted value is one attribute.
fn start_tag(text: &str, start: usize, counts: &mut Counts) -> Result<StartTag, Invalid> {
    let rest = &text[start..];
    let (mut at, mut n) = (1, 0);
    loop {
        let Some(found) = rest[at..].find(['"', '\'', '>']) else {
            return Ok(StartTag {
                end: None,
                stays_open: true,
            });
        };
        let (before, mark) = (&rest[at..at + found], rest.as_bytes()[at + found]);
        at += found + 1;
        if mark == b'>' {
            let stays_open = !before.ends_with('/');
            return Ok(StartTag {
                end: Some(at),
                stays_open,
            });
        }
        n += 1;
        counts.n_attributes += 1;
        counts.most_attributes = counts.most_attributes.max(n);
        // The text before the quote is the name of an attribute and `=`, for the first attribute after the name of the element.
        let name = before.trim_end().trim_end_matches('=').trim_end();
        let name = name.rsplit(|c: char| c.is_ascii_whitespace()).next();
        // roxmltree treats `x:xmlns` as a declaration too.
        let is_namespace = name.is_some_and(|name| {
            name == "xmlns" || name.starts_with("xmlns:") || name.ends_with(":xmlns")
        });
        counts.n_namespaces += usize::from(is_namespace);
        if n > MAX_ATTRIBUTES {
            let element: String = rest[1..]
                .chars()
                .take_while(|c| !c.is_whitespace() && !matches!(c, '/' | '>'))
                .take(40)
                .collect();
            let detail =
                format!("the element <{element}> has more than {MAX_ATTRIBUTES} attributes");
            return Err(too_much(text, start + at, "too_many_attributes", detail));
        }
        let quote = if mark == b'"' { '"' } else { '\'' };
        match rest[at..].find(quote) {
            Some(found) => at += found + 1,
            None => {
                return Ok(StartTag {
                    end: None,
                    stays_open: true,
                });
            }
        }
    }
}

fn refuse_too_many(text: &str, at: usize, counts: &Counts) -> Result<(), Invalid> {
    let limits = [
        (
            counts.n_elements,
            MAX_ELEMENTS,
            "too_many_elements",
            "elements",
        ),
        (
            counts.n_attributes,
            MAX_ALL_ATTRIBUTES,
            "too_many_attributes",
            "attributes",
        ),
        (
            counts.n_namespaces,
            MAX_NAMESPACES,
            "too_many_namespaces",
            "namespace declarations",
        ),
        (
            counts.depth,
            MAX_DEPTH,
            "too_deep",
            "elements within one another",
        ),
    ];
    match limits.iter().find(|(n, limit, ..)| n > limit) {
        Some((_, limit, code, what)) => Err(too_much(
            text,
            at,
            code,
            format!("there are more than {limit} {what}"),
        )),
        None => Ok(()),
    }
}

fn too_much(text: &str, at: usize, code: &'static str, what: String) -> Invalid {
    let line = 1 + text.as_bytes()[..at]
        .iter()
        .filter(|byte| **byte == b'\n')
        .count();
    Invalid::at("", code, format!("line {line}: {what}"))
}

#[cfg(test)]
mod tests {
    use super::{Counts, MAX_ATTRIBUTES, MAX_DEPTH, MAX_ELEMENTS, MAX_NAMESPACES, check};
    use proptest::prelude::*;
    use roxmltree::{Document, Node};

    fn code_and_detail(text: &str) -> (&'static str, String) {
        let invalid = check(text).expect_err("must be refused");
        (invalid.code, invalid.issues[0].detail.clone())
    }

    fn attributes(n: usize) -> String {
        (0..n).map(|i| format!(" a{i}='{i}'")).collect()
    }

    #[test]
    fn everything_is_counted_and_nothing_that_only_looks_like_it() {
        let text = "<?xml version='1.0'?><?p a=\"b\"?><!-- <a b='c'> --><robot xmlns='u' xmlns:x = \"v\" name='>a'\n>\
                    <![CDATA[<d e='f'>]]><link name=\"it's\"/><x:link name='=\"\"' a='/'></x:link ></robot>";
        let expected = Counts {
            n_elements: 3,
            depth: 2,
            most_attributes: 3,
            n_attributes: 6,
            n_namespaces: 2,
        };
        assert_eq!(
            check(text).unwrap(),
            Counts {
                depth: 2,
                ..expected
            }
        );
        Document::parse(text).unwrap();
    }

    #[test]
    fn each_limit_is_refused_with_its_line() {
        let just = format!("<robot{}/>", attributes(MAX_ATTRIBUTES));
        assert_eq!(check(&just).unwrap().most_attributes, MAX_ATTRIBUTES);
        let (code, detail) = code_and_detail(&format!(
            "<robot>\n\n<link{}/>",
            attributes(MAX_ATTRIBUTES + 1)
        ));
        assert_eq!(code, "too_many_attributes");
        assert!(
            detail.starts_with("line 3: the element <link> has more than 64 attributes"),
            "{detail}"
        );
        let namespaces: String = (0..=MAX_NAMESPACES)
            .map(|i| format!("<a xmlns:n{i}='u{i}'/>\n"))
            .collect();
        let (code, detail) = code_and_detail(&format!("<robot>{namespaces}</robot>"));
        assert_eq!(code, "too_many_namespaces");
        assert!(detail.starts_with("line 65: "), "{detail}");
        assert_eq!(code_and_detail(&"<a>".repeat(MAX_DEPTH + 1)).0, "too_deep");
        assert_eq!(
            code_and_detail(&"<a/>".repeat(MAX_ELEMENTS + 1)).0,
            "too_many_elements"
        );
        let spread = format!("<a{}/>", attributes(MAX_ATTRIBUTES)).repeat(3126);
        assert_eq!(code_and_detail(&spread).0, "too_many_attributes");
        assert_eq!(
            code_and_detail("<!DOCTYPE robot [<!ENTITY a 'b'>]><robot/>").0,
            "not_xml"
        );
    }

    /// The counts by the parser.
    fn counted(document: &Document<'_>) -> (usize, usize, usize) {
        let elements: Vec<Node<'_, '_>> = document.descendants().filter(Node::is_element).collect();
        let depth = |node: &Node<'_, '_>| node.ancestors().filter(Node::is_element).count();
        (
            elements.len(),
            elements.iter().map(depth).max().unwrap_or(0),
            elements
                .iter()
                .map(|node| node.attributes().len())
                .max()
                .unwrap_or(0),
        )
    }

    proptest! {
        /// Pieces of XML in any order. For every text that the parser accepts, the counts must agree with the parser.
        #[test]
        fn what_the_parser_finds_was_counted(pieces in prop::collection::vec(prop::sample::select(vec![
            "<a>", "</a>", "<b c='d'>", "</b>", "<e/>", "<e f=\"'\" g = '>'/>", "<!--", "-->", "<![CDATA[", "]]>", "<?p", "?>", "'", "\"",
            "=", " ", "text", "<", ">", "/>", "xmlns:q='r'", " xmlns='s'", " q:xmlns='t'", "<q:a xmlns:q=\"r\" q:b='1'/>", "\n", "&lt;", "é",
        ]), 0..24)) {
            let text = pieces.concat();
            for text in [text.clone(), format!("<robot>{text}</robot>"), format!("<robot {text}/>")] {
                let counts = check(&text);
                if let Ok(document) = Document::parse(&text) {
                    let counts = counts.unwrap();
                    let (n_elements, depth, most_attributes) = counted(&document);
                    prop_assert_eq!((counts.n_elements, counts.depth), (n_elements, depth));
                    prop_assert!(counts.most_attributes >= most_attributes);
                    prop_assert_eq!(counts.n_attributes - counts.n_namespaces, document.descendants().map(|node| node.attributes().len()).sum::<usize>());
                }
            }
        }
    }
}
