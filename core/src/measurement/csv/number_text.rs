//! Numbers as written by spreadsheets and reports: with the minus sign U+2212, and with unambiguous thousands separators.

use crate::measurement::columns::names::{Unit, unit_alone};
use crate::measurement::conventions::Decimal;
use std::borrow::Cow;

/// Characters that are only used as thousands separators: spaces of several widths and apostrophes.
const GROUP_MARKS: [char; 6] = [' ', '\u{a0}', '\u{2009}', '\u{202f}', '\'', '\u{2019}'];

/// Replaces the minus sign U+2212 by `-` and removes thousands separators. They are removed only if they are unambiguous: if the decimal mark follows
/// them, or if they cannot be a decimal mark. Other cells stay unchanged.
pub fn plain(cell: &str, decimal: char) -> Cow<'_, str> {
    let cell = match cell.strip_prefix('\u{2212}') {
        Some(rest) => Cow::Owned(format!("-{rest}")),
        None => Cow::Borrowed(cell),
    };
    let other = if decimal == ',' { '.' } else { ',' };
    let (whole, fraction) = match cell.split_once(decimal) {
        Some((whole, fraction)) => (whole, Some(fraction)),
        None => (&*cell, None),
    };
    let mark = whole
        .chars()
        .find(|c| GROUP_MARKS.contains(c) || *c == other && fraction.is_some());
    let Some(mark) = mark.filter(|mark| is_grouped(whole, *mark)) else {
        return cell;
    };
    let whole = whole.replace(mark, "");
    Cow::Owned(match fraction {
        Some(fraction) => format!("{whole}{decimal}{fraction}"),
        None => whole,
    })
}

/// A cell such as `43.0036°` or `601.7 mm`, without its unit, and the unit.
pub fn without_unit(cell: &str) -> (&str, Option<&'static str>) {
    let end = cell.rfind(|c: char| c.is_ascii_digit() || matches!(c, '.' | ','));
    let Some(end) = end.map(|at| at + 1) else {
        return (cell, None);
    };
    match unit_alone(&cell[end..]) {
        Some(Unit::Is(unit)) if !cell[end..].trim().is_empty() => {
            (cell[..end].trim_end(), Some(unit))
        }
        _ => (cell, None),
    }
}

/// The number in a cell.
pub fn value(cell: &str, decimal: Decimal) -> Option<f64> {
    let (mark, other) = match decimal {
        Decimal::Point => ('.', ','),
        Decimal::Comma => (',', '.'),
    };
    let cell = plain(cell.trim(), mark);
    let number = cell.replace(mark, ".").parse::<f64>().ok();
    number.filter(|number| number.is_finite() && !cell.contains(other))
}

/// The decimal mark of a number that contains both marks, such as `1.234,5` or `1,234.5`.
pub fn decimal_of_both(cell: &str) -> Option<char> {
    let decimal = match (cell.rfind('.')?, cell.rfind(',')?) {
        (point, comma) if point > comma => '.',
        _ => ',',
    };
    let other = if decimal == ',' { '.' } else { ',' };
    (!plain(cell, decimal).contains(other)).then_some(decimal)
}

/// Whether the digits are grouped as in `1 234 567`: one to three digits, then groups of three.
fn is_grouped(whole: &str, mark: char) -> bool {
    let digits = whole.trim_start_matches(['+', '-']);
    let mut groups = digits.split(mark);
    let is = |group: &str, sizes: std::ops::RangeInclusive<usize>| {
        sizes.contains(&group.len()) && group.bytes().all(|byte| byte.is_ascii_digit())
    };
    let first = groups.next().unwrap_or_default();
    is(first, 1..=3) && !first.starts_with('0') && groups.all(|group| is(group, 3..=3))
}

#[cfg(test)]
mod tests {
    use super::{decimal_of_both, plain, without_unit};

    #[test]
    fn units_behind_numbers_are_found() {
        for (cell, number, unit) in [
            ("43.0036°", "43.0036", Some("deg")),
            ("601,7 mm", "601,7", Some("mm")),
            ("-1.5 [rad]", "-1.5", Some("rad")),
            ("12.5", "12.5", None),
            ("1e-3", "1e-3", None),
            ("12.5x", "12.5x", None),
            ("m", "m", None),
            ("", "", None),
        ] {
            assert_eq!(without_unit(cell), (number, unit), "{cell}");
        }
    }

    #[test]
    fn thousands_that_can_be_read_in_one_way_are_read() {
        for (cell, decimal, meant) in [
            ("\u{2212}12.5", '.', "-12.5"),
            ("2\u{a0}589,259", ',', "2589,259"),
            ("-1 234 567.5", '.', "-1234567.5"),
            ("1'234.5", '.', "1234.5"),
            ("2.589,259", ',', "2589,259"),
            ("1,234.5", '.', "1234.5"),
        ] {
            assert_eq!(plain(cell, decimal), meant, "{cell}");
        }
        for (cell, decimal) in [
            ("1.234", ','),
            ("1,234", '.'),
            ("12 34.5", '.'),
            ("0,017.5", '.'),
            ("1,2345.6", '.'),
            ("27 30", '.'),
            ("1.2.3", '.'),
        ] {
            assert_eq!(plain(cell, decimal), cell, "{cell}");
        }
        assert_eq!(decimal_of_both("1.234,5"), Some(','));
        assert_eq!(decimal_of_both("1,234.5"), Some('.'));
        assert_eq!(decimal_of_both("1,23.5"), None);
        assert_eq!(decimal_of_both("1.5"), None);
    }
}
