//! HTTP client of the REST interface, with retries.

use super::failure::RequestError;
use super::runtime::block_on;
use super::terminal::plain;
use super::usage::Usage;
use crate::http::tls;
use crate::wire::id::is_plausible;
use crate::wire::job_answer::JobAnswer;
use anyhow::{Context, bail};
use reqwest::Method;
use serde::Serialize;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::time::sleep;

const REQUEST_TIMEOUT: Duration = Duration::from_secs(60);
/// Maximum number of pages that are read to find a robot by its name.
const MAX_PAGES: usize = 50;
/// Maximum number of reconnects in a row while a job is followed. They take about a minute and a half; a server that restarts is back by then.
const MAX_RECONNECTS: u32 = 20;
/// Longest pause between reconnects; each pause is a second longer than the one before.
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// Longest time between two updates of a job that is followed, in seconds.
const UPDATE_EVERY_S: u32 = 1;
/// Maximum number of attempts for a request that can be repeated: a read, or a creation with an `Idempotency-Key`.
const MAX_TRIES: u32 = 5;
const NO_JSON: &str = "the server's answer is not JSON";

/// The server and the API key.
#[derive(Debug, clap::Args)]
pub struct ServerArguments {
    /// URL of the server, http://… or https://….
    #[arg(
        long,
        env = "KINCAL_SERVER",
        default_value = "http://127.0.0.1:8080",
        value_name = "URL"
    )]
    server: String,
    /// API key. Prefer the environment variable: other users cannot see it.
    #[arg(long, env = "KINCAL_KEY", value_name = "KEY", hide_env_values = true)]
    key: Option<String>,
    /// Certificate of the authority that signed the server's certificate, PEM [default: the authorities that the system trusts].
    #[arg(long, env = "KINCAL_CA_CERT", value_name = "FILE")]
    ca_cert: Option<PathBuf>,
}

impl ServerArguments {
    /// A client of that server.
    pub fn client(&self) -> anyhow::Result<Client> {
        Client::new(&self.server, self.key.clone(), self.ca_cert.as_deref())
    }

    /// Warns if several robots have this name, because commands then need the id. A key that may not list robots gets no warning.
    pub fn warn_of_duplicate_name(&self, name: &str) {
        let alike = block_on(async { self.client()?.robot_ids_named(name, "").await });
        let alike = alike.unwrap_or_default();
        if alike.len() > 1 {
            eprintln!(
                "warning (same_name): {} robots are called {}: commands take their ids ({})",
                alike.len(),
                plain(name),
                alike.join(", ")
            );
        }
    }

    /// [`Client::get`] for a command that sends a single request.
    pub fn get(&self, path: &str) -> anyhow::Result<Value> {
        block_on(async { self.client()?.get(path).await })
    }

    /// [`Client::read`] for a command that sends a single request.
    pub fn read(&self, path: &str) -> anyhow::Result<Vec<u8>> {
        block_on(async { self.client()?.read(path).await })
    }

    /// [`Client::send`] with POST, for a command that sends a single request.
    pub fn post(&self, path: &str, body: &impl Serialize) -> anyhow::Result<Value> {
        block_on(async { self.client()?.send(Method::POST, path, body).await })
    }
}

