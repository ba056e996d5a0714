//! Load generator: uploaders that record which requests were acknowledged.

use crate::data::paper_path;
use crate::process::{Server, run};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

pub const UPLOADERS: usize = 8;
/// Timeout of a client; nothing takes that long while the server is alive.
const PATIENCE: Duration = Duration::from_secs(60);

/// An upload and its answer.
#[derive(Clone, Debug)]
pub struct Upload {
    pub key: String,
    pub body: String,
    /// Its id and the time of the acknowledgement.
    pub acknowledged: Option<(String, SystemTime)>,
}

/// Requests of all uploaders.
#[derive(Default)]
pub struct Ledger {
    pub uploads: Vec<Upload>,
    /// Jobs that were accepted.
    pub jobs: Vec<String>,
    /// Statuses of answers other than success.
    pub refusals: Vec<u16>,
}

pub struct Load {
    pub ledger: Arc<Mutex<Ledger>>,
    runtime: tokio::runtime::Runtime,
    serial: Arc<AtomicUsize>,
}

/// The paper's set with small changes, so that the bytes of each upload are different.
pub fn body(serial: usize) -> String {
    let text = std::fs::read_to_string(paper_path("first.csv")).unwrap();
    let mut lines: Vec<&str> = text.lines().take(61).collect();
    let label = format!("upload {serial},{}", lines[1].split_once(',').unwrap().1);
    lines[1] = &label;
    lines.join("\n") + "\n"
}

impl Load {
    pub fn new() -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .unwrap();
        Self {
            ledger: Arc::default(),
            runtime,
            serial: Arc::default(),
        }
    }

    /// Runs the uploaders against a server until `work` returns or the connections fail. Every eighth upload gets a calibration job.
    pub fn during<T>(&self, url: &str, robot: &str, work: impl FnOnce() -> T) -> T {
        let stop = Arc::new(AtomicBool::new(false));
        let tasks: Vec<_> = (0..UPLOADERS)
            .map(|_| self.runtime.spawn(self.uploader(url, robot, &stop)))
            .collect();
        let done = work();
        stop.store(true, Ordering::Relaxed);
        self.runtime.block_on(async {
            for task in tasks {
                task.await.unwrap();
            }
        });
        done
    }

    fn uploader(
        &self,
        url: &str,
        robot: &str,
        stop: &Arc<AtomicBool>,
    ) -> impl Future<Output = ()> + Send + 'static {
        let (url, robot, stop) = (url.to_owned(), robot.to_owned(), Arc::clone(stop));
        let (ledger, serial) = (Arc::clone(&self.ledger), Arc::clone(&self.serial));
        let client = client();
        async move {
            while !stop.load(Ordering::Relaxed) {
                let n = serial.fetch_add(1, Ordering::Relaxed);
                let mut upload = Upload {
                    key: format!("upload-{n}"),
                    body: body(n),
                    acknowledged: None,
                };
                let alive = upload.send(&client, &url, &robot, &ledger).await;
                let id = upload.acknowledged.as_ref().map(|(id, _)| id.clone());
                ledger.lock().unwrap().uploads.push(upload);
                if !alive {
                    return;
                }
                if let Some(id) = id.filter(|_| n.is_multiple_of(8)) {
                    let request = json!({"measurement_set_id": id, "method": "least_squares", "verify": {"source": "fraction", "fraction": 0.4}});
                    let posted = client
                        .post(format!("{url}/v1/robots/{robot}/jobs"))
                        .json(&request)
                        .send()
                        .await;
                    let Ok(answer) = posted else { return };
                    let status = answer.status().as_u16();
                    let Ok(job) = answer.json::<Value>().await else {
                        return;
                    };
                    match job["id"].as_str() {
                        Some(id) => ledger.lock().unwrap().jobs.push(id.to_owned()),
                        None => ledger.lock().unwrap().refusals.push(status),
                    }
                }
            }
        }
    }

    /// Repeats every unanswered request under its idempotency key; each must be answered now.
    pub fn retry(&self, url: &str, robot: &str) {
        let mut uploads = std::mem::take(&mut self.ledger.lock().unwrap().uploads);
        self.runtime.block_on(async {
            let client = client();
            for upload in uploads
                .iter_mut()
                .filter(|upload| upload.acknowledged.is_none())
            {
                upload.send(&client, url, robot, &self.ledger).await;
                assert!(
                    upload.acknowledged.is_some(),
                    "{}: a retry is refused: {:?}",
                    upload.key,
                    self.ledger.lock().unwrap().refusals
                );
            }
        });
        self.ledger.lock().unwrap().uploads = uploads;
    }
}

