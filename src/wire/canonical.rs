//! Canonical JSON and its hash. The same content has the same bytes in every implementation.
//!
//! The format is RFC 8785 (JCS): no white space, sorted keys, and numbers as ECMAScript prints them (the shortest text that reads back as the same
//! 64-bit float; `1.0` is written as `1`). Libraries for RFC 8785 exist in most languages, so the PC of a robot cell can check a parameter set's
//! `sha256`. There is one deviation: integers beyond 2^53 (seeds) are written exactly.

use serde::Serialize;
use serde_json::{Number, Value};
use sha2::{Digest, Sha256};
use std::cmp::Ordering;
use std::fmt::Write;

/// Canonical JSON of any serialisable value.
///
/// # Errors
/// If the value cannot be written as JSON (a map with keys that are not text).
pub fn to_canonical_json(value: &impl Serialize) -> Result<String, serde_json::Error> {
    canonical_text(&serde_json::to_value(value)?)
}

/// As [`to_canonical_json`], for a JSON value.
///
/// # Errors
/// None in practice: writing to a `String` does not fail.
pub fn canonical_text(value: &Value) -> Result<String, serde_json::Error> {
    text_with(value, write_number)
}

/// The canonical JSON of `value` that has this hash. Two texts are tried: the current one, and the one of versions before 22 November 2026. If two
/// shortest texts are equally near to a number, those versions wrote the text further from zero. Returns `None` if neither text has the hash.
pub fn text_with_hash(
    value: &impl Serialize,
    sha256: &str,
) -> Result<Option<String>, serde_json::Error> {
    let value = serde_json::to_value(value)?;
    let texts = [
        text_with(&value, write_number)?,
        text_with(&value, write_number_as_before)?,
    ];
    Ok(texts
        .into_iter()
        .find(|text| sha256_hex(text.as_bytes()) == sha256))
}

type WriteNumber = fn(&Number, &mut String) -> std::fmt::Result;

fn text_with(value: &Value, number: WriteNumber) -> Result<String, serde_json::Error> {
    let mut text = String::new();
    write_value(value, number, &mut text).map_err(serde::ser::Error::custom)?;
    Ok(text)
}

/// Lower-case hexadecimal SHA-256 of the canonical JSON.
pub fn canonical_sha256(value: &impl Serialize) -> Result<String, serde_json::Error> {
    Ok(sha256_hex(to_canonical_json(value)?.as_bytes()))
}

/// Lower-case hexadecimal SHA-256 of bytes.
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// Lower-case hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    let digit = |nibble: u8| char::from(b"0123456789abcdef"[usize::from(nibble)]);
    bytes
        .iter()
        .flat_map(|byte| [digit(byte >> 4), digit(byte & 15)])
        .collect()
}

fn write_value(value: &Value, number: WriteNumber, out: &mut String) -> std::fmt::Result {
    match value {
        Value::Number(value) => number(value, out),
        Value::Array(items) => write_joined(out, ('[', ']'), items.iter(), |item, out| {
            write_value(item, number, out)
        }),
        Value::Object(map) => {
            let mut entries: Vec<_> = map.iter().collect();
            entries.sort_by(|(a, _), (b, _)| in_utf16(a, b));
            write_joined(out, ('{', '}'), entries.into_iter(), |(key, item), out| {
                write_text(key, out)?;
                out.push(':');
                write_value(item, number, out)
            })
        }
        Value::String(text) => write_text(text, out),
        Value::Null | Value::Bool(_) => write!(out, "{value}"),
    }
}

/// The order of keys: by UTF-16 code units (RFC 8785, section 3.2.3).
fn in_utf16(a: &str, b: &str) -> Ordering {
    a.encode_utf16().cmp(b.encode_utf16())
}

