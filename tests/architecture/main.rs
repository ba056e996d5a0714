//! The architecture rules of ARCHITECTURE.md: dependencies between modules, and the purity of the core. Each rule also runs on a planted violation.

mod circles;
mod dependencies;
mod rules;
mod source;
mod words;

use rules::{CORE, MAY_USE, Rule, Violation, check, check_manifest, dependencies};
use std::fs;
use std::path::{Path, PathBuf};

/// The manifests of both packages.
const MANIFESTS: [&str; 2] = [
    include_str!("../../Cargo.toml"),
    include_str!("../../core/Cargo.toml"),
];

/// Files that may break a rule, with the reason. A test fails when an exception is no longer needed.
const KNOWN_EXCEPTIONS: &[(&str, Rule, &str)] = &[
    (
        "core/src/calibration/method.rs",
        Rule::CoreSerialize,
        CHOICES,
    ),
    ("core/src/calibration/method.rs", Rule::CoreCrate, CHOICES),
    (
        "core/src/calibration/quick_check.rs",
        Rule::CoreSerialize,
        REPORT,
    ),
    (
        "core/src/calibration/report.rs",
        Rule::CoreSerialize,
        REPORT,
    ),
    (
        "core/src/calibration/validation/fit.rs",
        Rule::CoreSerialize,
        CHOICES,
    ),
    (
        "core/src/identification/corrections/folds.rs",
        Rule::CoreSerialize,
        REPORT,
    ),
    (
        "core/src/compensation/mode.rs",
        Rule::CoreSerialize,
        CHOICES,
    ),
    ("core/src/compensation/mode.rs", Rule::CoreCrate, CHOICES),
    (
        "core/src/identification/model/choices.rs",
        Rule::CoreSerialize,
        CHOICES,
    ),
    (
        "core/src/identification/model/choices.rs",
        Rule::CoreCrate,
        CHOICES,
    ),
    (
        "core/src/identification/model/correction_terms.rs",
        Rule::CoreSerialize,
        STORED,
    ),
    (
        "core/src/measurement/conventions.rs",
        Rule::CoreSerialize,
        CHOICES,
    ),
    (
        "core/src/measurement/conventions.rs",
        Rule::CoreCrate,
        CHOICES,
    ),
    (
        "core/src/measurement/join/name_parts.rs",
        Rule::CoreSerialize,
        READING,
    ),
];
const CHOICES: &str = "enums of the contract exist once; they derive what JSON, openapi.yaml and the command line need";
const READING: &str =
    "what is left out of names exists once: it is found here, stored with an upload, and shown";
const STORED: &str = "the terms of a stored estimate exist once: the fit names them, and the file of the estimate keeps them as they are";
const REPORT: &str = "parts of the report exist once: they are what the calibration found, and the contract as openapi.yaml pins it";

/// The crates that the two packages use.
fn all_dependencies() -> Vec<String> {
    MANIFESTS.into_iter().flat_map(dependencies).collect()
}

fn checked(path: &str, text: &str) -> Vec<Violation> {
    check(path, text, &all_dependencies())
}

fn rules_broken(path: &str, text: &str) -> Vec<Rule> {
    checked(path, text)
        .into_iter()
        .map(|violation| violation.rule)
        .collect()
}

fn source_files() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = vec![root.join("src"), root.join("core/src")];
    let mut files: Vec<PathBuf> = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("src is readable") {
            let path = entry.expect("src is readable").path();
            if path.is_dir() {
                folders.push(path)
            } else {
                files.push(path)
            }
        }
    }
    files.sort();
    let rust = files
        .into_iter()
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"));
    rust.map(|path| {
        let text = fs::read_to_string(&path).expect("a source file is UTF-8");
        let relative = path
            .strip_prefix(root)
            .expect("below the root")
            .to_string_lossy()
            .replace('\\', "/");
        (relative, text)
    })
    .collect()
}

fn is_known(violation: &Violation) -> bool {
    KNOWN_EXCEPTIONS
        .iter()
        .any(|(path, rule, _)| violation.path == *path && violation.rule == *rule)
}

