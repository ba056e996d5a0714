//! The rules, as one function of (path, text), so that they also run on planted violations.

use crate::source::{Token, UsedPath, production_tokens, starts_with, used_paths, within_sources};
use std::fmt;

/// The modules of the numeric core, in the order of their dependencies, and others after them.
macro_rules! core_and {
    ($($other:literal),*) => {
        &[
            "kinematics",
            "solvers",
            "measurement",
            "frames",
            "identification",
            "compensation",
            "planning",
            "exchange",
            "calibration",
            $($other),*
        ]
    };
}

/// The numeric core.
pub const CORE: &[&str] = core_and![];

/// Which modules each module may use besides itself (ARCHITECTURE.md, "Who may use whom").
pub const MAY_USE: &[(&str, &[&str])] = &[
    ("kinematics", &[]),
    ("solvers", &[]),
    ("measurement", &["kinematics"]),
    ("frames", &["kinematics", "solvers", "measurement"]),
    ("identification", &["kinematics", "solvers", "measurement"]),
    ("compensation", &["kinematics", "identification"]),
    ("planning", &["kinematics", "identification"]),
    (
        "exchange",
        &["kinematics", "identification", "compensation"],
    ),
    ("calibration", CORE),
    ("config", &[]),
    ("telemetry", &["config"]),
    ("wire", CORE),
    ("store", &["wire"]),
    (
        "release",
        &[
            "kinematics",
            "measurement",
            "identification",
            "calibration",
            "wire",
        ],
    ),
    ("operations", core_and!["release", "wire"]),
    ("jobs", &["release", "store", "wire", "calibration"]),
    ("report_page", &["release", "wire"]),
    (
        "http",
        &[
            "jobs",
            "release",
            "store",
            "operations",
            "wire",
            "report_page",
            "config",
            "telemetry",
            "calibration",
        ],
    ),
];

/// Modules that may use everything: the command line, and the library's root, which only declares modules.
const UNRESTRICTED: &[&str] = &["cli", "lib"];

/// Crates the core may use. Any other dependency of Cargo.toml is a violation there.
const CORE_CRATES: &[&str] = &[
    "libm",
    "nalgebra",
    "multiversion",
    "rand",
    "csv",
    "thiserror",
];

/// Parts of std with side effects, which the core may not use.
const CORE_STD_FORBIDDEN: &[&str] = &["env", "fs", "io", "net", "os", "process", "thread", "time"];

/// The one exception: swarms of millions of particles times poses start threads, which end before the
/// call returns and change no bit. Everything else in the core stays on the thread that called it.
const CORE_STD_ALLOWED: (&str, &str) = ("identification::search::parallel", "thread");

const SHAPES: &str =
    "the JSON shapes are wire's, except for parts of the report and enums of the contract";

const PRINTING_MACROS: &[&str] = &["print", "println", "eprint", "eprintln", "dbg"];

/// Names whose order or numbers differ from run to run or from version to version.
const UNSEEDED: &[&str] = &[
    "HashMap",
    "HashSet",
    "RandomState",
    "ThreadRng",
    "OsRng",
    "SysRng",
    "StdRng",
    "SmallRng",
    "from_os_rng",
];

/// Methods of f64 whose last bits depend on the platform. `sqrt`, `abs`, `mul_add`, rounding and `to_radians` are exact or plain products.
const PLATFORM_FLOAT_METHODS: &[&str] = &[
    "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "exp", "exp2", "exp_m1", "ln", "ln_1p", "log", "log2", "log10",
    "powf", "powi", "cbrt", "hypot", "gamma", "ln_gamma",
];

/// Files aim at 400 lines. A file above this limit holds more than one purpose. (It was 450 at 140 columns; rustfmt's default of 100 makes
/// the same code about a third longer.)
const MAX_LINES: usize = 650;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// A module uses one that it may not use.
    Dependency,
    /// A module of the library has no row in `MAY_USE`.
    UnknownModule,
    /// The core uses a crate that does IO, async or serialisation.
    CoreCrate,
    /// The core uses clock, files, environment, threads or processes.
    CoreStd,
    /// The core prints.
    CorePrints,
    /// The core uses something unseeded.
    Unseeded,
    /// The core uses a float function that differs between platforms.
    PlatformFloat,
    /// The core derives or implements `Serialize` outside of the files of the report and of the contract's enums.
    CoreSerialize,
    /// SQL outside of `store`.
    SqlOutsideStore,
    /// The file is too long.
    TooLong,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    pub rule: Rule,
    pub path: String,
    pub line: usize,
    pub detail: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}:{}: {:?}: {}",
            self.path, self.line, self.rule, self.detail
        )
    }
}

