//! The cell PC's side of the REST interface.

use super::failure::Failed;
use super::usage::Usage;
use crate::http::tls;
use crate::wire::job::JobAnswer;
use anyhow::{Context, bail};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::time::{sleep, timeout};
use tokio_stream::{Stream, StreamExt};

/// A request that is not answered in this time is given up.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(60);
/// Robots are looked up by name on at most so many pages.
const MAX_PAGES: usize = 50;
/// A connection that ends before the job does is made anew at most this often in a row: about a minute and a half, in which a server that was
/// restarted is there again.
const MAX_RECONNECTS: u32 = 20;
/// Each time it is waited a second longer, up to this.
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// The server sends a comment every 15 s: one that is silent for three times as long has gone without a word.
const SILENCE: Duration = Duration::from_secs(45);
/// What may be sent again is sent at most this often: what only reads, and what creates under the same Idempotency-Key.
const MAX_TRIES: u32 = 5;

/// Where the server is, and the key to it.
#[derive(Debug, clap::Args)]
pub struct ServerArguments {
    /// The server, http://… or https://….
    #[arg(
        long,
        env = "KINCAL_SERVER",
        default_value = "http://127.0.0.1:8080",
        value_name = "URL"
    )]
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
    let bytes =
        std::fs::read(file).map_err(|e| Usage(format!("cannot read {}: {e}", file.display())))?;
    let found = reqwest::Certificate::from_pem_bundle(&bytes).unwrap_or_default();
    if found.is_empty() {
        return Err(Usage(format!(
            "{}: there is no certificate in it; a PEM file is needed",
            file.display()
        ))
        .into());
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
        if !reqwest::Url::parse(url)
            .is_ok_and(|url| matches!(url.scheme(), "http" | "https") && url.has_host())
        {
            let example = "such as http://127.0.0.1:8080";
            return Err(Usage(format!(
                "--server {url}: a server's URL begins with http:// or https://, {example}"
            ))
            .into());
        }
        tls::use_ring();
        let http = reqwest::Client::builder()
            .connect_timeout(Duration::from_secs(5))
            .no_proxy();
        let http = match ca_cert {
            Some(file) => http.tls_certs_only(authorities(file)?),
            // a machine without any certificates can still speak to its own server
            None if !url.starts_with("https:") => http.tls_certs_only([]),
            None => http,
        };
        let http = http.build().with_context(|| match ca_cert {
            // a machine that trusts no authority at all gets no further than here
            None if url.starts_with("https:") => {
                "no certificate can be checked; next: give the server's authority by --ca-cert FILE or KINCAL_CA_CERT"
            }
            _ => "no HTTP client can be made",
        })?;
        Ok(Self {
            http,
            url: url.trim_end_matches('/').into(),
            key,
        })
    }

    /// GET, answered in JSON.
    ///
    /// # Errors
    /// The connection, or the server's problem in words.
    pub async fn get(&self, path: &str) -> anyhow::Result<Value> {
        json(&self.read(path).await?)
    }

    /// GET of text.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub async fn get_text(&self, path: &str) -> anyhow::Result<String> {
        Ok(String::from_utf8_lossy(&self.read(path).await?).into_owned())
    }

    /// GET, again where the server is busy. One that is not there is said at once: a person is waiting.
    async fn read(&self, path: &str) -> anyhow::Result<Vec<u8>> {
        let mut attempt = 0;
        loop {
            attempt += 1;
            match self
                .answer(self.http.get(format!("{}{path}", self.url)))
                .await
            {
                Ok(bytes) => return Ok(bytes),
                Err(Failed::Busy(after, _)) if attempt < MAX_TRIES => sleep(after).await,
                Err(failed) => return Err(failed.into()),
            }
        }
    }

    /// One request, and its answer as a whole.
    async fn answer(&self, request: reqwest::RequestBuilder) -> Result<Vec<u8>, Failed> {
        let response = self
            .with_key(request)
            .timeout(REQUEST_TIMEOUT)
            .send()
            .await
            .map_err(|error| Failed::sending(&self.url, &error))?;
        let (status, headers) = (response.status(), response.headers().clone());
        let body = response
            .bytes()
            .await
            .map_err(|error| Failed::reading(&self.url, &error))?;
        if status.is_success() {
            Ok(body.to_vec())
        } else {
            Err(Failed::answer(status.as_u16(), &headers, &body))
        }
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
            let fits = items.filter(|robot| {
                [&robot["name"], &robot["serial_number"]]
                    .into_iter()
                    .any(|field| field == named)
            });
            called.extend(fits.filter_map(|robot| robot["id"].as_str().map(String::from)));
            match page["next_cursor"].as_str() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => break,
            }
        }
        match called.as_slice() {
            [id] => Ok(id.clone()),
            [] => Err(Usage(format!(
                "no robot is called {named:?}; `kincal robots` lists those that are there"
            ))
            .into()),
            several => Err(Usage(format!(
                "several robots are called {named:?}: give --robot one of {}",
                several.join(", ")
            ))
            .into()),
        }
    }

    /// POST of a body of some content type, answered in JSON.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub async fn post(
        &self,
        path: &str,
        content_type: &str,
        body: Vec<u8>,
    ) -> anyhow::Result<Value> {
        let request = self
            .http
            .post(format!("{}{path}", self.url))
            .header("content-type", content_type)
            .body(body);
        json(&self.answer(request).await?)
    }

    /// POST that creates, once however often it has to be sent.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub async fn create(
        &self,
        path: &str,
        content_type: &str,
        body: Vec<u8>,
    ) -> anyhow::Result<Value> {
        let key = uuid::Uuid::now_v7().simple().to_string();
        let mut attempt = 0;
        loop {
            attempt += 1;
            let request = self.http.post(format!("{}{path}", self.url));
            let request = request
                .header("content-type", content_type)
                .header("idempotency-key", &key)
                .body(body.clone());
            match self.answer(request).await {
                Ok(bytes) => return json(&bytes),
                Err(failed) => match failed.again_after().filter(|_| attempt < MAX_TRIES) {
                    Some(after) => sleep(after).await,
                    None => return Err(failed.into()),
                },
            }
        }
    }

    /// POST of JSON.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub async fn post_json(&self, path: &str, body: &Value) -> anyhow::Result<Value> {
        self.post(path, "application/json", serde_json::to_vec(body)?)
            .await
    }

    /// Follows a job by its events to its end.
    ///
    /// # Errors
    /// As [`Self::get`], and if the job does not succeed.
    pub async fn follow(
        &self,
        job_id: &str,
        mut moved: impl FnMut(&JobAnswer),
    ) -> anyhow::Result<JobAnswer> {
        let mut lost = 0;
        loop {
            let mut heard = false;
            let told = |job: &JobAnswer| {
                heard = true;
                moved(job);
            };
            let failed = match self.events(job_id, told).await {
                Ok(job) => return succeeded(job),
                Err(failed) => failed,
            };
            lost = if heard { 1 } else { lost + 1 };
            let Some(after) = failed.again_after() else {
                return Err(failed.into());
            };
            if lost > MAX_RECONNECTS {
                let later = format!(
                    "the job goes on without this command; ask for it later with kincal jobs {job_id}"
                );
                return Err(anyhow::Error::from(failed).context(format!(
                    "job {job_id}: the connection was lost, and {MAX_RECONNECTS} attempts at another came to nothing; {later}"
                )));
            }
            sleep(after.max(Duration::from_secs(lost.into()).min(LONGEST_PAUSE))).await;
        }
    }

    /// One connection's events, to the one that says that the job is over.
    async fn events(
        &self,
        job_id: &str,
        mut moved: impl FnMut(&JobAnswer),
    ) -> Result<JobAnswer, Failed> {
        let request = self.with_key(
            self.http
                .get(format!("{}/v1/jobs/{job_id}/events", self.url)),
        );
        let response = timeout(SILENCE, request.send())
            .await
            .map_err(|_| silent())?
            .map_err(|error| Failed::sending(&self.url, &error))?;
        if !response.status().is_success() {
            let (status, headers) = (response.status().as_u16(), response.headers().clone());
            let body = timeout(SILENCE, response.bytes())
                .await
                .map_err(|_| silent())?
                .map_err(|error| Failed::reading(&self.url, &error))?;
            return Err(Failed::answer(status, &headers, &body));
        }
        let mut stream = response.bytes_stream();
        let mut text = Vec::new();
        loop {
            text.extend_from_slice(&piece(&mut stream, SILENCE).await?);
            while let Some(end) = text.windows(2).position(|w| w == b"\n\n") {
                let event: Vec<u8> = text.drain(..end + 2).collect();
                let Some((name, job)) = parse_event(&event) else {
                    continue;
                };
                moved(&job);
                if name == "finished" {
                    return Ok(job);
                }
            }
        }
    }

    fn with_key(&self, request: reqwest::RequestBuilder) -> reqwest::RequestBuilder {
        match &self.key {
            Some(key) => request.bearer_auth(key),
            None => request,
        }
    }
}

