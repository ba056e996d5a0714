//! What the processes on one PostgreSQL tell each other: LISTEN and NOTIFY. Notices only save waiting; one that is lost delays nobody for
//! longer than the poll that stands behind it.

use sqlx::postgres::PgListener;

use super::{Result, Store};

/// The channel of all kincal processes on a database; PostgreSQL keeps those of different databases apart.
const CHANNEL: &str = "kincal_jobs";

pub(super) const QUERIES_POSTGRES: &[&str] = &[SEND];

const SEND: &str = "select 1 from (select pg_notify('kincal_jobs', $1)) as sent";

/// The notices of all processes, this one's among them.
#[derive(Debug)]
pub struct Notices {
    listener: PgListener,
}

impl Notices {
    /// The next notice; none after the connection was lost and made anew: anything may have been missed.
    ///
    /// # Errors
    /// [`super::Error::Database`] if the connection cannot be made anew.
    pub async fn next(&mut self) -> Result<Option<String>> {
        Ok(self
            .listener
            .try_recv()
            .await?
            .map(|notice| notice.payload().to_owned()))
    }
}

/// Begins to listen; none where the database has only one process.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn listen(store: &Store) -> Result<Option<Notices>> {
    let Some(url) = store.postgres_url() else {
        return Ok(None);
    };
    let mut listener = PgListener::connect(url).await?;
    listener.listen(CHANNEL).await?;
    Ok(Some(Notices { listener }))
}

/// Sends a notice to every process on this database. At most 8,000 bytes.
///
/// # Errors
/// [`super::Error::Database`].
pub async fn send(store: &Store, notice: &str) -> Result<()> {
    sqlx::query(SEND)
        .bind(notice)
        .execute(store.reads())
        .await?;
    Ok(())
}
