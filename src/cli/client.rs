//! The cell PC's side of the REST interface.

use super::Usage;
use crate::wire::Problem;
use crate::wire::job::JobAnswer;
use anyhow::{Context, bail};
use serde_json::Value;
use std::time::Duration;
use tokio_stream::StreamExt;

/// A request that is not answered in this time is given up.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(60);
/// Robots are looked up by name on at most so many pages.
const MAX_PAGES: usize = 50;
/// A connection that ends before the job does is made anew at most this often.
const MAX_RECONNECTS: usize = 20;

/// A request that creates is sent again with the same Idempotency-Key when the connection broke, at most this often.
const MAX_TRIES: usize = 5;
/// And after this long.
const TRY_AGAIN_AFTER: Duration = Duration::from_secs(1);

/// Where the server is, and the key to it.
#[derive(Debug, clap::Args)]
pub struct ServerArguments {
    /// The server.
    #[arg(long, env = "KINCAL_SERVER", default_value = "http://127.0.0.1:8080", value_name = "URL")]
    server: String,
    /// The key; better given in the environment, where nobody sees it.
    #[arg(long, env = "KINCAL_KEY", value_name = "KEY", hide_env_values = true)]
    key: Option<String>,
}

impl ServerArguments {
    /// A client of that server.
    ///
    /// # Errors
    /// As [`Client::new`].
    pub fn client(&self) -> anyhow::Result<Client> {
        Client::new(&self.server, self.key.clone())
    }
}

/// A server, and the key to it.
#[derive(Clone, Debug)]
pub struct Client {
    http: reqwest::Client,
    url: String,
    key: Option<String>,
}

impl Client {
    /// A client of the server at `url` (`http://HOST:PORT`).
    ///
    /// # Errors
    /// If the HTTP client cannot be made.
    pub fn new(url: &str, key: Option<String>) -> anyhow::Result<Self> {
        let http = reqwest::Client::builder().connect_timeout(Duration::from_secs(5)).no_proxy().build()?;
        Ok(Self { http, url: url.trim_end_matches('/').into(), key })
    }

    /// GET, answered in JSON.
    ///
    /// # Errors
    /// The connection, or the server's problem in words.
    pub async fn get(&self, path: &str) -> anyhow::Result<Value> {
        let request = self.http.get(format!("{}{path}", self.url)).timeout(REQUEST_TIMEOUT);
        answer(self.with_key(request).send().await.map_err(|error| unreachable(&self.url, &error))?).await
    }

