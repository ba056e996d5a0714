//! Canonical JSON and its hash: the same content has the same bytes, whoever writes it.
//!
//! The form is RFC 8785 (JCS): no white space, keys sorted, numbers as ECMAScript prints them (the shortest text that reads
//! back as the same 64-bit float; `1.0` is `1`). Libraries for it exist in every language, so a cell PC can check a
//! parameter set's `sha256` on its own. One deviation: integers beyond 2^53 (seeds) are written exactly.

use serde::Serialize;
use serde_json::{Number, Value};
use sha2::{Digest, Sha256};
use std::fmt::Write;

/// Canonical JSON of anything that serialises.
///
/// # Errors
/// If the value cannot be JSON at all (a map with keys that are not text).
pub fn to_canonical_json(value: &impl Serialize) -> Result<String, serde_json::Error> {
    text_of(&serde_json::to_value(value)?)
}

/// As [`to_canonical_json`], of what is JSON already.
///
/// # Errors
/// None in practice: text can always be written to.
pub fn text_of(value: &Value) -> Result<String, serde_json::Error> {
    let mut text = String::new();
    write_value(value, &mut text).map_err(serde::ser::Error::custom)?;
    Ok(text)
}

/// Lower-case hexadecimal SHA-256 of the canonical JSON.
///
/// # Errors
/// As [`to_canonical_json`].
pub fn sha256_of(value: &impl Serialize) -> Result<String, serde_json::Error> {
    Ok(sha256_hex(to_canonical_json(value)?.as_bytes()))
}

/// Lower-case hexadecimal SHA-256 of bytes.
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// Lower-case hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn write_value(value: &Value, out: &mut String) -> std::fmt::Result {
    match value {
        Value::Number(number) => write_number(number, out),
        Value::Array(items) => write_joined(out, ('[', ']'), items.iter(), write_value),
        Value::Object(map) => {
            let mut entries: Vec<_> = map.iter().collect();
            entries.sort_by(|(a, _), (b, _)| a.encode_utf16().cmp(b.encode_utf16()));
            write_joined(out, ('{', '}'), entries.into_iter(), |(key, item), out| {
                write_text(key, out)?;
                out.push(':');
                write_value(item, out)
            })
        }
        Value::String(text) => write_text(text, out),
        Value::Null | Value::Bool(_) => write!(out, "{value}"),
    }
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

/// Text as JSON has it; most needs no escapes.
fn write_text(text: &str, out: &mut String) -> std::fmt::Result {
    if text.bytes().all(|byte| byte >= b' ' && byte != b'"' && byte != b'\\') {
        write!(out, "\"{text}\"")
    } else {
        write!(out, "{}", Value::from(text))
    }
}

fn write_number(number: &Number, out: &mut String) -> std::fmt::Result {
    match number.as_f64() {
        Some(float) if number.is_f64() => write_ecmascript(float, out),
        _ => write!(out, "{number}"),
    }
}

/// Number::toString of ECMAScript: digits d1…dk and n such that the value is 0.d1…dk × 10^n.
fn write_ecmascript(value: f64, out: &mut String) -> std::fmt::Result {
    if value == 0.0 {
        out.push('0');
        return Ok(());
    }
    if value < 0.0 {
        out.push('-');
    }
    // d1.d2…dkE(n-1), where it will stand; then the digits are moved to their places
    let first = out.len();
    write!(out, "{:e}", value.abs())?;
    let e = out[first..].find('e').map_or(out.len(), |e| first + e);
    let n = out.get(e + 1..).and_then(|exponent| exponent.parse::<i32>().ok()).unwrap_or(0) + 1;
    out.truncate(e);
    if out.len() > first + 1 {
        out.remove(first + 1);
    }
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
    use super::{sha256_hex, to_canonical_json, write_ecmascript};
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
            let mut text = String::new();
            write_ecmascript(f64::from_bits(bits), &mut text).unwrap();
            assert_eq!(text, expected, "{bits:016x}");
        }
    }

    #[test]
    fn keys_are_sorted_and_white_space_is_gone() {
        let text = to_canonical_json(&json!({"b": [1.0, -0.5, u64::MAX], "a": {"z": null, "k": "é\n"}})).unwrap();
        assert_eq!(text, r#"{"a":{"k":"é\n","z":null},"b":[1,-0.5,18446744073709551615]}"#);
    }

    #[test]
    fn the_hash_is_the_one_everyone_else_computes() {
        assert_eq!(sha256_hex(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
