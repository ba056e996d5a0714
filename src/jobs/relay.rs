//! Sends signals between processes that share a PostgreSQL (LISTEN and NOTIFY). Without these signals the processes only poll.

use std::time::Duration;

use tokio::sync::broadcast;
use tokio::task::JoinSet;
use tokio::time::sleep;

use super::JobSignals;
use super::progress::Signal;
use crate::store::{Engine, Store, notices};

/// Pause before reconnecting.
const RECONNECT_DELAY: Duration = Duration::from_millis(200);
/// Time for which equal notices are collected and sent as one (a thousand jobs posted in a burst).
const BATCH_WINDOW: Duration = Duration::from_millis(5);

/// Starts relaying in both directions until the tasks are dropped. On SQLite there is no other process.
pub(super) fn start(store: &Store, signals: &JobSignals) -> JoinSet<()> {
    let mut tasks = JoinSet::new();
    if store.engine() == Engine::Postgres {
        let process = uuid::Uuid::now_v7().simple().to_string();
        tasks.spawn(send(store.clone(), signals.sent(), process.clone()));
        tasks.spawn(receive(store.clone(), signals.clone(), process));
    }
    tasks
}

/// Sends the signals of this process.
async fn send(store: Store, mut sent: broadcast::Receiver<Signal>, process: String) {
    loop {
        let first = match sent.recv().await {
            Ok(signal) => signal,
            Err(broadcast::error::RecvError::Lagged(_)) => Signal::Unknown,
            Err(broadcast::error::RecvError::Closed) => return,
        };
        sleep(BATCH_WINDOW).await;
        let mut batch = vec![first];
        loop {
            match sent.try_recv() {
                Ok(signal) if !batch.contains(&signal) => batch.push(signal),
                Ok(_) => {}
                Err(broadcast::error::TryRecvError::Lagged(_)) => batch = vec![Signal::Unknown],
                Err(_) => break,
            }
        }
        for signal in batch {
            if let Err(error) = notices::send(&store, &format!("{process} {signal}")).await {
                tracing::warn!(error = %error.cause(), "signals could not be sent to other nodes; those poll instead");
                break;
            }
        }
    }
}

/// Receives the signals of other processes.
async fn receive(store: Store, signals: JobSignals, process: String) {
    loop {
        if let Err(error) = receive_from_one_connection(&store, &signals, &process).await {
            tracing::warn!(error = %error.cause(), "signals of other nodes cannot be received; polling meanwhile");
        }
        sleep(RECONNECT_DELAY).await;
        signals.deliver(Signal::Unknown);
    }
}

async fn receive_from_one_connection(
    store: &Store,
    signals: &JobSignals,
    process: &str,
) -> crate::store::Result<()> {
    let Some(mut notices) = notices::listen(store).await? else {
        return Ok(());
    };
    loop {
        let Some(notice) = notices.next().await? else {
            signals.deliver(Signal::Unknown);
            continue;
        };
        match notice.split_once(' ') {
            Some((from, _)) if from == process => {}
            Some((_, text)) => signals.deliver(text.into()),
            None => signals.deliver(Signal::Unknown),
        }
    }
}