/// Client of one server.
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
    /// A client of the server at `url` (`http://HOST:PORT`). It trusts the authorities in `ca_cert`; by default those that the system trusts.
    ///
    /// # Errors
    /// [`Usage`] for another kind of URL; if the HTTP client cannot be made.
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
            // Plain HTTP needs no certificates, so it also works on a machine that has none.
            None if !url.starts_with("https:") => http.tls_certs_only([]),
            None => http,
        };
        let http = http.build().with_context(|| match ca_cert {
            // No certificate authority is installed on this machine.
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

    /// GET with a JSON answer.
    ///
    /// # Errors
    /// If the connection fails, or the server answers with a problem; the message has the problem's text.
    pub async fn get(&self, path: &str) -> anyhow::Result<Value> {
        json(&self.read(path).await?)
    }

    /// GET with an answer in any format, repeated while the server is busy, and if the connection is lost. A server that cannot be reached is an error
    /// immediately, because a person is waiting.
    pub async fn read(&self, path: &str) -> anyhow::Result<Vec<u8>> {
        let mut attempt = 0;
        loop {
            attempt += 1;
            match self
                .answer(self.http.get(format!("{}{path}", self.url)))
                .await
            {
                Ok(bytes) => return Ok(bytes),
                Err(failed @ RequestError::Unreachable(_)) => return Err(failed.into()),
                Err(failed) => match failed.retry_after().filter(|_| attempt < MAX_TRIES) {
                    Some(after) => sleep(after).await,
                    None => return Err(failed.into()),
                },
            }
        }
    }

    /// Sends one request and reads the whole answer.
    async fn answer(&self, request: reqwest::RequestBuilder) -> Result<Vec<u8>, RequestError> {
        let response = self
            .with_key(request)
            .timeout(REQUEST_TIMEOUT)
            .send()
            .await
            .map_err(|error| RequestError::sending(&self.url, &error))?;
        let (status, headers) = (response.status(), response.headers().clone());
        let body = response
            .bytes()
            .await
            .map_err(|error| RequestError::reading(&self.url, &error))?;
        if status.is_success() {
            Ok(body.to_vec())
        } else {
            Err(RequestError::answer(status.as_u16(), &headers, &body))
        }
    }

    /// The id of the robot with this id, name or serial number.
    ///
    /// # Errors
    /// As [`Self::get`]; [`Usage`] if there is no such robot, or several.
    pub async fn robot_id(&self, named: &str) -> anyhow::Result<String> {
        if named.starts_with("rob_") && is_plausible(named) {
            return Ok(named.into());
        }
        let mut matching = self.robot_ids_named(named, "").await?;
        if matching.is_empty() {
            matching = self.robot_ids_named(named, "&archived=true").await?;
        }
        match matching.as_slice() {
            [id] => Ok(id.clone()),
            [] => Err(Usage(format!(
                "no robot is called {named:?}; `kincal robots` lists those that are there"
            ))
            .into()),
            several => Err(Usage(format!(
                "several robots are called {named:?}: name one by its id, in place of {named:?}: {}",
                several.join(", ")
            ))
            .into()),
        }
    }

    /// Ids of the robots with this name or serial number.
    async fn robot_ids_named(&self, named: &str, filter: &str) -> anyhow::Result<Vec<String>> {
        let mut matching = Vec::new();
        let mut cursor = String::new();
        for _ in 0..MAX_PAGES {
            let page = self
                .get(&format!("/v1/robots?limit=200{filter}{cursor}"))
                .await?;
            let items = page["items"].as_array().into_iter().flatten();
            let matches = items.filter(|robot| {
                [&robot["name"], &robot["serial_number"]]
                    .into_iter()
                    .any(|field| field == named)
            });
            matching.extend(matches.filter_map(|robot| robot["id"].as_str().map(String::from)));
            match page["next_cursor"].as_str() {
                Some(next) => cursor = format!("&cursor={next}"),
                None => break,
            }
        }
        Ok(matching)
    }

    /// POST of a body with this content type and a JSON answer.
    pub async fn post(
        &self,
        path: &str,
        content_type: &str,
        body: Vec<u8>,
    ) -> anyhow::Result<Value> {
        json(&self.write(Method::POST, path, content_type, body).await?)
    }

    /// Request with a JSON body and a JSON answer.
    pub async fn send(
        &self,
        method: Method,
        path: &str,
        body: &impl Serialize,
    ) -> anyhow::Result<Value> {
        let body = serde_json::to_vec(body)?;
        json(&self.write(method, path, "application/json", body).await?)
    }

    /// Request with a body and an answer in any format. Retries send the same `Idempotency-Key`, so it takes effect once; routes that store nothing
    /// ignore the key.
    pub async fn write(
        &self,
        method: Method,
        path: &str,
        content_type: &str,
        body: Vec<u8>,
    ) -> anyhow::Result<Vec<u8>> {
        let key = uuid::Uuid::now_v7().simple().to_string();
        let mut attempt = 0;
        loop {
            attempt += 1;
            let request = self
                .http
                .request(method.clone(), format!("{}{path}", self.url));
            let request = request
                .header("content-type", content_type)
                .header("idempotency-key", &key)
                .body(body.clone());
            match self.answer(request).await {
                Ok(bytes) => return Ok(bytes),
                Err(failed) => match failed.retry_after().filter(|_| attempt < MAX_TRIES) {
                    Some(after) => sleep(after).await,
                    None => return Err(failed.into()),
                },
            }
        }
    }

    /// Follows a job until it ends.
    ///
    /// # Errors
    /// As [`Self::get`], and if the job does not succeed.
    pub async fn follow(
        &self,
        job_id: &str,
        mut on_update: impl FnMut(&JobAnswer),
    ) -> anyhow::Result<JobAnswer> {
        let url = format!("{}/v1/jobs/{job_id}?wait_s={UPDATE_EVERY_S}", self.url);
        let mut n_lost = 0;
        loop {
            let failed = match self.answer(self.http.get(&url)).await {
                Ok(bytes) => {
                    n_lost = 0;
                    let job: JobAnswer = serde_json::from_slice(&bytes).context(NO_JSON)?;
                    on_update(&job);
                    if job.status.is_over() {
                        return succeeded(job);
                    }
                    continue;
                }
                Err(failed) => failed,
            };
            n_lost += 1;
            let Some(after) = failed.retry_after() else {
                return Err(failed.into());
            };
            if n_lost > MAX_RECONNECTS {
                let later = format!(
                    "the job goes on without this command; ask for it later with kincal jobs {job_id}"
                );
                return Err(anyhow::Error::from(failed).context(format!(
                    "job {job_id}: the connection was lost, and {MAX_RECONNECTS} attempts to reconnect failed; {later}"
                )));
            }
            sleep(after.max(Duration::from_secs(n_lost.into()).min(LONGEST_PAUSE))).await;
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

fn json(bytes: &[u8]) -> anyhow::Result<Value> {
    serde_json::from_slice(bytes).context(NO_JSON)
}

#[cfg(test)]
mod tests {
    use super::Client;
    use crate::cli::usage::Usage;

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
