//! Room that many share: so much in all, and of it so much for one key, so that no key takes all of it.

use crate::http::Error;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Room that was taken. Dropping it gives it back.
#[derive(Debug)]
pub struct Room(Vec<OwnedSemaphorePermit>);

/// Takes room that is free now.
///
/// # Errors
/// [`Error::Busy`].
pub fn take(semaphore: &Arc<Semaphore>, n: usize) -> Result<Room, Error> {
    let n = u32::try_from(n).unwrap_or(u32::MAX);
    Ok(Room(vec![
        Arc::clone(semaphore)
            .try_acquire_many_owned(n)
            .map_err(|_| Error::Busy)?,
    ]))
}

/// So much in all, and so much for each key.
#[derive(Debug)]
pub struct Shares {
    all: Arc<Semaphore>,
    per_key: usize,
    /// Of the keys that hold something or wait for it.
    keys: Mutex<HashMap<String, Arc<Semaphore>>>,
}

impl Shares {
    /// Nothing taken.
    pub fn new(all: usize, per_key: usize) -> Self {
        Self {
            all: Arc::new(Semaphore::new(all)),
            per_key: per_key.min(all),
            keys: Mutex::default(),
        }
    }

    /// What is left, of all.
    pub fn left(&self) -> usize {
        self.all.available_permits()
    }

    /// Takes what is free now. What is larger than a key's share takes the whole share.
    ///
    /// # Errors
    /// [`Error::Busy`] if the key's share or all of it is taken.
    pub fn take(&self, key: &str, n: usize) -> Result<Room, Error> {
        let n = n.min(self.per_key);
        let Room(mut held) = take(&self.of_key(key), n)?;
        held.extend(take(&self.all, n)?.0);
        Ok(Room(held))
    }

    /// Waits for one. Who waits for the own share keeps nobody else waiting.
    ///
    /// # Errors
    /// [`Error::Internal`]; never in a server that runs.
    pub async fn wait(&self, key: &str) -> Result<Room, Error> {
        let closed = |e: tokio::sync::AcquireError| Error::Internal(e.to_string());
        let own = self.of_key(key).acquire_owned().await.map_err(closed)?;
        Ok(Room(vec![
            own,
            Arc::clone(&self.all)
                .acquire_owned()
                .await
                .map_err(closed)?,
        ]))
    }

    fn of_key(&self, key: &str) -> Arc<Semaphore> {
        let mut keys = self.keys.lock().unwrap_or_else(PoisonError::into_inner);
        // Whoever holds or waits has a reference of its own; the others are forgotten.
        keys.retain(|_, semaphore| Arc::strong_count(semaphore) > 1);
        Arc::clone(
            keys.entry(key.to_owned())
                .or_insert_with(|| Arc::new(Semaphore::new(self.per_key))),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::Shares;
    use crate::http::Error;
    use std::time::Duration;
    use tokio::time::timeout;

    #[test]
    fn a_key_takes_its_share_and_no_more_and_all_keys_no_more_than_there_is() {
        let shares = Shares::new(5, 2);
        let mut held: Vec<_> = (0..2).map(|_| shares.take("a", 1).unwrap()).collect();
        assert!(matches!(shares.take("a", 1), Err(Error::Busy)));
        held.push(shares.take("b", 100).unwrap());
        assert_eq!(
            shares.left(),
            1,
            "what is larger than a share takes a share"
        );
        assert!(matches!(shares.take("c", 2), Err(Error::Busy)));
        held.push(shares.take("c", 1).unwrap());
        drop(held);
        assert_eq!(shares.left(), 5);
        let _one = shares.take("d", 1).unwrap();
        assert_eq!(
            shares.keys.lock().unwrap().len(),
            1,
            "keys that hold nothing are forgotten"
        );
    }

    #[tokio::test]
    async fn who_waits_for_the_own_share_keeps_nobody_else_waiting() {
        let shares = Shares::new(2, 1);
        let first = shares.wait("a").await.unwrap();
        let second = shares.wait("a");
        tokio::pin!(second);
        assert!(
            timeout(Duration::from_millis(1), &mut second)
                .await
                .is_err()
        );
        shares.wait("b").await.unwrap();
        drop(first);
        second.await.unwrap();
    }
}
