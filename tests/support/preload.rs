//! Libraries that a process under test loads before the C library (LD_PRELOAD).

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Builds a library from its source; none, with a message, if there is no C compiler.
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
            // Directly to standard error, because the test harness hides the output of passing tests.
            let _ = writeln!(
                std::io::stderr(),
                "!!! {name}.c CANNOT BE BUILT, THE TEST THAT NEEDS IT DID NOT RUN: {other:?} !!!"
            );
            None
        }
    }
}