#[test]
fn every_source_file_keeps_the_rules() {
    let all = source_files();
    let broken = all.iter().flat_map(|(path, text)| checked(path, text));
    let unknown: Vec<String> = broken
        .filter(|v| !is_known(v))
        .map(|v| v.to_string())
        .collect();
    assert!(
        unknown.is_empty(),
        "{} violations:\n{}",
        unknown.len(),
        unknown.join("\n")
    );
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let found = circles::circles(&source_files());
    let found: Vec<String> = found.iter().map(|circle| circle.join("  ")).collect();
    assert!(
        found.is_empty(),
        "{} circles:\n{}",
        found.len(),
        found.join("\n")
    );
}

#[test]
fn a_circle_is_found_through_re_exports_and_across_three_files() {
    let file = |path: &str, text: &str| (path.to_owned(), text.to_owned());
    let circle = [
        file("src/a/mod.rs", "mod b; mod c; mod d; pub use b::B;"),
        file("src/a/b.rs", "use super::c::C; pub struct B(C);"),
        file("src/a/c.rs", "pub struct C; fn f() { crate::a::d::g() }"),
        file("src/a/d.rs", "use crate::a::B; pub fn g() {}"),
        file("src/a/e.rs", "use super::B;"),
    ];
    assert_eq!(
        circles::circles(&circle),
        [["src/a/b.rs", "src/a/c.rs", "src/a/d.rs"]]
    );
    let mut straight = circle;
    straight[3] = file("src/a/d.rs", "pub fn g() {}");
    assert!(circles::circles(&straight).is_empty());
}

#[test]
fn every_known_exception_is_still_needed() {
    let files = source_files();
    for (path, rule, reason) in KNOWN_EXCEPTIONS {
        let text = &files
            .iter()
            .find(|(file, _)| file == path)
            .unwrap_or_else(|| panic!("{path} is gone"))
            .1;
        assert!(
            rules_broken(path, text).contains(rule),
            "{path} keeps {rule:?} now: drop its exception ({reason})"
        );
    }
}

#[test]
fn the_manifest_keeps_the_core_deterministic() {
    let [workspace, core] = MANIFESTS;
    assert_eq!(check_manifest(workspace), Vec::<String>::new());
    // The core takes them from there.
    for name in ["nalgebra", "rand"] {
        assert!(
            core.contains(&format!("\n{name}.workspace = true\n")),
            "{name}"
        );
    }
}

#[test]
fn a_manifest_with_machine_dependent_arithmetic_is_caught() {
    assert_eq!(
        check_manifest("nalgebra = \"0.35\"\nrand = \"0.10\"").len(),
        2
    );
    let with_std = "nalgebra = { version = \"0.35\", default-features = false, features = [\"std\", \"libm-force\"] }\nrand = { default-features = false }";
    assert_eq!(check_manifest(with_std).len(), 1);
}

#[test]
fn the_checker_sees_all_of_the_core_and_all_dependencies() {
    let files = source_files();
    for module in [
        "kinematics",
        "solvers",
        "measurement",
        "frames",
        "identification",
        "calibration",
    ] {
        assert!(
            files
                .iter()
                .any(|(path, _)| path.starts_with(&format!("core/src/{module}"))),
            "no file of {module}"
        );
    }
    for name in [
        "nalgebra",
        "tower_http",
        "sqlx",
        "axum",
        "tokio",
        "tracing",
        "serde",
    ] {
        assert!(
            all_dependencies().iter().any(|known| known == name),
            "{name} is not found in Cargo.toml"
        );
    }
}

#[test]
fn the_table_has_no_cycles() {
    for (index, (module, uses)) in MAY_USE.iter().enumerate() {
        for used in uses.iter().filter(|used| *used != module) {
            assert!(
                MAY_USE[..index].iter().any(|(earlier, _)| earlier == used),
                "{module} uses {used}, which stands below it"
            );
        }
    }
}

