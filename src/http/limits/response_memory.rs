//! Counts the memory of large answers until they are sent. Otherwise a client that requests many and reads none would fill the memory.

use crate::http::limits::permits::{Limits, MIN_BYTES_PER_S};
use crate::http::{App, Error};
use axum::body::{Body, Bytes, HttpBody};
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use http_body_util::BodyExt;
use hyper::body::{Frame, SizeHint};
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};
use tokio::sync::OwnedSemaphorePermit;

/// Answers up to this size are not counted: 4096 clients that do not read hold at most 256 MiB, for ten seconds.
const LARGE_ANSWER_BYTES: u64 = 64 * 1024;
/// Size of the chunks for hyper. It polls the next chunk when it has sent most of the last one.
const CHUNK_BYTES: usize = 32 * 1024;

/// Middleware: counts an answer if it is large, until it is sent or its client disconnects. Beyond the limit the answer is 503.
pub async fn count(State(app): State<App>, response: Response) -> Response {
    hold_memory(response, &app.limits).await
}

async fn hold_memory(response: Response, limits: &Limits) -> Response {
    // An answer without a length is a stream and not in memory.
    let bytes = response.body().size_hint().exact();
    let Some(bytes) = bytes.filter(|bytes| *bytes > LARGE_ANSWER_BYTES) else {
        return response;
    };
    let permit = match limits.answer_memory(bytes) {
        Ok(permit) => permit,
        Err(busy) => return busy.into_response(),
    };
    let (head, body) = response.into_parts();
    // The body is in memory in one piece, so `collect` copies nothing.
    match body.collect().await {
        Ok(body) => {
            let bytes = body.to_bytes();
            let rest = Bytes::from_owner(Counted {
                bytes,
                _permit: permit,
            });
            let body = TimedBody {
                rest,
                sent: 0,
                client_timeout: limits.client_timeout(),
                begun: None,
            };
            Response::from_parts(head, Body::new(body))
        }
        Err(error) => Error::Internal(format!("an answer was not made: {error}")).into_response(),
    }
}

/// The bytes of an answer and their permit. They have one owner, because the connection may hold the last chunks longer than the body.
struct Counted {
    bytes: Bytes,
    _permit: OwnedSemaphorePermit,
}

impl AsRef<[u8]> for Counted {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// A body that is sent chunk by chunk. After the client timeout, a client whose average rate is below [`MIN_BYTES_PER_S`] is disconnected.
struct TimedBody {
    rest: Bytes,
    sent: usize,
    client_timeout: Duration,
    begun: Option<Instant>,
}

impl HttpBody for TimedBody {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, io::Error>>> {
        if self.rest.is_empty() {
            return Poll::Ready(None);
        }
        let begun = *self.begun.get_or_insert_with(Instant::now);
        if begun.elapsed()
            > self.client_timeout + Duration::from_secs_f64(self.sent as f64 / MIN_BYTES_PER_S)
        {
            return Poll::Ready(Some(Err(io::ErrorKind::TimedOut.into())));
        }
        let n = self.rest.len().min(CHUNK_BYTES);
        self.sent += n;
        Poll::Ready(Some(Ok(Frame::data(self.rest.split_to(n)))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty()
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.rest.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::{CHUNK_BYTES, LARGE_ANSWER_BYTES, TimedBody, hold_memory};
    use crate::config::LimitsConfig;
    use crate::http::limits::permits::Limits;
    use axum::body::{Bytes, HttpBody};
    use axum::response::{IntoResponse, Response};
    use http_body_util::BodyExt;
    use std::time::{Duration, Instant};

    const SIZE: usize = LARGE_ANSWER_BYTES as usize + 1;

    fn answer() -> Response {
        let bytes: Vec<u8> = (0..SIZE).map(|i| i as u8).collect();
        bytes.into_response()
    }

    fn free_kib(limits: &Limits) -> usize {
        let free = limits.free();
        free.iter()
            .find(|(kind, _)| *kind == "answers_kib")
            .unwrap()
            .1
    }

    #[tokio::test]
    async fn an_answer_is_counted_until_its_last_chunk_is_gone_and_arrives_whole() {
        let limits = Limits::new(&LimitsConfig::default(), false);
        let all = free_kib(&limits);
        let mut body = hold_memory(answer(), &limits).await.into_body();
        assert_eq!(
            (body.size_hint().exact(), free_kib(&limits)),
            (Some(SIZE as u64), all - 65)
        );
        let mut chunks = Vec::new();
        while let Some(frame) = body.frame().await {
            chunks.push(frame.unwrap().into_data().unwrap());
        }
        drop(body);
        assert_eq!(
            free_kib(&limits),
            all - 65,
            "a connection may keep chunks longer than the body"
        );
        assert!(chunks.iter().all(|chunk| chunk.len() <= CHUNK_BYTES));
        assert_eq!(
            chunks.concat(),
            answer().into_body().collect().await.unwrap().to_bytes()
        );
        drop(chunks);
        assert_eq!(free_kib(&limits), all);
    }

    #[tokio::test]
    async fn beyond_the_limit_large_answers_are_refused_and_small_ones_are_not() {
        let limits = Limits::new(&LimitsConfig::default(), false);
        let _held = limits.answer_memory(free_kib(&limits) as u64 * 1024 - 70 * 1024);
        let _sending = hold_memory(answer(), &limits).await;
        let statuses = [
            hold_memory(answer(), &limits).await.status().as_u16(),
            hold_memory("small".into_response(), &limits)
                .await
                .status()
                .as_u16(),
        ];
        assert_eq!(statuses, [503, 200]);
    }

    #[tokio::test]
    async fn a_client_that_reads_too_slowly_is_cut_off() {
        let sending = async |seconds_ago| {
            let begun = Instant::now().checked_sub(Duration::from_secs(seconds_ago));
            TimedBody {
                rest: Bytes::from_static(b"rest"),
                sent: 160 * 1024,
                client_timeout: Duration::from_secs(10),
                begun,
            }
            .frame()
            .await
        };
        assert!(sending(15).await.unwrap().is_ok(), "160 KiB in 15 s");
        assert!(sending(25).await.unwrap().is_err(), "160 KiB in 25 s");
    }
}
