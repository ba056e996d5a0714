//! Libraries that are put before the C library of a process under test.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Builds one from its source; none, with one loud line, where there is no C compiler.
pub fn build(dir: &Path, name: &str, source: &str) -> Option<PathBuf> {
    let (path, library) = (
        dir.join(format!("{name}.c")),
        dir.join(format!("{name}.so")),
    );
    std::fs::write(&path, source).unwrap();
    let built = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", "-o"])
        .arg(&library)
        .arg(&path)
        .arg("-ldl")
        .output();
    match built {
        Ok(output) if output.status.success() => Some(library),
        other => {
            // Past the test harness, which keeps what a passing test prints to itself.
            let _ = writeln!(
                std::io::stderr(),
                "!!! {name}.c CANNOT BE BUILT, THE TEST THAT NEEDS IT DID NOT RUN: {other:?} !!!"
            );
            None
        }
    }
}
