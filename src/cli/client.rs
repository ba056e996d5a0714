//! The cell PC's side of the REST interface.

use super::{Usage, files};
use crate::http::tls;
use crate::wire::Problem;
use crate::wire::job::JobAnswer;
use anyhow::{Context, bail};
use serde_json::Value;
use std::path::{Path, PathBuf};
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
    /// The server, http://… or https://….
    #[arg(long, env = "KINCAL_SERVER", default_value = "http://127.0.0.1:8080", value_name = "URL")]
    server: String,
    /// The key; better given in the environment, where nobody sees it.
    #[arg(long, env = "KINCAL_KEY", value_name = "KEY", hide_env_values = true)]
    key: Option<String>,
    /// Certificate of the authority that signed the server's, PEM; without it, those that the system trusts.
    #[arg(long, env = "KINCAL_CA_CERT", value_name = "FILE")]
    ca_cert: Option<PathBuf>,
}

impl ServerArguments {
    /// A client of that server.
    ///
    /// # Errors
    /// As [`Client::new`].
    pub fn client(&self) -> anyhow::Result<Client> {
        Client::new(&self.server, self.key.clone(), self.ca_cert.as_deref())
    }
}

/// A server, and the key to it.
#[derive(Clone, Debug)]
pub struct Client {
    http: reqwest::Client,
    url: String,
    key: Option<String>,
}

/// The certificates in a PEM file.
fn authorities(file: &Path) -> anyhow::Result<Vec<reqwest::Certificate>> {
    let bytes = std::fs::read(file).map_err(|e| Usage(format!("cannot read {}: {e}", file.display())))?;
    let found = reqwest::Certificate::from_pem_bundle(&bytes).unwrap_or_default();
    if found.is_empty() {
        return Err(Usage(format!("{}: there is no certificate in it; a PEM file is needed", file.display())).into());
    }
    Ok(found)
}

impl Client {
    /// A client of the server at `url` (`http://HOST:PORT`), whose certificate one of those in `ca_cert` has signed; without, one that the
    /// system trusts.
    ///
    /// # Errors
    /// [`Usage`] if it is no such URL; if the HTTP client cannot be made.
    pub fn new(url: &str, key: Option<String>, ca_cert: Option<&Path>) -> anyhow::Result<Self> {
        if !reqwest::Url::parse(url).is_ok_and(|url| matches!(url.scheme(), "http" | "https") && url.has_host()) {
            let example = "such as http://127.0.0.1:8080";
            return Err(Usage(format!("--server {url}: a server's URL begins with http:// or https://, {example}")).into());
        }
        tls::use_ring();
        let http = reqwest::Client::builder().connect_timeout(Duration::from_secs(5)).no_proxy();
        let http = match ca_cert {
            Some(file) => http.tls_certs_only(authorities(file)?),
            // a machine without any certificates can still speak to its own server
            None if !url.starts_with("https:") => http.tls_certs_only([]),
            None => http,
        };
        let http = http.build().context("no HTTP client can be made")?;
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
        answer(self.with_key(request).send().await.map_err(|error| unreachable(&self.url, &error))?).await
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
        let request = self.http.get(format!("{}/v1/jobs/{job_id}/events", self.url));
        let response = self.with_key(request).send().await.map_err(|error| unreachable(&self.url, &error))?;
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
    let reason = if error.is_timeout() { "it did not answer in time".to_owned() } else { cause(error) };
    anyhow::anyhow!("the server {url} cannot be reached: {reason}; is it running, and is --server right?")
}

/// The innermost cause: a refused connection, an unknown host and a certificate that is not trusted differ only there.
fn cause(error: &dyn std::error::Error) -> String {
    let mut innermost = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    innermost.to_string()
}

/// What the server refused, and why.
#[derive(Debug, thiserror::Error)]
#[error("{}", self.in_words())]
pub struct Refused {
    status: u16,
    /// In the server's words.
    pub problem: Problem,
}

impl Refused {
    /// True where a file or an option has to be mended, as where `kincal calibrate` ends on the same file.
    pub fn is_usage(&self) -> bool {
        matches!(self.status, 400 | 415 | 422)
    }

    /// What, why, and what to do next. The detail of bad input is its first fault, which is not said twice.
    fn in_words(&self) -> String {
        let Problem { detail, code, errors, .. } = &self.problem;
        let faults: Vec<String> = errors.iter().map(|issue| files::fault(issue, None)).collect();
        let more: String = faults.iter().map(|fault| format!("\n  {fault}")).collect();
        let is_said = errors.first().is_some_and(|first| detail.starts_with(&first.in_words()));
        let text = match faults.as_slice() {
            [fault] if is_said => format!("{fault} ({code})"),
            several if is_said => format!("{} faults ({code}){more}", several.len()),
            _ => format!("{detail} ({code}){more}"),
        };
        let next = match self.status {
            401 => "\nnext: give the key with --key or in KINCAL_KEY",
            404 if detail.contains("robot") => "\nnext: kincal robots lists those that are there",
            _ => "",
        };
        text + next
    }
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

/// The problem of an answer that is no success.
async fn refused(response: reqwest::Response) -> anyhow::Error {
    let status = response.status();
    let bytes = response.bytes().await.unwrap_or_default();
    match serde_json::from_slice::<Problem>(&bytes) {
        Ok(problem) => Refused { status: status.as_u16(), problem }.into(),
        Err(_) => anyhow::anyhow!("the server answered {status}"),
    }
}

#[cfg(test)]
mod tests {
    use super::{Client, Refused};
    use crate::cli::Usage;
    use crate::wire::{Issue, Problem};

    #[test]
    fn a_server_is_named_by_its_url() {
        for wrong in ["127.0.0.1:19100", "ftp://x", "localhost:8080", "http://", ""] {
            let error = Client::new(wrong, None, None).unwrap_err();
            assert!(error.is::<Usage>() && error.to_string().contains("begins with http:// or https://"), "{wrong}: {error}");
        }
        assert!(Client::new("http://kincal.example:8443/", None, None).is_ok());
    }

    #[test]
    fn a_single_fault_is_said_once() {
        let issue = Issue { row: Some(0), detail: "row 0 has 20 cells".into(), code: "wrong_cell_count".into(), ..Issue::default() };
        let mut problem = Problem::new(422, "invalid_measurements", issue.in_words());
        problem.errors = vec![issue];
        let words = Refused { status: 422, problem }.to_string();
        assert_eq!(words, "row 0 has 20 cells (invalid_measurements)");
    }
}
