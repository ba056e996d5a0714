//! Times: epoch milliseconds in the store, RFC 3339 UTC on the wire.

/// RFC 3339 in UTC with milliseconds, e.g. `2026-03-01T08:15:30.250Z`. Out-of-range values become the epoch.
pub fn rfc3339(epoch_ms: i64) -> String {
    let instant =
        jiff::Timestamp::from_millisecond(epoch_ms).unwrap_or(jiff::Timestamp::UNIX_EPOCH);
    format!("{instant:.3}")
}

#[cfg(test)]
mod tests {
    use super::rfc3339;

    #[test]
    fn times_are_rfc_3339_in_utc_with_milliseconds() {
        assert_eq!(rfc3339(0), "1970-01-01T00:00:00.000Z");
        assert_eq!(rfc3339(1_772_352_930_250), "2026-03-01T08:15:30.250Z");
    }
}