/// Checks one source file. `path` is relative to the repository (`src/http/error.rs`), `dependencies` are the
/// crates of Cargo.toml as Rust spells them.
pub fn check(path: &str, text: &str, dependencies: &[String]) -> Vec<Violation> {
    let module = module_path(path);
    let owner = module.first().map_or("lib", String::as_str);
    let tokens = production_tokens(text);
    let mut found: Vec<(Rule, usize, String)> = Vec::new();
    for used in used_paths(&tokens) {
        found.extend(check_dependency(owner, &module, &used));
        found.extend(check_crate(&module, &used, dependencies));
    }
    if CORE.contains(&owner) {
        found.extend(check_core_tokens(&tokens));
    }
    if !UNRESTRICTED.contains(&owner) && owner != "main" && may_use(owner).is_none() {
        found.push((
            Rule::UnknownModule,
            1,
            format!("`{owner}` has no row in tests/architecture/rules.rs: say who it may use, there and in ARCHITECTURE.md"),
        ));
    }
    let n_lines = text.lines().count();
    if n_lines > MAX_LINES {
        found.push((
            Rule::TooLong,
            n_lines,
            format!("{n_lines} lines, the limit is {MAX_LINES}: which noun is missing?"),
        ));
    }
    found
        .into_iter()
        .map(|(rule, line, detail)| Violation {
            rule,
            path: path.into(),
            line,
            detail,
        })
        .collect()
}

/// `src/http/error.rs` is `http::error`, `src/http/mod.rs` is `http`, `src/lib.rs` is the root.
fn module_path(path: &str) -> Vec<String> {
    let inside = within_sources(path).trim_end_matches(".rs");
    let mut names: Vec<String> = inside.split('/').map(String::from).collect();
    if names.last().is_some_and(|last| last == "mod") || names == ["lib"] {
        names.pop();
    }
    names
}

fn may_use(owner: &str) -> Option<&'static [&'static str]> {
    MAY_USE
        .iter()
        .find(|(module, _)| *module == owner)
        .map(|(_, uses)| *uses)
}

fn check_dependency(
    owner: &str,
    module: &[String],
    used: &UsedPath,
) -> Option<(Rule, usize, String)> {
    let allowed = if owner == "main" {
        &["cli"]
    } else {
        may_use(owner)?
    };
    let written = used.segments.join("::");
    let target = match target_module(module, used) {
        Target::Elsewhere => return None,
        Target::Root => {
            return Some((
                Rule::Dependency,
                used.line,
                format!("`{written}` names the whole library: name the module that is meant"),
            ));
        }
        Target::Module(name) => name,
    };
    if target == owner || allowed.contains(&target.as_str()) {
        return None;
    }
    Some((
        Rule::Dependency,
        used.line,
        format!("`{owner}` may use {allowed:?}, but this is `{target}` (`{written}`)"),
    ))
}

enum Target {
    /// Another crate, or a name that this scanner does not follow.
    Elsewhere,
    /// The library's root itself, by glob or by another name.
    Root,
    /// A top-level module.
    Module(String),
}

/// The top-level module that a path ends in, following `crate`, the two packages, `self` and `super`.
fn target_module(module: &[String], used: &UsedPath) -> Target {
    let mut at: Vec<String> = match used.segments[0].as_str() {
        "crate" | "kincal" | "kincal_core" => Vec::new(),
        "self" | "super" => module.iter().chain(&used.inline_modules).cloned().collect(),
        _ => return Target::Elsewhere,
    };
    for (index, segment) in used.segments.iter().enumerate() {
        match segment.as_str() {
            "super" => drop(at.pop()),
            "crate" | "kincal" | "kincal_core" if index == 0 => {}
            "self" => {}
            name => at.push(name.into()),
        }
    }
    match at.into_iter().next() {
        None => Target::Root,
        Some(name) if name == "*" => Target::Root,
        // `crate::Name`: an item of the root, which has none of its own
        Some(name) => Target::Module(name),
    }
}