fn write_joined<T>(
    out: &mut String,
    (open, close): (char, char),
    items: impl Iterator<Item = T>,
    write: impl Fn(T, &mut String) -> std::fmt::Result,
) -> std::fmt::Result {
    out.push(open);
    for (i, item) in items.enumerate() {
        if i > 0 {
            out.push(',');
        }
        write(item, out)?;
    }
    out.push(close);
    Ok(())
}

/// Writes a JSON string.
fn write_text(text: &str, out: &mut String) -> std::fmt::Result {
    write!(out, "{}", Value::from(text))
}

fn write_number(number: &Number, out: &mut String) -> std::fmt::Result {
    if number.is_f64() {
        write_ecmascript(&number.to_string(), out)
    } else {
        write!(out, "{number}")
    }
}

/// Writes a number as versions before 22 November 2026 did, with the digits of the standard library. If two shortest texts are equally near to the
/// number, this is the text further from zero.
fn write_number_as_before(number: &Number, out: &mut String) -> std::fmt::Result {
    match number.as_f64() {
        Some(0.0) if number.is_f64() => write_ecmascript("0.0", out),
        Some(float) if number.is_f64() => write_ecmascript(&format!("{float:e}"), out),
        _ => write!(out, "{number}"),
    }
}

/// Writes a number like `Number::toString` of ECMAScript: with the digits d1…dk and n such that the value is 0.d1…dk × 10^n. `shortest` must have
/// these digits. If two texts are equally near to the number, ECMAScript requires the one with the even last digit. `{:e}` of the standard library
/// does not do that.
fn write_ecmascript(shortest: &str, out: &mut String) -> std::fmt::Result {
    let unsigned = shortest.strip_prefix('-').unwrap_or(shortest);
    if unsigned == "0.0" {
        out.push('0');
        return Ok(());
    }
    if unsigned.len() < shortest.len() {
        out.push('-');
    }
    // Without an exponent the text is already in the required form, except for ".0" after an integer. With an exponent it has the form
    // d1.d2…dkE(n-1).
    let Some((mantissa, exponent)) = unsigned.split_once('e') else {
        out.push_str(unsigned.strip_suffix(".0").unwrap_or(unsigned));
        return Ok(());
    };
    let n = exponent.parse::<i32>().map_err(|_| std::fmt::Error)? + 1;
    let first = out.len();
    out.extend(mantissa.chars().filter(|c| *c != '.'));
    let k = (out.len() - first) as i32;
    if k <= n && n <= 21 {
        (k..n).for_each(|_| out.push('0'));
    } else if 0 < n && n <= 21 {
        out.insert(first + n as usize, '.');
    } else if -6 < n && n <= 0 {
        out.insert_str(first, &"0.00000"[..(2 - n) as usize]);
    } else {
        if k > 1 {
            out.insert(first + 1, '.');
        }
        write!(out, "e{:+}", n - 1)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{sha256_hex, text_with_hash, to_canonical_json, write_number};
    use serde_json::json;

    #[test]
    fn numbers_follow_the_table_of_rfc_8785() {
        let table: [(u64, &str); 14] = [
            (0x0000_0000_0000_0000, "0"),
            (0x8000_0000_0000_0000, "0"),
            (0x0000_0000_0000_0001, "5e-324"),
            (0x8000_0000_0000_0001, "-5e-324"),
            (0x7fef_ffff_ffff_ffff, "1.7976931348623157e+308"),
            (0x4340_0000_0000_0000, "9007199254740992"),
            (0x4430_0000_0000_0000, "295147905179352830000"),
            (0x44b5_2d02_c7e1_4af6, "1e+23"),
            (0x444b_1ae4_d6e2_ef4f, "999999999999999900000"),
            (0x444b_1ae4_d6e2_ef50, "1e+21"),
            (0x3eb0_c6f7_a0b5_ed8d, "0.000001"),
            (0x3eb0_c6f7_a0b5_ed8c, "9.999999999999997e-7"),
            (0x41b3_de43_5555_5553, "333333333.3333332"),
            (0xbecb_f647_612f_3696, "-0.0000033333333333333333"),
        ];
        for (bits, expected) in table {
            assert_eq!(text_of_float(f64::from_bits(bits)), expected, "{bits:016x}");
        }
    }

    fn text_of_float(float: f64) -> String {
        let mut text = String::new();
        write_number(&serde_json::Number::from_f64(float).unwrap(), &mut text).unwrap();
        text
    }

    #[test]
    fn of_two_texts_that_are_equally_near_the_even_one_is_written() {
        // The expected texts are those of Node.js. `{:e}` of the standard library rounds the first number up.
        assert_eq!(
            text_of_float(87_477_002_012_648.0 + 0.125),
            "87477002012648.12"
        );
        assert_eq!(
            text_of_float(-87_477_002_012_648.0 - 0.375),
            "-87477002012648.38"
        );
        // 600.2 after a round trip through 32 bits.
        let content = json!({"d_mm": f64::from(600.2_f32), "a_mm": [0.0, -0.0, 1.0, -2.5, 1e-7, 1e21, 123_456.75]});
        let now = r#"{"a_mm":[0,0,1,-2.5,1e-7,1e+21,123456.75],"d_mm":600.2000122070312}"#;
        let before = now.replace("070312", "070313");
        assert_eq!(to_canonical_json(&content).unwrap(), now);
        for text in [now, &before] {
            assert_eq!(
                text_with_hash(&content, &sha256_hex(text.as_bytes()))
                    .unwrap()
                    .as_deref(),
                Some(text)
            );
        }
        assert_eq!(
            text_with_hash(&content, &sha256_hex(b"other")).unwrap(),
            None
        );
    }

    #[test]
    fn numbers_of_every_size_are_the_shortest_that_read_back() {
        let mut state = 1_u64;
        for size in -340..=310 {
            for _ in 0..200 {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                let most = [10_u64, 1000, 1 << 20, 1 << 53][(state >> 5) as usize & 3];
                let float: f64 = format!(
                    "{}{}e{size}",
                    if state & 1 == 0 { "" } else { "-" },
                    (state >> 11) % most
                )
                .parse()
                .unwrap();
                if !float.is_finite() {
                    continue;
                }
                let text = text_of_float(float);
                assert_eq!(text.parse::<f64>().unwrap(), float, "{text}");
                let n_digits = |text: &str| {
                    let digits: String = text
                        .split('e')
                        .next()
                        .unwrap()
                        .chars()
                        .filter(char::is_ascii_digit)
                        .collect();
                    digits.trim_matches('0').len()
                };
                assert_eq!(n_digits(&text), n_digits(&format!("{float:e}")), "{text}");
                let (size, has_exponent) = (float.abs(), text.contains('e'));
                assert_eq!(
                    has_exponent,
                    size != 0.0 && !(1e-6..1e21).contains(&size),
                    "{text}"
                );
            }
        }
    }

    #[test]
    fn keys_beyond_ascii_are_sorted_by_their_utf16_units() {
        let text =
            to_canonical_json(&json!({"\u{fb33}": 1, "\u{1f600}": 2, "z": 3, "ö": 4})).unwrap();
        assert_eq!(text, "{\"z\":3,\"ö\":4,\"\u{1f600}\":2,\"\u{fb33}\":1}");
    }

    #[test]
    fn keys_are_sorted_and_white_space_is_gone() {
        let text =
            to_canonical_json(&json!({"b": [1.0, -0.5, u64::MAX], "a": {"z": null, "k": "é\n"}}))
                .unwrap();
        assert_eq!(
            text,
            r#"{"a":{"k":"é\n","z":null},"b":[1,-0.5,18446744073709551615]}"#
        );
    }

    #[test]
    fn the_hash_is_the_one_everyone_else_computes() {
        assert_eq!(
            sha256_hex(b"abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }
}
