//! A copy of an embedded database, made while a server uses it.

use std::path::Path;

use super::database::DATABASE;
use super::open::{make_private_dir, make_private_file};
use super::sql::{self, values};
use super::{Engine, Error, Result, Store};

pub(super) const QUERIES_SQLITE: &[&str] = &[VACUUM_INTO];

// Copies one consistent state, without deleted rows. Readers and writers are not blocked.
const VACUUM_INTO: &str = "vacuum into $1";

/// Copies the database into `directory`, which must be new or empty, and waits until the copy is on the disk.
///
/// # Errors
/// [`Error::Open`] if the directory cannot be used or the database is PostgreSQL, [`Error::Database`].
pub async fn write(store: &Store, directory: &Path) -> Result<()> {
    if store.engine() == Engine::Postgres {
        return Err(Error::open(
            "PostgreSQL has its own tools for this: pg_dump, or a base backup with archived WAL",
        ));
    }
    let failed =
        |e: std::io::Error| Error::open(format!("the directory {}: {e}", directory.display()));
    make_private_dir(directory).map_err(failed)?;
    if std::fs::read_dir(directory)
        .map_err(failed)?
        .next()
        .is_some()
    {
        return Err(Error::open(format!(
            "the directory {} is not empty: choose a new or empty one",
            directory.display()
        )));
    }
    let file = directory.join(DATABASE);
    let path = file.to_str().ok_or_else(|| {
        Error::open(format!(
            "the directory {} is not UTF-8",
            directory.display()
        ))
    })?;
    // `vacuum into` accepts an existing file if it is empty.
    make_private_file(&file).map_err(failed)?;
    sql::execute(store.readers(), VACUUM_INTO, values![path]).await?;
    let synced = std::fs::File::open(&file).and_then(|file| file.sync_all());
    synced
        .and_then(|()| std::fs::File::open(directory)?.sync_all())
        .map_err(failed)
}