#[test]
fn the_core_may_not_use_the_service_however_it_is_written() {
    for line in [
        "use crate::store;",
        "use crate::{kinematics::Link, http::error};",
        "use crate::{\n    kinematics::{Link, Robot},\n    jobs::{self, queue},\n};",
        "use super::super::wire::Robot;",
        "use super::{super::wire, set};",
        "fn f() { crate::store::open(); }",
        "fn f() -> Vec<crate::wire::Robot> { g::<crate::wire::Robot>() }",
        "use kincal::cli;",
        "use ::kincal::cli;",
        "pub(crate) use crate::wire::robot as shape;",
        "mod inner { use super::super::super::store::Store; }",
        "impl From<crate::store::Error> for Error {}",
    ] {
        assert_eq!(
            rules_broken("core/src/measurement/csv.rs", line).first(),
            Some(&Rule::Dependency),
            "{line}"
        );
    }
}

#[test]
fn the_core_may_use_what_stands_before_it() {
    for line in [
        "use crate::kinematics::{Link, Robot};",
        "use super::set::Point;",
        "use super::super::kinematics::Robot;",
        "use self::inner::f; mod inner { use super::Point; use super::super::set::Frame; }",
        "pub(in crate::measurement) fn f() {}",
        "use crate::measurement::set;",
        "use std::collections::BTreeMap; use std::ops::ControlFlow;",
        "use nalgebra::{Matrix3, Vector3}; fn f(v: &Vector3<f64>) -> f64 { v.norm().sqrt().mul_add(libm::sin(1.0), v.x.abs()) }",
    ] {
        assert_eq!(checked("core/src/measurement/csv.rs", line), [], "{line}");
    }
}

#[test]
fn kinematics_and_solvers_know_nothing_of_each_other() {
    assert_eq!(
        rules_broken("core/src/solvers/pso.rs", "use crate::kinematics::Robot;"),
        [Rule::Dependency]
    );
    assert_eq!(
        rules_broken("core/src/kinematics/batch.rs", "use crate::solvers::pso;"),
        [Rule::Dependency]
    );
}

#[test]
fn each_service_module_keeps_to_its_row() {
    for (path, line) in [
        ("src/wire/robot.rs", "use crate::store::robots;"),
        ("src/store/robots.rs", "use crate::kinematics::Robot;"),
        ("src/store/robots.rs", "use crate::jobs::queue;"),
        (
            "src/jobs/worker.rs",
            "use crate::identification::TrainedNetwork;",
        ),
        ("src/jobs/worker.rs", "use crate::http::error;"),
        (
            "src/http/robots.rs",
            "use crate::kinematics::forward_kinematics;",
        ),
        ("src/http/robots.rs", "use crate::cli::serve;"),
        ("src/config.rs", "use crate::http::App;"),
        ("src/main.rs", "use kincal::store::Store;"),
    ] {
        assert_eq!(
            rules_broken(path, line),
            [Rule::Dependency],
            "{path}: {line}"
        );
    }
    for (path, line) in [
        ("src/wire/robot.rs", "use crate::kinematics::Robot;"),
        ("src/store/jobs.rs", "use crate::wire::Job;"),
        (
            "src/jobs/worker.rs",
            "use crate::{calibration::calibrate, store::jobs, wire::job};",
        ),
        (
            "src/http/frames.rs",
            "use crate::calibration::frames_from_sweeps;",
        ),
        (
            "src/cli/demo.rs",
            "use crate::{http, kinematics::Robot, store};",
        ),
        ("src/main.rs", "fn main() { kincal::cli::main() }"),
    ] {
        assert_eq!(checked(path, line), [], "{path}: {line}");
    }
}

#[test]
fn the_whole_library_may_not_be_imported() {
    for line in [
        "use crate::*;",
        "use super::super::*;",
        "use crate::{self as everything};",
        "use super::super as everything;",
    ] {
        assert_eq!(
            rules_broken("core/src/frames/circle_fit.rs", line),
            [Rule::Dependency],
            "{line}"
        );
    }
}

#[test]
fn a_module_without_a_row_is_caught() {
    assert_eq!(
        rules_broken("src/utils.rs", "pub fn helper() {}"),
        [Rule::UnknownModule]
    );
}

