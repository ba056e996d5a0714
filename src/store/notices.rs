//! LISTEN and NOTIFY between the processes on one PostgreSQL database. Notices only shorten waiting times. Listeners also poll, because a notice may
//! be lost.

use sqlx::postgres::PgListener;

use super::{Result, Store};

/// Channel of all kincal processes on a database; channels of different databases are separate.
const CHANNEL: &str = "kincal_jobs";

pub(super) const QUERIES_POSTGRES: &[&str] = &[SEND];

const SEND: &str = "select 1 from (select pg_notify('kincal_jobs', $1)) as sent";

/// Notices of all processes, including this one.
#[derive(Debug)]
pub struct Notices {
    listener: PgListener,
}

impl Notices {
    /// The next notice; none after a reconnection, because notices may have been missed.
    ///
    /// # Errors
    /// [`super::Error::Database`] if the connection cannot be made again.
    pub async fn next(&mut self) -> Result<Option<String>> {
        Ok(self
            .listener
            .try_recv()
            .await?
            .map(|notice| notice.payload().to_owned()))
    }
}

/// Starts to listen; none on SQLite, which is used by one process.
pub async fn listen(store: &Store) -> Result<Option<Notices>> {
    let Some(url) = store.postgres_url() else {
        return Ok(None);
    };
    let mut listener = PgListener::connect(url).await?;
    listener.listen(CHANNEL).await?;
    Ok(Some(Notices { listener }))
}

/// Sends a notice to every process on this database. A notice may have at most 8,000 bytes.
pub async fn send(store: &Store, notice: &str) -> Result<()> {
    sqlx::query(SEND)
        .bind(notice)
        .execute(store.readers())
        .await?;
    Ok(())
}