    /// GET of text.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub async fn get_text(&self, path: &str) -> anyhow::Result<String> {
        let request = self.http.get(format!("{}{path}", self.url)).timeout(REQUEST_TIMEOUT);
        let response = self.with_key(request).send().await.map_err(|error| unreachable(&self.url, &error))?;
        if response.status().is_success() { Ok(response.text().await?) } else { Err(refused(response).await) }
    }

    /// The id of a robot that is named by its id, its name or its serial number.
    ///
    /// # Errors
    /// As [`Self::get`]; [`Usage`] if several robots or none are called so.
    pub async fn robot_id(&self, named: &str) -> anyhow::Result<String> {
        if named.starts_with("rob_") {
            return Ok(named.into());
        }
        let mut called = Vec::new();
        let mut cursor = String::new();
        for _ in 0..MAX_PAGES {
            let page = self.get(&format!("/v1/robots?limit=200{cursor}")).await?;
            let items = page["items"].as_array().into_iter().flatten();
            let fits = items.filter(|robot| [&robot["name"], &robot["serial_number"]].into_iter().any(|field| field == named));
            called.extend(fits.filter_map(|robot| robot["id"].as_str().map(String::from)));
            match page["next_cursor"].as_str() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => break,
            }
        }
        match called.as_slice() {
            [id] => Ok(id.clone()),
            [] => Err(Usage(format!("no robot is called {named:?}; `kincal robots` lists those that are there")).into()),
            several => Err(Usage(format!("several robots are called {named:?}: give --robot one of {}", several.join(", "))).into()),
        }
    }

    /// POST of a body of some content type, answered in JSON.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub async fn post(&self, path: &str, content_type: &str, body: Vec<u8>) -> anyhow::Result<Value> {
        let request = self.http.post(format!("{}{path}", self.url)).timeout(REQUEST_TIMEOUT);
        let request = request.header("content-type", content_type).body(body);
        answer(self.with_key(request).send().await?).await
    }

    /// POST that creates, once however often it has to be sent.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub async fn create(&self, path: &str, content_type: &str, body: Vec<u8>) -> anyhow::Result<Value> {
        let key = uuid::Uuid::now_v7().simple().to_string();
        for attempt in 1..=MAX_TRIES {
            let request = self.http.post(format!("{}{path}", self.url)).timeout(REQUEST_TIMEOUT);
            let request = request.header("content-type", content_type).header("idempotency-key", &key).body(body.clone());
            match self.with_key(request).send().await {
                Ok(response) => return answer(response).await,
                Err(error) if attempt >= MAX_TRIES || error.is_builder() => return Err(unreachable(&self.url, &error)),
                Err(_) => tokio::time::sleep(TRY_AGAIN_AFTER).await,
            }
        }
        bail!("the server {} cannot be reached", self.url)
    }

    /// POST of JSON.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub async fn post_json(&self, path: &str, body: &Value) -> anyhow::Result<Value> {
        self.post(path, "application/json", serde_json::to_vec(body)?).await
    }

    /// Follows a job by its events to its end.
    ///
    /// # Errors
    /// As [`Self::get`], and if the job does not succeed.
    pub async fn follow(&self, job_id: &str, mut moved: impl FnMut(&JobAnswer)) -> anyhow::Result<JobAnswer> {
        for _ in 0..MAX_RECONNECTS {
            if let Some(job) = self.events(job_id, &mut moved).await? {
                return succeeded(job);
            }
        }
        bail!("job {job_id}: the connection was lost {MAX_RECONNECTS} times; ask for it later with GET /v1/jobs/{job_id}")
    }

    /// One connection's events; the job if it is over, nothing if the connection ended first.
    async fn events(&self, job_id: &str, moved: &mut impl FnMut(&JobAnswer)) -> anyhow::Result<Option<JobAnswer>> {
        let response = self.with_key(self.http.get(format!("{}/v1/jobs/{job_id}/events", self.url))).send().await?;
        if !response.status().is_success() {
            return Err(refused(response).await);
        }
        let mut stream = response.bytes_stream();
        let mut text = Vec::new();
        while let Some(Ok(chunk)) = stream.next().await {
            text.extend_from_slice(&chunk);
            while let Some(end) = text.windows(2).position(|w| w == b"\n\n") {
                let event: Vec<u8> = text.drain(..end + 2).collect();
                let Some((name, job)) = parse_event(&event) else { continue };
                moved(&job);
                if name == "finished" {
                    return Ok(Some(job));
                }
            }
        }
        Ok(None)
    }

    fn with_key(&self, request: reqwest::RequestBuilder) -> reqwest::RequestBuilder {
        match &self.key {
            Some(key) => request.bearer_auth(key),
            None => request,
        }
    }
}

fn unreachable(url: &str, error: &reqwest::Error) -> anyhow::Error {
    let reason = if error.is_timeout() { "it did not answer in time".to_owned() } else { error.to_string() };
    anyhow::anyhow!("the server {url} cannot be reached: {reason}; is it running, and is --server right?")
}

fn succeeded(job: JobAnswer) -> anyhow::Result<JobAnswer> {
    let status = serde_json::to_value(job.status)?;
    if status == "succeeded" {
        return Ok(job);
    }
    let reason = job.error.as_ref().map_or(String::new(), |e| format!(": {} ({})", e.detail, e.code));
    bail!("job {} is {}{reason}", job.id, status.as_str().unwrap_or("over"))
}

/// Name and job of one server-sent event; nothing for a comment.
fn parse_event(event: &[u8]) -> Option<(String, JobAnswer)> {
    let text = std::str::from_utf8(event).ok()?;
    let field = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
    Some((field("event:")?.to_string(), serde_json::from_str(field("data:")?).ok()?))
}

/// The body of a success, or the problem in words.
async fn answer(response: reqwest::Response) -> anyhow::Result<Value> {
    if !response.status().is_success() {
        return Err(refused(response).await);
    }
    serde_json::from_slice(&response.bytes().await?).context("the server's answer is not JSON")
}

/// What the server refused, why, and what to do next.
async fn refused(response: reqwest::Response) -> anyhow::Error {
    let status = response.status();
    let bytes = response.bytes().await.unwrap_or_default();
    let Ok(problem) = serde_json::from_slice::<Problem>(&bytes) else { return anyhow::anyhow!("the server answered {status}") };
    let more: Vec<String> = problem.errors.iter().map(|issue| format!("\n  {}", issue.detail)).collect();
    let next = match status.as_u16() {
        401 => "\nnext: give the key with --key or in KINCAL_KEY",
        404 if problem.detail.contains("robot") => "\nnext: kincal robots lists those that are there",
        _ => "",
    };
    let text = format!("{} ({}){}{next}", problem.detail, problem.code, more.concat());
    // as `kincal calibrate` ends on the same file
    if matches!(status.as_u16(), 400 | 415 | 422) { Usage(text).into() } else { anyhow::anyhow!("{text}") }
}