#[test]
fn the_core_may_not_use_async_server_or_logging_crates() {
    for line in [
        "use tokio::sync::mpsc;",
        "use axum::Json;",
        "use tracing::info;",
        "fn f() { tracing::info!(\"x\"); }",
        "#[tracing::instrument]\nfn f() {}",
        "use {tokio::spawn};",
        "use tokio as runtime;",
        "extern crate anyhow;",
        "use sha2::Sha256;",
    ] {
        assert_eq!(
            rules_broken("core/src/calibration/mod.rs", line).first(),
            Some(&Rule::CoreCrate),
            "{line}"
        );
    }
    assert_eq!(
        rules_broken("core/src/calibration/mod.rs", "use sqlx::AnyPool;"),
        [Rule::CoreCrate]
    );
}

#[test]
fn the_core_may_not_reach_clock_files_environment_or_threads() {
    for line in [
        "use std::time::Instant;",
        "use std::{collections::BTreeMap, fs::File};",
        "fn f() { std::env::var(\"SEED\"); }",
        "fn f() { std::thread::spawn(|| ()); }",
        "use ::std::process::Command;",
        "use std::io::Read;",
    ] {
        assert_eq!(
            rules_broken("core/src/solvers/pso.rs", line),
            [Rule::CoreStd],
            "{line}"
        );
    }
}

#[test]
fn the_core_may_not_print() {
    for line in [
        "fn f() { println!(\"{}\", 1); }",
        "fn f() { eprintln!(); }",
        "fn f() { dbg!(1); }",
    ] {
        assert_eq!(
            rules_broken("core/src/identification/model/objective.rs", line),
            [Rule::CorePrints],
            "{line}"
        );
    }
}

#[test]
fn the_core_may_not_use_unseeded_randomness_or_random_order() {
    for line in [
        "use std::collections::HashMap;",
        "fn f() -> std::collections::HashSet<u8> { loop {} }",
        "fn f() { let x = rand::rng(); }",
        "fn f() { let x: f64 = rand::random(); }",
        "use rand::rngs::StdRng;",
        "fn f() { ChaCha8Rng::from_os_rng(); }",
    ] {
        assert_eq!(
            rules_broken("core/src/solvers/bpnn.rs", line),
            [Rule::Unseeded],
            "{line}"
        );
    }
}

#[test]
fn the_core_may_not_use_float_functions_that_differ_between_platforms() {
    for line in [
        "fn f(x: f64) -> f64 { x.sin() }",
        "fn f(x: f64) -> f64 { (x * 2.0).cos() }",
        "fn f(x: f64) -> (f64, f64) { x\n    .sin_cos() }",
        "fn f(x: f64) -> f64 { x.tanh() }",
        "fn f(x: f64) -> f64 { x.exp() }",
        "fn f(x: f64) -> f64 { x.powf(0.5) }",
        "fn f(x: f64) -> f64 { x.powi(2) }",
        "fn f(x: f64, y: f64) -> f64 { y.atan2(x) }",
        "fn f(x: &[f64]) -> Vec<f64> { x.iter().copied().map(f64::tanh).collect() }",
        "fn f(x: f64, y: f64) -> f64 { f64::hypot(x, y) }",
    ] {
        assert_eq!(
            rules_broken("core/src/kinematics/forward.rs", line),
            [Rule::PlatformFloat],
            "{line}"
        );
    }
    for line in [
        "fn f(x: f64) -> f64 { libm::sin(x) + libm::atan2(x, 1.0) }",
        "struct S { sin: f64 } fn f(s: S) -> f64 { s.sin }",
    ] {
        assert_eq!(
            checked("core/src/kinematics/forward.rs", line),
            [],
            "{line}"
        );
    }
    assert_eq!(
        checked("src/wire/robot.rs", "fn f(x: f64) -> f64 { x.sin() }"),
        [],
        "the service may"
    );
}