fn succeeded(job: JobAnswer) -> anyhow::Result<JobAnswer> {
    let status = serde_json::to_value(job.status)?;
    if status == "succeeded" {
        return Ok(job);
    }
    let reason = job
        .error
        .as_ref()
        .map_or(String::new(), |e| format!(": {} ({})", e.detail, e.code));
    bail!(
        "job {} is {}{reason}",
        job.id,
        status.as_str().unwrap_or("over")
    )
}

/// What a stream brings next. One that ends or falls silent is lost: a host that vanishes says nothing at all.
async fn piece<T>(
    stream: &mut (impl Stream<Item = reqwest::Result<T>> + Unpin),
    silence: Duration,
) -> Result<T, Failed> {
    match timeout(silence, stream.next()).await {
        Ok(Some(Ok(piece))) => Ok(piece),
        Ok(_) => Err(Failed::Lost(anyhow::anyhow!(
            "the events ended before the job did"
        ))),
        Err(_) => Err(silent()),
    }
}

fn silent() -> Failed {
    Failed::Lost(anyhow::anyhow!(
        "nothing came from the server for {} s",
        SILENCE.as_secs()
    ))
}

fn json(bytes: &[u8]) -> anyhow::Result<Value> {
    serde_json::from_slice(bytes).context("the server's answer is not JSON")
}

