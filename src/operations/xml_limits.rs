//! Limits on XML, checked in one pass over the text before it is parsed. roxmltree compares each attribute of an element with all others of the
//! element, and searches all declared namespaces for each name. Without limits, parsing a short text can take minutes.

use crate::wire::issue::Invalid;
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

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

/// Counts elements and attributes. Fails at the first place where a limit is exceeded, at a DTD, and if the text is no XML.
pub fn check(text: &str) -> Result<Counts, Invalid> {
    let mut reader = Reader::from_str(text);
    // The parser reports these errors.
    reader.config_mut().check_end_names = false;
    reader.config_mut().allow_unmatched_ends = true;
    reader.config_mut().allow_dangling_amp = true;
    let mut counts = Counts::default();
    let mut n_open: usize = 0;
    loop {
        let at = reader.buffer_position();
        let counted = match reader.read_event() {
            Ok(Event::Start(tag)) => {
                n_open += 1;
                counts.depth = counts.depth.max(n_open);
                count(&tag, &mut counts)
            }
            Ok(Event::Empty(tag)) => {
                counts.depth = counts.depth.max(n_open + 1);
                count(&tag, &mut counts)
            }
            Ok(Event::End(_)) => {
                n_open = n_open.saturating_sub(1);
                continue;
            }
            Ok(Event::DocType(_)) => Err(("not_xml", "there is a DTD; a URDF has none".into())),
            Ok(Event::Eof) => return Ok(counts),
            Ok(_) => continue,
            Err(error) => Err(("not_xml", error.to_string())),
        };
        if let Err((code, what)) = counted {
            let before = text.bytes().zip(0..at);
            let line = 1 + before.filter(|(byte, _)| *byte == b'\n').count();
            return Err(Invalid::at("", code, format!("line {line}: {what}")));
        }
    }
}

/// Counts an element and its attributes. An error has a code and the name of what exceeds its limit.
fn count(tag: &BytesStart<'_>, counts: &mut Counts) -> Result<(), (&'static str, String)> {
    counts.n_elements += 1;
    for (i, attribute) in tag.attributes().with_checks(false).enumerate() {
        let attribute = attribute.map_err(|error| ("not_xml", error.to_string()))?;
        let name = attribute.key.0;
        counts.n_attributes += 1;
        counts.most_attributes = counts.most_attributes.max(i + 1);
        // roxmltree treats `x:xmlns` as a declaration too.
        let is_namespace =
            name == "xmlns" || name.starts_with("xmlns:") || name.ends_with(":xmlns");
        counts.n_namespaces += usize::from(is_namespace);
        if i >= MAX_ATTRIBUTES {
            let element = tag.name().0.chars().take(40).collect::<String>();
            let detail =
                format!("the element <{element}> has more than {MAX_ATTRIBUTES} attributes");
            return Err(("too_many_attributes", detail));
        }
    }
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
        Some((_, limit, code, what)) => Err((code, format!("there are more than {limit} {what}"))),
        None => Ok(()),
    }
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
