//! Formats numbers and names for the page.

/// Smallest error that is printed as a number, mm. No instrument resolves a tenth of a micrometre.
pub const SMALLEST_MM: f64 = 1e-4;

const MINUS: &str = "\u{2212}";

/// A number with about three significant digits. Very small and very large numbers are written with a power of ten.
pub fn number(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() {
        return "–".into();
    }
    if size == 0.0 {
        return "0".into();
    }
    if !(1e-3..1e6).contains(&size) {
        return power(value);
    }
    let decimals = (2.0 - size.log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}").replace('-', MINUS)
}

fn power(value: f64) -> String {
    let text = format!("{value:.1e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    format!(
        "{}·10{}",
        mantissa.replace('-', MINUS),
        superscript(exponent)
    )
}

/// A power of ten with an integer exponent.
pub fn power_of_ten(exponent: i32) -> String {
    format!("10{}", superscript(&exponent.to_string()))
}

fn superscript(exponent: &str) -> String {
    let raised = |c: char| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        digit => digit
            .to_digit(10)
            .and_then(|d| char::from_u32(0x2070 + d))
            .unwrap_or(digit),
    };
    exponent.chars().map(raised).collect()
}

/// A position error, mm.
pub fn error(value: f64) -> String {
    if (0.0..SMALLEST_MM).contains(&value) {
        format!("<{SMALLEST_MM}")
    } else {
        number(value)
    }
}

/// A number with a sign and a fixed number of decimals, for columns.
pub fn signed(value: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", value.abs());
    let sign = match value {
        _ if !text.contains(|c: char| ('1'..='9').contains(&c)) => "",
        v if v < 0.0 => MINUS,
        _ => "+",
    };
    format!("{sign}{text}")
}

/// A value with a fixed number of decimals and a sign only below zero; what rounds to nothing has none.
pub fn fixed(value: f64, decimals: usize) -> String {
    signed(value, decimals).trim_start_matches('+').to_owned()
}

/// A parameter as people write it: θ₃ for `theta_offset_3`. The poses may not tell several parameters apart.
pub fn parameter(name: &str) -> String {
    if name.contains(" or ") {
        let names: Vec<String> = name.split(" or ").map(parameter).collect();
        return names.join(" or ");
    }
    if let Some(axis) = name.strip_prefix("base_r") {
        return format!("base, turned about {axis}");
    }
    if let Some(rest) = name.strip_prefix("target_") {
        return format!("reflector {}", rest.replace('_', ", "));
    }
    let (kind, link) = name.rsplit_once('_').unwrap_or((name, ""));
    let symbol = match kind {
        "a" | "d" => kind,
        "alpha" => "α",
        "theta_offset" => "θ",
        "beta" => "β",
        _ => return name.replace('_', " "),
    };
    let below = |c: char| c.to_digit(10).and_then(|d| char::from_u32(0x2080 + d));
    format!(
        "{symbol}{}",
        link.chars().filter_map(below).collect::<String>()
    )
}

/// A sentence of the calculation with parameters as people write them.
pub fn readable(sentence: &str) -> String {
    let is_name = |word: &str| {
        let is_link = word.rsplit_once('_').is_some_and(|(kind, link)| {
            ["a", "d", "alpha", "theta_offset", "beta"].contains(&kind)
                && link.chars().all(|c| c.is_ascii_digit())
        });
        is_link || word.starts_with("base_") || word.starts_with("target_")
    };
    let word = |whole: &str| {
        let bare = whole.trim_end_matches([',', '.', ';', ':']);
        match is_name(bare) {
            true => format!("{}{}", parameter(bare), &whole[bare.len()..]),
            false => whole.to_owned(),
        }
    };
    // a figure of the report that a warning names stands beside it on the page
    let sentence = [" (flange_rotation_std_deg)", ": flange_rotation_std_deg"]
        .iter()
        .fold(sentence.to_owned(), |text, name| text.replace(name, ""));
    let words: Vec<String> = sentence.split(' ').map(word).collect();
    words.join(" ")
}

/// The symbol of a unit: ° for `deg`.
pub fn unit(unit: &str) -> &str {
    if unit == "deg" { "°" } else { unit }
}

/// A time in UTC to the second, with a space instead of the T.
pub fn time(rfc3339: &str) -> String {
    let (day, clock) = rfc3339.split_once('T').unwrap_or((rfc3339, ""));
    format!("{day} {} UTC", clock.get(..8).unwrap_or(clock))
}

#[cfg(test)]
mod tests {
    use super::{error, fixed, number, parameter, readable, signed, time};

    #[test]
    fn numbers_keep_three_digits() {
        let table = [
            (0.0, "0"),
            (1.0479, "1.05"),
            (64.853, "64.9"),
            (1234.5, "1234"),
            (-0.0552, "\u{2212}0.0552"),
            (2.4e-12, "2.4·10⁻¹²"),
            (-3.04e7, "\u{2212}3.0·10⁷"),
            (f64::NAN, "–"),
        ];
        for (value, text) in table {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn errors_below_what_can_be_measured_are_all_the_same() {
        assert_eq!(error(3e-9), "<0.0001");
        assert_eq!(error(1e-4), "1.0·10⁻⁴");
        assert_eq!(error(0.0552), "0.0552");
    }

    #[test]
    fn what_rounds_to_nothing_has_no_sign() {
        assert_eq!(signed(-0.00001, 4), "0.0000");
        assert_eq!(signed(-0.5, 2), "\u{2212}0.50");
        assert_eq!(signed(0.25, 4), "+0.2500");
    }

    #[test]
    fn values_have_a_sign_only_below_zero_and_parameters_are_symbols() {
        assert_eq!(fixed(-0.004, 2), "0.00");
        assert_eq!(fixed(1.5, 2), "1.50");
        for (name, said) in [
            ("theta_offset_12", "θ₁₂"),
            ("a_2", "a₂"),
            ("base_rx or alpha_1", "base, turned about x or α₁"),
            ("base_x", "base x"),
            ("target_0_y", "reflector 0, y"),
        ] {
            assert_eq!(parameter(name), said);
        }
    }

    #[test]
    fn sentences_of_the_calculation_are_readable() {
        let said = "Likeliest cause: base_rx or alpha_1 by -0.0582° (119.4 standard deviations)";
        let read =
            "Likeliest cause: base, turned about x or α₁ by -0.0582° (119.4 standard deviations)";
        assert_eq!(readable(said), read);
        assert_eq!(
            readable("these poses do not show theta_offset_6: more"),
            "these poses do not show θ₆: more"
        );
    }

    #[test]
    fn times_are_readable() {
        assert_eq!(time("2026-11-21T11:42:37.123Z"), "2026-11-21 11:42:37 UTC");
    }
}
