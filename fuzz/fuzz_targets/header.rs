#![no_main]
//! Any text as the header of a file whose rows are numbers: nearly all of what can be wrong with a file is wrong with its header.

use kincal_fuzz::measurement::table::own_form;
use kincal_fuzz::measurement::{Decimal, Frame};

libfuzzer_sys::fuzz_target!(|input: (u8, u8, &str)| {
    let (n_joints, n_rows, header) = (
        usize::from(input.0 % 12) + 1,
        usize::from(input.1 % 4),
        input.2,
    );
    let n_columns = header.split(',').count();
    let row = vec!["1"; n_columns].join(",");
    let text = format!("{header}\n{}", format!("{row}\n").repeat(n_rows));
    kincal_fuzz::check_csv(Decimal::Point, text.as_bytes(), n_joints);
    if let Ok(set) = own_form::parse(text.as_bytes(), Frame::Instrument, n_joints) {
        // Accepted: then each joint and each axis has its one column, and a unit.
        let names: Vec<&str> = header
            .trim_start_matches('\u{feff}')
            .split(',')
            .map(|name| name.trim().trim_matches('"').trim())
            .collect();
        let with = |name: &str, units: &[&str]| {
            let of_unit = |unit: &&str| names.contains(&format!("{name}_{unit}").as_str());
            units.iter().filter(|unit| of_unit(unit)).count()
        };
        let plain = !header.contains(['"', '\n', '\r']);
        for joint in 1..=n_joints {
            let n = with(&format!("q{joint}"), &["deg", "rad", "gon"]);
            assert!(!plain || n == 1, "{header:?}");
        }
        for axis in ["x", "y", "z"] {
            let n = with(axis, &["mm", "m", "cm", "um", "in"]);
            assert!(!plain || n == 1, "{header:?}");
        }
        assert!(!plain || set.points.len() == n_rows, "{header:?}");
    }
});
