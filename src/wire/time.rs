//! Times: milliseconds since the epoch in the store, RFC 3339 in UTC on the wire.

/// Formats a time as RFC 3339 in UTC with milliseconds, e.g. `2026-03-01T08:15:30.250Z`. A value out of range becomes the epoch.
pub fn rfc3339(epoch_ms: i64) -> String {
    let instant =
        jiff::Timestamp::from_millisecond(epoch_ms).unwrap_or(jiff::Timestamp::UNIX_EPOCH);
    format!("{instant:.3}")
}

/// Whether a text is a time in RFC 3339 format: date, time with seconds, and offset from UTC.
pub fn is_rfc3339(text: &str) -> bool {
    const SHAPE: &[u8] = b"0000-00-00T00:00:00";
    let Some((head, rest)) = text.as_bytes().split_at_checked(SHAPE.len()) else {
        return false;
    };
    let fits = |(byte, shape): (&u8, &u8)| match shape {
        b'0' => byte.is_ascii_digit(),
        b'T' => matches!(byte, b'T' | b't' | b' '),
        other => byte == other,
    };
    let fraction = rest.strip_prefix(b".").map(|rest| {
        let n_digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
        (n_digits, &rest[n_digits..])
    });
    let zone = match fraction {
        Some((0, _)) => return false,
        Some((_, rest)) => rest,
        None => rest,
    };
    let is_zone = match zone {
        [b'Z' | b'z'] => true,
        [b'+' | b'-', hours @ .., b':', tens, ones] if hours.len() == 2 => {
            // The largest offset is 23:59 [RFC 3339, section 5.6].
            let digits = hours.iter().chain([tens, ones]);
            digits.clone().all(u8::is_ascii_digit) && hours <= b"23".as_slice() && *tens <= b'5'
        }
        _ => false,
    };
    // Parsing also checks the calendar, for example that there is no 30 February and no hour 25.
    head.iter().zip(SHAPE).all(fits) && is_zone && text.parse::<jiff::Timestamp>().is_ok()
}

/// Milliseconds since the epoch; `None` if the text is no time in RFC 3339 format.
pub fn epoch_ms(text: &str) -> Option<i64> {
    let time = is_rfc3339(text).then(|| text.parse::<jiff::Timestamp>().ok())??;
    Some(time.as_millisecond())
}

/// The same time in UTC, as [`rfc3339`] writes it; `None` if the text is no time in RFC 3339 format.
pub fn in_utc(text: &str) -> Option<String> {
    epoch_ms(text).map(rfc3339)
}

#[cfg(test)]
mod tests {
    use super::{in_utc, is_rfc3339, rfc3339};

    #[test]
    fn a_time_has_a_date_seconds_and_its_distance_from_utc() {
        for time in [
            "2026-03-01T08:15:30Z",
            "2026-03-01t08:15:30z",
            "2026-03-01 08:15:30.250+01:00",
            "2024-02-29T23:59:59.999999999-11:30",
            "2016-12-31T23:59:60Z",
        ] {
            assert!(is_rfc3339(time), "{time}");
        }
        for text in [
            "",
            "yesterday",
            "2026-03-01",
            "2026-03-01T08:15Z",
            "2026-03-01T08:15:30",
            "2026-03-01T08:15:30.Z",
            "2026-03-01T08:15:30+0100",
            "2026-03-01T08:15:30+25:00",
            "2026-03-01T08:15:30+01:60",
            "2026-02-30T08:15:30Z",
            "2026-03-01T25:15:30Z",
            "2026-03-01T08:15:30Z[Europe/Paris]",
            "01.03.2026 08:15:30",
            "1772352930",
            "2026-03-01T08:15:30\u{e9}",
        ] {
            assert!(!is_rfc3339(text), "{text}");
        }
    }

    #[test]
    fn times_are_rfc_3339_in_utc_with_milliseconds() {
        assert_eq!(rfc3339(0), "1970-01-01T00:00:00.000Z");
        assert_eq!(rfc3339(1_772_352_930_250), "2026-03-01T08:15:30.250Z");
        let utc = in_utc("2026-03-01T08:15:30+01:00");
        assert_eq!(utc.as_deref(), Some("2026-03-01T07:15:30.000Z"));
        assert_eq!(in_utc("2026-03-01T08:15:30"), None);
    }
}