/// Name and job of one server-sent event; nothing for a comment.
fn parse_event(event: &[u8]) -> Option<(String, JobAnswer)> {
    let text = std::str::from_utf8(event).ok()?;
    let field = |name: &str| {
        text.lines()
            .find_map(|line| line.strip_prefix(name))
            .map(str::trim)
    };
    Some((
        field("event:")?.to_string(),
        serde_json::from_str(field("data:")?).ok()?,
    ))
}

#[cfg(test)]
mod tests {
    use super::{Client, piece};
    use crate::cli::failure::Failed;
    use crate::cli::usage::Usage;
    use std::time::Duration;

    #[tokio::test]
    async fn a_host_that_vanishes_is_noticed_and_may_come_back() {
        let mut silent = tokio_stream::pending::<reqwest::Result<u8>>();
        let said = piece(&mut silent, Duration::from_millis(10)).await;
        assert!(matches!(said, Err(Failed::Lost(_))), "{said:?}");
        let mut closed = tokio_stream::empty::<reqwest::Result<u8>>();
        let said = piece(&mut closed, Duration::from_millis(10)).await;
        assert!(matches!(said, Err(Failed::Lost(_))), "{said:?}");
    }

    #[test]
    fn a_server_is_named_by_its_url() {
        for wrong in [
            "127.0.0.1:19100",
            "ftp://x",
            "localhost:8080",
            "http://",
            "",
        ] {
            let error = Client::new(wrong, None, None).unwrap_err();
            assert!(
                error.is::<Usage>()
                    && error
                        .to_string()
                        .contains("begins with http:// or https://"),
                "{wrong}: {error}"
            );
        }
        assert!(Client::new("http://kincal.example:8443/", None, None).is_ok());
    }
}
