//! Checks the rules of deny.toml without `cargo-deny`: licences, sources and forbidden crates.
//! Advisories need the tool and its database.

use serde_json::Value;
use std::collections::BTreeSet;
use std::process::Command;

const DENY: &str = include_str!("../../deny.toml");

/// The quoted texts in a part of deny.toml.
fn quoted(piece: &str) -> BTreeSet<&str> {
    piece.split('"').skip(1).step_by(2).collect()
}

/// The list after `key = [` in a section.
fn list(section: &str, key: &str) -> &'static str {
    let (_, section) = DENY
        .split_once(&format!("[{section}]\n"))
        .expect("the section");
    let (_, list) = section
        .split_once(&format!("\n{key} = ["))
        .expect("the key");
    list.split_once("]\n").expect("the list has an end").0
}

/// All packages of the build, also those for tests.
fn packages() -> Vec<Value> {
    let here = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let arguments = [
        "metadata",
        "--locked",
        "--offline",
        "--format-version",
        "1",
        "--filter-platform",
        &here,
    ];
    let output = Command::new(env!("CARGO"))
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    metadata["packages"].as_array().unwrap().clone()
}

/// True if the SPDX expression can be satisfied with the allowed licences. `/` is an old notation for OR; OR has the lowest precedence.
fn can_be_met(expression: &str, allowed: &BTreeSet<&str>) -> bool {
    let spaced = expression
        .replace('/', " OR ")
        .replace('(', " ( ")
        .replace(')', " ) ");
    let mut words = spaced.split_whitespace().peekable();
    either(&mut words, allowed)
}

type Words<'a> = std::iter::Peekable<std::str::SplitWhitespace<'a>>;

fn either(words: &mut Words, allowed: &BTreeSet<&str>) -> bool {
    let mut met = both(words, allowed);
    while words.next_if_eq(&"OR").is_some() {
        met |= both(words, allowed);
    }
    met
}

fn both(words: &mut Words, allowed: &BTreeSet<&str>) -> bool {
    let mut met = one(words, allowed);
    while words.next_if_eq(&"AND").is_some() {
        met &= one(words, allowed);
    }
    met
}

fn one(words: &mut Words, allowed: &BTreeSet<&str>) -> bool {
    let word = words.next().expect("a licence");
    if word == "(" {
        let met = either(words, allowed);
        assert_eq!(words.next(), Some(")"));
        return met;
    }
    // A licence with an exception counts as a licence of its own.
    match words.next_if_eq(&"WITH") {
        Some(_) => allowed
            .contains(format!("{word} WITH {}", words.next().expect("an exception")).as_str()),
        None => allowed.contains(word),
    }
}

#[test]
fn licences_are_read_as_they_are_meant() {
    let allowed = BTreeSet::from(["MIT", "ISC"]);
    for good in [
        "MIT",
        "MIT OR X",
        "X/MIT",
        "X OR (MIT AND ISC)",
        "(X OR MIT) AND ISC",
        "X WITH e OR ISC",
    ] {
        assert!(can_be_met(good, &allowed), "{good}");
    }
    for bad in ["X", "MIT AND X", "(X OR MIT) AND Y", "MIT WITH e", "X/Y"] {
        assert!(!can_be_met(bad, &allowed), "{bad}");
    }
}

#[test]
fn each_dependency_has_an_allowed_licence_and_comes_from_where_it_may() {
    let allowed = quoted(list("licenses", "allow"));
    let sources = quoted(list("sources", "allow-registry"));
    let packages = packages();
    assert!(packages.len() > 100 && allowed.contains("MIT") && sources.len() == 1);
    for package in &packages {
        let name = &package["name"];
        let licence = package["license"]
            .as_str()
            .unwrap_or_else(|| panic!("{name} says no licence"));
        assert!(can_be_met(licence, &allowed), "{name} is {licence}");
        let source = package["source"].as_str();
        let known = source.is_none_or(|source| {
            source
                .strip_prefix("registry+")
                .is_some_and(|source| sources.contains(source))
        });
        assert!(
            known
                && (source.is_some()
                    || ["kincal", "kincal-core"].contains(&name.as_str().unwrap())),
            "{name} comes from {source:?}"
        );
    }
}

#[test]
fn nothing_is_among_the_dependencies_that_is_forbidden() {
    let forbidden: BTreeSet<&str> = DENY
        .split("crate = \"")
        .skip(1)
        .map(|rest| rest.split('"').next().unwrap())
        .filter(|name| *name != "nalgebra")
        .collect();
    assert!(forbidden.len() >= 5, "{forbidden:?}");
    for package in packages() {
        assert!(
            !forbidden.contains(package["name"].as_str().unwrap()),
            "{}",
            package["name"]
        );
        let any = package["dependencies"]
            .as_array()
            .unwrap()
            .iter()
            .any(|dependency| dependency["req"] == "*");
        assert!(
            package["source"].is_string() || !any,
            "a dependency of any version"
        );
    }
}
