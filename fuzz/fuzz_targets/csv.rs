#![no_main]
//! Any bytes as a measurement file, for robots of 1 to 12 joints, with decimal points or commas (the first byte says which).

use kincal_fuzz::measurement::Decimal;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((first, file)) = bytes.split_first() else {
        return;
    };
    let decimal = if *first < 128 {
        Decimal::Point
    } else {
        Decimal::Comma
    };
    kincal_fuzz::check_csv(decimal, file, usize::from(first % 12) + 1);
});
