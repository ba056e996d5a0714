//! The two database engines.

/// Which database is behind a [`Store`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// The embedded database: one server process per data directory.
    Sqlite,
    /// A database server, which several servers and workers may share.
    Postgres,
}
