//! A copy of an embedded database, made while it is served.

use std::path::Path;

use super::database::DATABASE;
use super::open::{make_private_dir, make_private_file};
use super::{Engine, Error, Result, Store};

pub(super) const QUERIES_SQLITE: &[&str] = &[INTO];

// One consistent state, without what was deleted; readers and writers go on.
const INTO: &str = "vacuum into $1";

/// Writes the database into `directory`, which must be new or empty, and waits until it is on the disk.
///
/// # Errors
/// [`Error::Open`] where the directory will not do or the database is PostgreSQL, [`Error::Database`].
pub async fn write(store: &Store, directory: &Path) -> Result<()> {
    if store.engine() == Engine::Postgres {
        return Err(Error::Open {
            detail:
                "PostgreSQL has its own tools for this: pg_dump, or a base backup with archived WAL"
                    .into(),
        });
    }
    let failed = |e: std::io::Error| Error::Open {
        detail: format!("the directory {}: {e}", directory.display()),
    };
    make_private_dir(directory).map_err(failed)?;
    if std::fs::read_dir(directory)
        .map_err(failed)?
        .next()
        .is_some()
    {
        return Err(Error::Open {
            detail: format!(
                "the directory {} is not empty: a backup is never written over another",
                directory.display()
            ),
        });
    }
    let file = directory.join(DATABASE);
    let path = file.to_str().ok_or_else(|| Error::Open {
        detail: format!("the directory {} is not UTF-8", directory.display()),
    })?;
    // SQLite writes a copy into an empty file as into none
    make_private_file(&file).map_err(failed)?;
    sqlx::query(INTO).bind(path).execute(store.pool()).await?;
    let synced = std::fs::File::open(&file).and_then(|file| file.sync_all());
    synced
        .and_then(|()| std::fs::File::open(directory)?.sync_all())
        .map_err(failed)
}
