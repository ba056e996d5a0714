//! Import circles among the files of a folder: a file uses only files below it.

use crate::source::{Token, production_tokens, starts_with, used_paths, within_sources};
use std::collections::{BTreeMap, BTreeSet};

/// Absolute path of a module or an item, without `crate`.
type ModulePath = Vec<String>;

/// Source files by module, and what their `pub use` names.
struct Modules<'a> {
    files: BTreeMap<ModulePath, &'a str>,
    re_exports: BTreeMap<ModulePath, ModulePath>,
}

/// Groups of files of one top-level folder that import each other in a circle, each sorted by name.
pub fn circles(files: &[(String, String)]) -> Vec<Vec<String>> {
    let modules = Modules::new(files);
    let mut imports: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (path, text) in files {
        let tokens = production_tokens(text);
        let own = match path.ends_with("/mod.rs") {
            true => split_re_exports(&tokens).0,
            false => tokens,
        };
        let targets = imports.entry(path).or_default();
        for used in used_paths(&own) {
            let mut module = module_path(path);
            module.extend(used.inline_modules.iter().cloned());
            let target = modules.file(&modules.absolute(&module, &used.segments));
            targets
                .extend(target.filter(|target| *target != path && folder(target) == folder(path)));
        }
    }
    let reached: BTreeMap<&str, BTreeSet<&str>> = imports
        .keys()
        .map(|file| (*file, reachable(file, &imports)))
        .collect();
    let mut found: BTreeSet<Vec<String>> = BTreeSet::new();
    for (file, others) in &reached {
        if others.contains(file) {
            let circle = others.iter().filter(|other| reached[*other].contains(file));
            found.insert(circle.map(|file| (*file).to_owned()).collect());
        }
    }
    found.into_iter().collect()
}

/// All files that a file imports, directly or indirectly.
fn reachable<'a>(file: &'a str, imports: &BTreeMap<&str, BTreeSet<&'a str>>) -> BTreeSet<&'a str> {
    let (mut found, mut next) = (BTreeSet::new(), vec![file]);
    while let Some(file) = next.pop() {
        next.extend(imports[file].iter().filter(|target| found.insert(**target)));
    }
    found
}

fn folder(path: &str) -> &str {
    within_sources(path)
        .split(['/', '.'])
        .next()
        .unwrap_or_default()
}

/// `src/http/error.rs` is `http::error`, `src/http/mod.rs` is `http`.
fn module_path(path: &str) -> ModulePath {
    let inside = within_sources(path).trim_end_matches(".rs");
    inside
        .split('/')
        .filter(|name| !["mod", "lib", "main"].contains(name))
        .map(String::from)
        .collect()
}

/// Splits tokens into those outside `pub use …;` and those declarations.
fn split_re_exports(tokens: &[Token]) -> (Vec<Token>, Vec<Token>) {
    let (mut own, mut re_exports) = (Vec::new(), Vec::new());
    let mut i = 0;
    while i < tokens.len() {
        if starts_with(&tokens[i..], &["pub", "use"]) {
            let end = tokens[i..]
                .iter()
                .position(|token| token.text == ";")
                .map_or(tokens.len(), |n| i + n + 1);
            re_exports.extend_from_slice(&tokens[i + 1..end]);
            i = end;
        } else {
            own.push(tokens[i].clone());
            i += 1;
        }
    }
    (own, re_exports)
}

impl<'a> Modules<'a> {
    fn new(files: &'a [(String, String)]) -> Self {
        let by_module = files
            .iter()
            .map(|(path, _)| (module_path(path), path.as_str()));
        let mut modules = Modules {
            files: by_module.collect(),
            re_exports: BTreeMap::new(),
        };
        for (path, text) in files {
            let (_, declarations) = split_re_exports(&production_tokens(text));
            for used in used_paths(&declarations) {
                let module = module_path(path);
                let target = modules.absolute(&module, &used.segments);
                let name = [&module[..], &target[target.len().saturating_sub(1)..]].concat();
                modules.re_exports.insert(name, target);
            }
        }
        modules
    }

    /// The absolute path of a path as written in a module.
    fn absolute(&self, module: &[String], segments: &[String]) -> ModulePath {
        let mut at: ModulePath = match segments[0].as_str() {
            "crate" | "kincal" => Vec::new(),
            "self" | "super" => module.to_vec(),
            name if self
                .files
                .contains_key(&[module, &[name.to_owned()]].concat()) =>
            {
                module.to_vec()
            }
            _ => return Vec::new(),
        };
        for segment in segments {
            match segment.as_str() {
                "super" => drop(at.pop()),
                "self" | "crate" | "kincal" => {}
                name => at.push(name.into()),
            }
        }
        at
    }

    /// The file of an absolute path, following re-exports.
    fn file(&self, path: &[String]) -> Option<&'a str> {
        let mut path = path.to_vec();
        // Follows re-exports of re-exports, at most as deep as folders are nested.
        for _ in 0..8 {
            let exported =
                (1..=path.len()).find_map(|n| Some((n, self.re_exports.get(&path[..n])?)));
            match exported {
                Some((n, target)) if *target != path[..n] => {
                    path = [&target[..], &path[n..]].concat()
                }
                _ => break,
            }
        }
        (1..=path.len())
            .rev()
            .find_map(|n| self.files.get(&path[..n]).copied())
    }
}
