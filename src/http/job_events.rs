//! A job's progress as server-sent events.

use crate::http::auth::{self, Caller};
use crate::http::extract::Item;
use crate::http::{App, Error, access};
use crate::store::JobRow;
use crate::wire::job_answer::{JobAnswer, JobEvent, JobEventName};
use axum::response::sse::{Event, KeepAlive, Sse};
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio::task::JoinSet;
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};

/// Interval of comments that keep the connection open at proxies.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// Interval of the check that the key is still valid.
const KEY_CHECK_INTERVAL: Duration = Duration::from_secs(1);

/// Server-sent events: `progress` at once and at each change of the job, then one `finished`. The data of each event is the job.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/events", tag = "jobs", operation_id = "listenToJob", params(("id" = String, Path, description = "The job")),
    responses((status = 200, description = "`event: progress` or `event: finished`, `data:` the job in JSON", body = JobEvent, content_type = "text/event-stream"))
)]
pub async fn events(
    Item { app, caller, id }: Item,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>> + use<>>, Error> {
    let row = access::job(&app, &caller, &id).await?;
    let permit = app.limits.waiting_permit()?;
    Ok(
        Sse::new(stream(app, caller, row, permit))
            .keep_alive(KeepAlive::new().interval(KEEP_ALIVE)),
    )
}

/// Passes events to the connection. A separate task reads the database; it ends with the stream.
fn stream(
    app: App,
    caller: Caller,
    row: JobRow,
    permit: OwnedSemaphorePermit,
) -> impl Stream<Item = Result<Event, Infallible>> {
    let (events, receiver) = mpsc::channel(1);
    let mut work = JoinSet::new();
    work.spawn(send_events(app, caller, row, events));
    ReceiverStream::new(receiver).map(move |event| {
        // Moves permit and task into the closure, so that they live as long as the stream.
        let _held = (&permit, &work);
        Ok(event)
    })
}

async fn send_events(app: App, caller: Caller, mut row: JobRow, events: mpsc::Sender<Event>) {
    loop {
        let is_over = row.status.is_over();
        let Ok(answer) = JobAnswer::try_from(&row) else {
            return;
        };
        let name = match is_over {
            true => JobEventName::Finished,
            false => JobEventName::Progress,
        };
        if let Some(event) = event(name, &answer)
            && events.send(event).await.is_err()
        {
            return;
        }
        if is_over {
            return;
        }
        let next = tokio::select! {
            next = wait_until_changed(&app, &row) => next,
            () = wait_until_revoked(&app, &caller) => None,
            () = app.stopped() => None,
        };
        // The stream ends on a database error, a shutdown or a revoked key; clients reconnect.
        let Some(next) = next else { return };
        if !auth::is_still_valid(&app, &caller).await {
            return;
        }
        row = next;
    }
}

/// Waits until status, attempt or progress of the job has changed. Returns `None` if the database fails.
async fn wait_until_changed(app: &App, seen: &JobRow) -> Option<JobRow> {
    let has_changed = |job: &JobRow| job.has_progressed_since(seen);
    loop {
        let waited = app
            .signals
            .wait_for_change(&app.store, &seen.id, KEEP_ALIVE, has_changed);
        let row = waited.await.ok()?;
        if has_changed(&row) {
            return Some(row);
        }
    }
}

/// Resolves when the caller's key is revoked or cannot be read.
async fn wait_until_revoked(app: &App, caller: &Caller) {
    while auth::is_still_valid(app, caller).await {
        tokio::time::sleep(KEY_CHECK_INTERVAL).await;
    }
}

fn event(name: JobEventName, job: &JobAnswer) -> Option<Event> {
    Event::default().event(name.as_str()).json_data(job).ok()
}