fn check_crate(
    module: &[String],
    used: &UsedPath,
    dependencies: &[String],
) -> Option<(Rule, usize, String)> {
    let (root, written) = (used.segments[0].as_str(), used.segments.join("::"));
    let owner = module.first().map_or("lib", String::as_str);
    let core = CORE.contains(&owner);
    if core && ["std", "core", "alloc"].contains(&root) {
        let part = used.segments.get(1).map_or("", String::as_str);
        let is_allowed = (module.join("::").as_str(), part) == CORE_STD_ALLOWED;
        return (CORE_STD_FORBIDDEN.contains(&part) && !is_allowed).then(|| {
            (
                Rule::CoreStd,
                used.line,
                format!("`{written}`: the core has no clock, files, environment or threads"),
            )
        });
    }
    if !dependencies.iter().any(|name| name == root) {
        return None;
    }
    if core && ["serde", "serde_json", "utoipa"].contains(&root) {
        return Some((
            Rule::CoreSerialize,
            used.line,
            format!("`{written}`: {SHAPES}"),
        ));
    }
    if core && !CORE_CRATES.contains(&root) {
        return Some((
            Rule::CoreCrate,
            used.line,
            format!("`{written}`: the core may use {CORE_CRATES:?}"),
        ));
    }
    (root == "sqlx" && owner != "store").then(|| {
        (
            Rule::SqlOutsideStore,
            used.line,
            format!("`{written}`: all SQL is in store"),
        )
    })
}

fn check_core_tokens(tokens: &[Token]) -> Vec<(Rule, usize, String)> {
    let mut found = Vec::new();
    for (i, token) in tokens.iter().enumerate() {
        let name = token.text.as_str();
        let next = tokens.get(i + 1).map_or("", |t| t.text.as_str());
        if PRINTING_MACROS.contains(&name) && next == "!" {
            found.push((
                Rule::CorePrints,
                token.line,
                format!("`{name}!`: progress leaves the core through the monitor"),
            ));
        }
        if UNSEEDED.contains(&name)
            || (name == "rand"
                && (starts_with(&tokens[i + 1..], &["::", "rng"])
                    || starts_with(&tokens[i + 1..], &["::", "random"])))
        {
            found.push((
                Rule::Unseeded,
                token.line,
                format!("`{name}` differs from run to run: take BTreeMap or BTreeSet, or a generator with a seed"),
            ));
        }
        if (name == "Serialize" || name == "Deserialize") && next != "::" {
            found.push((
                Rule::CoreSerialize,
                token.line,
                format!("`{name}`: {SHAPES}"),
            ));
        }
        if PLATFORM_FLOAT_METHODS.contains(&name) && is_float_method(tokens, i) {
            found.push((Rule::PlatformFloat, token.line, format!("`{name}` of std differs between platforms: libm::{name}, or a plain product for powi (for a method of nalgebra's write the type in front, `Rotation3::powf(&r, t)`)")));
        }
    }
    found
}

/// `x.sin(`, `f64::sin`, `f32::sin`.
fn is_float_method(tokens: &[Token], i: usize) -> bool {
    let before = |n: usize| i.checked_sub(n).map_or("", |at| tokens[at].text.as_str());
    let method = before(1) == "." && tokens.get(i + 1).is_some_and(|t| t.text == "(");
    let function = before(1) == "::" && (before(2) == "f64" || before(2) == "f32");
    method || function
}

/// The crates under `[dependencies]`, as Rust spells them.
pub fn dependencies(manifest: &str) -> Vec<String> {
    let section = manifest
        .lines()
        .skip_while(|line| line.trim() != "[dependencies]")
        .skip(1);
    let entries = section.take_while(|line| !line.starts_with('['));
    entries
        .filter_map(|line| line.split_once('='))
        .map(|(name, _)| name.trim().trim_end_matches(".workspace").replace('-', "_"))
        .filter(|name| !name.starts_with('#'))
        .collect()
}

/// Checks that the manifest lets no dependency choose instructions or random numbers by machine.
pub fn check_manifest(manifest: &str) -> Vec<String> {
    let line = |name: &str| {
        manifest
            .lines()
            .find(|line| line.starts_with(&format!("{name} =")))
            .unwrap_or("")
            .to_owned()
    };
    let mut found = Vec::new();
    let nalgebra = line("nalgebra");
    if !nalgebra.contains("default-features = false")
        || !nalgebra.contains("\"libm-force\"")
        || nalgebra.contains("\"std\"")
    {
        found.push("nalgebra must be built without `std` and with `libm-force`".to_owned());
    }
    if !line("rand").contains("default-features = false") {
        found.push(
            "rand must be built without its default features (thread_rng, OS randomness)"
                .to_owned(),
        );
    }
    found
}