fn client() -> reqwest::Client {
    reqwest::Client::builder()
        .no_proxy()
        .timeout(PATIENCE)
        .build()
        .unwrap()
}

impl Upload {
    /// True if the server answered.
    async fn send(
        &mut self,
        client: &reqwest::Client,
        url: &str,
        robot: &str,
        ledger: &Arc<Mutex<Ledger>>,
    ) -> bool {
        let request = client.post(format!(
            "{url}/v1/robots/{robot}/measurement-sets?frame=base"
        ));
        let request = request
            .header("content-type", "text/csv")
            .header("idempotency-key", &self.key)
            .body(self.body.clone());
        let Ok(answer) = request.send().await else {
            return false;
        };
        let status = answer.status().as_u16();
        let Ok(answer) = answer.json::<Value>().await else {
            return false;
        };
        if status == 201 {
            self.acknowledged =
                Some((answer["id"].as_str().unwrap().to_owned(), SystemTime::now()));
        } else {
            ledger.lock().unwrap().refusals.push(status);
        }
        true
    }
}

/// Checks that everything acknowledged is stored once and bit for bit, that all jobs end, and that `verify-store` passes. Ends the server.
pub fn all_is_well(server: Server, robot: &str, data_dir: &Path, ledger: &Ledger) {
    for job in &ledger.jobs {
        let end = server.finished(job);
        assert_eq!(end["status"], "succeeded", "{end}");
    }
    let mut stored = Vec::new();
    let mut cursor = String::new();
    loop {
        let (_, page) = server.get(&format!(
            "/v1/robots/{robot}/measurement-sets?limit=200{cursor}"
        ));
        let items = page["items"].as_array().unwrap();
        stored.extend(items.iter().map(|set| {
            (
                set["id"].as_str().unwrap().to_owned(),
                set["sha256"].as_str().unwrap().to_owned(),
            )
        }));
        let Some(next) = page["next_cursor"].as_str() else {
            break;
        };
        cursor = format!("&cursor={next}");
    }
    let acknowledged = ledger
        .uploads
        .iter()
        .filter_map(|upload| Some((upload, &upload.acknowledged.as_ref()?.0)));
    let mut expected: Vec<(String, String)> = acknowledged
        .map(|(upload, id)| {
            (
                id.clone(),
                kincal::wire::canonical::sha256_hex(upload.body.as_bytes()),
            )
        })
        .collect();
    stored.sort();
    expected.sort();
    assert_eq!(
        stored.len(),
        expected.len(),
        "as many sets are stored as were acknowledged"
    );
    assert_eq!(stored, expected);
    let (status, _) = server.terminate();
    assert!(status.success(), "{status}");
    keeps_its_promises(data_dir);
}

/// Runs `kincal verify-store` on a database without a server.
#[track_caller]
pub fn keeps_its_promises(data_dir: &Path) {
    let checked = run(&["verify-store", "--data-dir", data_dir.to_str().unwrap()]);
    assert!(
        checked.status.success(),
        "{}{}",
        String::from_utf8_lossy(&checked.stdout),
        String::from_utf8_lossy(&checked.stderr)
    );
}
