//! What a request is, as far as limits go. Told from method and path alone: a flood is refused before routing.

use axum::http::Method;

/// Whose room a request takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Reads what is stored.
    Read,
    /// Has a body and computes from it, and stores nothing.
    Computation,
    /// Puts an end to something: goes through whatever else is asked for.
    Ending,
    /// All else that is not a read.
    Write,
}

/// Last parts of the paths of [`Class::Computation`].
const COMPUTATIONS: [&str; 5] = [
    "predict",
    "compensate",
    "export",
    "pose-plans",
    "robot-imports",
];
/// And of [`Class::Ending`].
const ENDINGS: [&str; 3] = ["withdraw", "rollback", "cancel"];

impl Class {
    /// The class of a request, also of one to a path that does not exist.
    pub fn of(method: &Method, path: &str) -> Self {
        if matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS) {
            return Self::Read;
        }
        let last = path.rsplit('/').next().unwrap_or_default();
        if *method == Method::POST && COMPUTATIONS.contains(&last) {
            Self::Computation
        } else if *method == Method::POST && ENDINGS.contains(&last) {
            Self::Ending
        } else {
            Self::Write
        }
    }
}

/// Who asks for what.
#[derive(Clone, Debug)]
pub struct Asker {
    /// What is asked for.
    pub class: Class,
    /// The key's id.
    pub holder: String,
}

#[cfg(test)]
mod tests {
    use super::{COMPUTATIONS, Class, ENDINGS};
    use crate::http::auth::{POLICY, Scope};
    use axum::http::Method;

    #[test]
    fn what_a_key_with_the_scope_read_may_do_takes_no_writers_room() {
        for (method, path, scope) in POLICY {
            let class = Class::of(method, path);
            // An import reads its body and stores nothing.
            let only_reads = *scope == Scope::Read || *path == "/v1/robot-imports";
            assert_eq!(
                only_reads,
                matches!(class, Class::Read | Class::Computation),
                "{method} {path}: {class:?}"
            );
        }
    }

    #[test]
    fn each_name_is_that_of_a_route() {
        for name in COMPUTATIONS.iter().chain(&ENDINGS) {
            let is_routes = |(method, path, _): &(Method, &str, Scope)| {
                *method == Method::POST && path.ends_with(&format!("/{name}"))
            };
            assert!(POLICY.iter().any(is_routes), "{name}");
        }
    }
}