#[test]
fn core_types_are_not_serialised_outside_of_the_named_files() {
    for line in [
        "use serde::{Deserialize, Serialize};",
        "#[derive(Clone, Serialize)]\nstruct S;",
        "#[derive(Clone, serde::Serialize)]\nstruct S;",
        "impl serde::Serialize for S {}",
        "#[derive(utoipa::ToSchema)]\nstruct S;",
    ] {
        assert!(
            rules_broken("core/src/calibration/problem.rs", line).contains(&Rule::CoreSerialize),
            "{line}"
        );
    }
}

#[test]
fn sql_stays_in_store() {
    assert_eq!(
        rules_broken("src/http/robots.rs", "use sqlx::query;"),
        [Rule::SqlOutsideStore]
    );
    assert_eq!(
        rules_broken("src/cli/serve.rs", "use sqlx::AnyPool;"),
        [Rule::SqlOutsideStore]
    );
    assert_eq!(
        rules_broken("src/jobs/worker.rs", "use sqlx::SqliteConnection;"),
        [Rule::SqlOutsideStore]
    );
    assert_eq!(checked("src/store/robots.rs", "use sqlx::query;"), []);
}

#[test]
fn a_source_file_above_the_limit_is_caught() {
    assert_eq!(
        rules_broken("core/src/kinematics/model.rs", &"\n".repeat(651)),
        [Rule::TooLong]
    );
    assert_eq!(
        checked("core/src/kinematics/model.rs", &"\n".repeat(650)),
        []
    );
}

#[test]
fn comments_strings_and_test_modules_do_not_count() {
    let innocent = r##"
        //! crate::store, x.sin(), println!
        /* use tokio::spawn; /* nested */ use std::fs; */
        const A: &str = "use crate::http; \" x.sin()";
        const B: &str = r#"use sqlx::query; " println!()"#;
        const C: &[u8] = b"std::fs";
        const D: char = '"';
        const E: char = '\'';
        fn f<'a>(x: &'a str) -> &'a str { x }
        #[cfg(test)]
        mod tests {
            use crate::store::Store;
            fn g(x: f64) -> f64 { println!("{x}"); x.sin() }
        }
        #[cfg(all(test, feature = "x"))]
        use std::fs;
        #[cfg(test)]
        fn only_here(x: [u8; 3]) -> f64 { 1.0_f64.exp() }
    "##;
    assert_eq!(checked("core/src/kinematics/forward.rs", innocent), []);
}

#[test]
fn code_beside_comments_strings_and_test_modules_does_count() {
    for guilty in [
        "/* a comment */ use crate::store::Store;",
        "const A: &str = \"//\"; use crate::store::Store;",
        "const A: char = '\"'; use crate::store::Store; const B: char = '\"';",
        "const A: &str = r\"\\\"; use crate::store::Store; const B: &str = \"\";",
        "#[cfg(test)]\nmod tests { fn f() {} }\nuse crate::store::Store;",
        "#[cfg(not(test))]\nuse crate::store::Store;",
        "fn f<'a>() {} use crate::store::Store; fn g<'a>() {}",
    ] {
        assert_eq!(
            rules_broken("core/src/kinematics/forward.rs", guilty),
            [Rule::Dependency],
            "{guilty}"
        );
    }
}

#[test]
fn a_violation_names_its_file_and_line() {
    let found = checked(
        "core/src/solvers/pso.rs",
        "\n// x\nuse std::{\n    fmt,\n    fs,\n};\n",
    );
    assert_eq!(
        found
            .iter()
            .map(|v| (v.path.as_str(), v.line))
            .collect::<Vec<_>>(),
        [("core/src/solvers/pso.rs", 5)]
    );
}

#[test]
fn the_core_has_a_row_for_each_of_its_modules() {
    assert!(
        CORE.iter()
            .all(|module| MAY_USE.iter().any(|(row, _)| row == module))
    );
}

/// Texts that look like the code of a warning in the source, but are refusals or fields.
const NO_WARNINGS: [&str; 7] = [
    "fit_diverged",
    "invalid_measurements",
    "invalid_query",
    "target_name",
    "std_mm",
    "std_axes_mm",
    "covariance_mm2",
];

