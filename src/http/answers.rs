//! The memory of large answers: it is counted until the client has them. A client that asks for many and does not read them would
//! otherwise have each of them kept.

use crate::http::Error;
use crate::http::extract::MIN_BYTES_PER_S;
use crate::http::shares::{Room, Shares};
use axum::body::{Body, Bytes, HttpBody};
use axum::response::{IntoResponse, Response};
use http_body_util::BodyExt;
use hyper::body::{Frame, SizeHint};
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

/// Answers up to this size are not counted: 4096 clients that do not read keep 256 MiB of them at worst, and for ten seconds.
const LARGE_ANSWER_BYTES: usize = 64 * 1024;
/// What is handed to the connection at a time. It takes no more while it has so much unsent.
const PIECE_BYTES: usize = 32 * 1024;

/// Counts an answer if it is large, until it is sent or its client is gone.
///
/// # Errors
/// [`Error::Busy`] if too much is kept already.
pub async fn account(
    response: Response,
    kib: &Shares,
    holder: &str,
    patience: Duration,
) -> Response {
    // What has no length is made as it is sent.
    let Some(bytes) = response
        .body()
        .size_hint()
        .exact()
        .filter(|bytes| *bytes > LARGE_ANSWER_BYTES as u64)
    else {
        return response;
    };
    let room = match kib.take(
        holder,
        usize::try_from(bytes.div_ceil(1024)).unwrap_or(usize::MAX),
    ) {
        Ok(room) => room,
        Err(busy) => return busy.into_response(),
    };
    let (head, body) = response.into_parts();
    // In memory already, in one piece: nothing is copied.
    match body.collect().await {
        Ok(body) => {
            let rest = Bytes::from_owner(Kept {
                bytes: body.to_bytes(),
                _room: room,
            });
            Response::from_parts(
                head,
                Body::new(Sending {
                    rest,
                    sent: 0,
                    patience,
                    begun: None,
                }),
            )
        }
        Err(error) => Error::Internal(format!("an answer was not made: {error}")).into_response(),
    }
}

/// An answer and the room that it takes: the connection may keep the last pieces after the body is gone.
struct Kept {
    bytes: Bytes,
    _room: Room,
}

impl AsRef<[u8]> for Kept {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// An answer on its way, piece by piece. A client that reads slower on the whole than a body may come, after the first seconds, is cut off.
struct Sending {
    rest: Bytes,
    sent: usize,
    patience: Duration,
    begun: Option<Instant>,
}

impl HttpBody for Sending {
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
            > self.patience + Duration::from_secs_f64(self.sent as f64 / MIN_BYTES_PER_S)
        {
            return Poll::Ready(Some(Err(io::ErrorKind::TimedOut.into())));
        }
        let n = self.rest.len().min(PIECE_BYTES);
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
    use super::{LARGE_ANSWER_BYTES, PIECE_BYTES, Sending, account};
    use crate::http::shares::Shares;
    use axum::body::{Bytes, HttpBody};
    use axum::response::{IntoResponse, Response};
    use http_body_util::BodyExt;
    use std::time::{Duration, Instant};

    const PATIENCE: Duration = Duration::from_secs(10);
    const SIZE: usize = LARGE_ANSWER_BYTES + 1;

    fn answer() -> Response {
        (0..SIZE)
            .map(|i| i as u8)
            .collect::<Vec<u8>>()
            .into_response()
    }

    #[tokio::test]
    async fn an_answer_is_counted_until_its_last_piece_is_gone_and_arrives_whole() {
        let kib = Shares::new(1000, 1000);
        let mut body = account(answer(), &kib, "a", PATIENCE).await.into_body();
        assert_eq!(
            (body.size_hint().exact(), kib.left()),
            (Some(SIZE as u64), 1000 - 65)
        );
        let mut pieces = Vec::new();
        while let Some(frame) = body.frame().await {
            pieces.push(frame.unwrap().into_data().unwrap());
        }
        drop(body);
        assert_eq!(
            kib.left(),
            1000 - 65,
            "a connection may keep pieces longer than the body"
        );
        assert!(pieces.iter().all(|piece| piece.len() <= PIECE_BYTES));
        assert_eq!(
            pieces.concat(),
            answer().into_body().collect().await.unwrap().to_bytes()
        );
        drop(pieces);
        assert_eq!(kib.left(), 1000);
    }

    #[tokio::test]
    async fn beyond_the_room_large_answers_are_refused_and_small_ones_are_not() {
        let kib = Shares::new(150, 75);
        let _kept = account(answer(), &kib, "a", PATIENCE).await;
        let statuses = [
            account(answer(), &kib, "a", PATIENCE).await,
            account(answer(), &kib, "b", PATIENCE).await,
        ];
        assert_eq!(
            statuses.map(|response| response.status().as_u16()),
            [503, 200]
        );
        assert_eq!(
            account("small".into_response(), &kib, "a", PATIENCE)
                .await
                .status(),
            200
        );
    }

    #[tokio::test]
    async fn who_reads_too_slowly_is_cut_off() {
        let sending = async |seconds_ago| {
            let begun = Instant::now().checked_sub(Duration::from_secs(seconds_ago));
            Sending {
                rest: Bytes::from_static(b"rest"),
                sent: 160 * 1024,
                patience: PATIENCE,
                begun,
            }
            .frame()
            .await
        };
        assert!(sending(15).await.unwrap().is_ok(), "160 KiB in 15 s");
        assert!(sending(25).await.unwrap().is_err(), "160 KiB in 25 s");
    }
}
