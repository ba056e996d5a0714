#![no_main]
//! Any bytes as a table of any form: text in any encoding, a workbook or a robot's program, for robots of 1 to 12 joints, with and without a mapping (the
//! first byte says which).

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((first, file)) = bytes.split_first() else {
        return;
    };
    kincal_fuzz::check_table(*first >= 128, file, usize::from(first % 12) + 1);
});