#[test]
fn every_warning_and_every_gate_has_plain_words() {
    let places = [
        "core/src/calibration/",
        "src/wire/",
        "src/operations/",
        "src/release/",
        "src/jobs/",
        "src/http/",
    ];
    let files: Vec<(String, String)> = source_files()
        .into_iter()
        .filter(|(path, _)| places.iter().any(|place| path.starts_with(place)))
        .collect();
    for (table, of, some) in [
        (
            "WARNINGS",
            words::warnings as fn(&str) -> Vec<&str>,
            "target_moved",
        ),
        ("GATES", words::gates, "improved_on_active"),
    ] {
        let given: Vec<(&str, &String)> = files
            .iter()
            .flat_map(|(path, text)| of(text).into_iter().map(move |code| (code, path)))
            .collect();
        assert!(
            given.iter().any(|(code, _)| *code == some),
            "{some} is found in the sources"
        );
        // A set that was accepted by `insist` carries the refusal as a warning.
        let insisted = kincal::calibration::upload_checks::alignment::SUSPICIONS;
        let insisted: &[&str] = if table == "WARNINGS" { &insisted } else { &[] };
        let worded = words::worded(table);
        let wordless: Vec<&(&str, &String)> = given
            .iter()
            .filter(|(code, _)| !worded.contains(code) && !NO_WARNINGS.contains(code))
            .collect();
        assert!(
            wordless.is_empty(),
            "without words in web/words.js, {table}: {wordless:?}"
        );
        let dead: Vec<&str> = worded
            .into_iter()
            .filter(|code| given.iter().all(|(given, _)| given != code) && !insisted.contains(code))
            .collect();
        assert!(
            dead.is_empty(),
            "words in web/words.js for what nothing gives, {table}: {dead:?}"
        );
    }
}

#[test]
fn every_warning_says_why_it_matters_and_what_to_do_in_a_short_sentence() {
    /// Longest sentence, characters: two lines on a page.
    const LONGEST: usize = 130;
    let codes = words::worded("WARNINGS");
    for table in ["MATTERS", "REMEDIES"] {
        assert_eq!(
            words::worded(table),
            codes,
            "{table}: the codes of WARNINGS, in their order"
        );
        for (code, text) in words::texts(table) {
            assert!(
                text.ends_with('.') && text.len() <= LONGEST,
                "{table}, {code}: {text}"
            );
        }
    }
}

#[test]
fn every_gate_has_a_title_for_a_refusal_and_for_a_remark() {
    let gates = words::worded("GATES");
    for table in ["UNMET", "REMARKED"] {
        assert_eq!(
            words::worded(table),
            gates,
            "{table}: the gates of GATES, in their order"
        );
    }
}

#[test]
fn a_warning_without_words_is_found_however_it_is_written() {
    for line in [
        "Warning { code: \"not_thought_of\", detail, rows: vec![] }",
        "warnings.push(warning(\n    \"not_thought_of\",\n    detail));",
        "warnings.push(Warning::new(\n    \"not_thought_of\",\n    detail));",
        "let (code, what): (&str, &str) = (\"not_thought_of\", \"words\"); Warning { code, detail }",
        "Explanation::Warning { code: \"not_thought_of\", detail }",
        "pub const NEW: &str = \"not_thought_of\"; Warning { code: NEW, detail }",
    ] {
        assert_eq!(words::warnings(line), ["not_thought_of"], "{line}");
    }
    assert_eq!(
        words::warnings("Error { code: \"not_thought_of\" }"),
        Vec::<&str>::new()
    );
}

#[test]
fn every_planted_fault_still_finds_its_place() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/planted_faults.py");
    let checked = std::process::Command::new("python3")
        .arg(script)
        .arg("--check")
        .output();
    let Ok(checked) = checked else {
        use std::io::Write;
        let _ = writeln!(
            std::io::stderr(),
            "!!! python3 IS NOT INSTALLED: PLANTED FAULTS ARE NOT LOOKED FOR !!!"
        );
        return;
    };
    assert!(
        checked.status.success(),
        "move or correct them in tests/planted_faults.py:\n{}{}",
        String::from_utf8_lossy(&checked.stdout),
        String::from_utf8_lossy(&checked.stderr)
    );
}
