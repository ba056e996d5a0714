#![no_main]
//! Any bytes as a robot's description: a URDF, or a table of links (the first byte says which).

use kincal_fuzz::wire::import::ImportFormat;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((first, file)) = bytes.split_first() else {
        return;
    };
    match first % 8 {
        0 => kincal_fuzz::check_import(file, ImportFormat::Dh),
        1 => kincal_fuzz::check_import(file, ImportFormat::Mdh),
        _ => {
            kincal_fuzz::check_import(file, ImportFormat::Urdf);
            kincal_fuzz::check_urdf(file);
        }
    }
});
