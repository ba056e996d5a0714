//! Problem documents in place of hyper's own answers. A request that hyper cannot parse never reaches the router: hyper writes a 400, 414 or
//! 431 without a body and closes the connection. hyper has no hook for that answer, so this stream recognises it among the written bytes: it lacks
//! the header `x-request-id`, which all other answers have, and it is the last answer on its connection.

use crate::http::Error;
use crate::http::layers;
use axum::http::HeaderMap;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Largest answer that hyper writes by itself: a status line, `connection`, `content-length` and `date`.
const LONGEST_OWN_ANSWER: usize = 256;
const NO_BODY: &str = "content-length: 0\r\n";

/// A stream under hyper that gives hyper's own answers a body.
#[derive(Debug)]
pub struct WithProblems<S> {
    stream: S,
    /// Headers of every answer of this connection.
    headers: HeaderMap,
    /// The last bytes that hyper wrote, if they look like its own answer; held back until it is clear that no more follow.
    held: Vec<u8>,
    /// Whether the writing side was closed.
    is_closed: bool,
}

impl<S> WithProblems<S> {
    /// Wraps a stream. All its answers have these headers.
    pub fn new(stream: S, headers: HeaderMap) -> Self {
        Self {
            stream,
            headers,
            held: Vec::new(),
            is_closed: false,
        }
    }

    /// The stream, if its writing side was closed.
    pub fn closed(self) -> Option<S> {
        self.is_closed.then_some(self.stream)
    }
}

/// The problem for one of hyper's own answers; `None` for other bytes.
fn problem_for(written: &[u8]) -> Option<Error> {
    if written.len() > LONGEST_OWN_ANSWER {
        return None;
    }
    let text = std::str::from_utf8(written).ok()?;
    let (version, rest) = text.split_at_checked("HTTP/1.1 ".len())?;
    let is_head_alone = text.find("\r\n\r\n")? + 4 == text.len();
    let is_own = matches!(version, "HTTP/1.1 " | "HTTP/1.0 ")
        && is_head_alone
        && text.contains(NO_BODY)
        && !text.contains(layers::REQUEST_ID.as_str());
    if !is_own {
        return None;
    }
    match rest.split_at_checked(4)?.0 {
        "400 " => Some(Error::MalformedRequest),
        "414 " => Some(Error::UriTooLong),
        "431 " => Some(Error::HeaderTooLarge),
        _ => None,
    }
}

/// The problem's code for hyper's error on a connection.
pub fn problem_code(error: &hyper::Error) -> Option<&'static str> {
    if error.is_parse_too_large() {
        Some("header_too_large")
    } else {
        error.is_parse().then_some("malformed_request")
    }
}

/// hyper's answer with the headers and the body of a problem.
fn with_body(written: &[u8], error: &Error, common: &HeaderMap) -> Vec<u8> {
    let mut problem = layers::unrouted_problem(error);
    problem.headers_mut().extend(common.clone());
    let mut text = String::from_utf8_lossy(written).into_owned();
    let mut more = format!("content-length: {}\r\n", problem.body().len());
    if !text.contains("connection: close") {
        more.push_str("connection: close\r\n");
    }
    for (name, value) in problem.headers() {
        more.push_str(&format!(
            "{name}: {}\r\n",
            value.to_str().unwrap_or_default()
        ));
    }
    text = text.replace(NO_BODY, &more);
    let mut answer = text.into_bytes();
    answer.extend(problem.body());
    answer
}

impl<S: AsyncWrite + Unpin> WithProblems<S> {
    /// Writes the bytes that were held back.
    fn poll_release(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        while !self.held.is_empty() {
            let n = ready!(Pin::new(&mut self.stream).poll_write(context, &self.held))?;
            if n == 0 {
                return Poll::Ready(Err(io::ErrorKind::WriteZero.into()));
            }
            self.held.drain(..n);
        }
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> AsyncRead for WithProblems<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        to: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        // hyper reads nothing after its own answer, so the bytes held back were part of another answer.
        ready!(self.poll_release(context))?;
        Pin::new(&mut self.stream).poll_read(context, to)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for WithProblems<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        ready!(self.poll_release(context))?;
        if problem_for(bytes).is_some() {
            self.held = bytes.to_vec();
            return Poll::Ready(Ok(bytes.len()));
        }
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        if let [one] = bytes {
            return self.poll_write(context, one);
        }
        ready!(self.poll_release(context))?;
        Pin::new(&mut self.stream).poll_write_vectored(context, bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        if let Some(error) = problem_for(&self.held) {
            self.held = with_body(&self.held, &error, &self.headers);
        }
        ready!(self.poll_release(context))?;
        ready!(Pin::new(&mut self.stream).poll_shutdown(context))?;
        self.is_closed = true;
        Poll::Ready(Ok(()))
    }
}
