//! Lists of words.

/// Whether a text is in a list of words, which are separated by `|`.
pub fn is_one_of(list: &str, text: &str) -> bool {
    list.split('|').any(|word| word == text)
}
