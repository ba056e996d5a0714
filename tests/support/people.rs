//! Users of one server, each with a key.
#![allow(dead_code)] // each test binary uses its part

use super::app::{Answer, TestApp};
use kincal::config::ServeConfig;
use kincal::http::auth::new_key;
use kincal::store::{NewApiKey, api_keys};
use reqwest::Method;
use serde_json::{Value, json};

/// A server that requires keys, and its data directory, which must live as long as the server.
pub async fn guarded(workers: usize) -> (TestApp, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let config = ServeConfig {
        no_auth: false,
        ..ServeConfig::loopback(dir.path().join("data"), workers)
    };
    (TestApp::with_config(config).await, dir)
}

/// Makes a key. Returns it and its id.
pub async fn key(app: &TestApp, scopes: &[&str], robots: Option<Vec<&str>>) -> (String, String) {
    let key = new_key().unwrap();
    let robots_json = robots.map(|robots| json!(robots).to_string());
    let new = NewApiKey {
        name: "test".into(),
        key_sha256: key.sha256,
        scopes_json: json!(scopes).to_string(),
        robots_json,
    };
    let mut tx = app.server.store.begin().await.unwrap();
    let row = api_keys::insert(&mut tx, &new).await.unwrap();
    tx.commit().await.unwrap();
    (key.text, row.id)
}

/// Revokes the key with this id.
pub async fn revoke(app: &TestApp, id: &str) {
    let mut tx = app.server.store.begin().await.unwrap();
    api_keys::revoke(&mut tx, id).await.unwrap();
    tx.commit().await.unwrap();
}

/// Sends a request with this key and a JSON body.
pub async fn with_key(
    app: &TestApp,
    method: Method,
    path: &str,
    key: &str,
    body: Vec<u8>,
) -> Answer {
    Answer::of(
        app.request(method, path)
            .bearer_auth(key)
            .header("content-type", "application/json")
            .body(body),
    )
    .await
}

/// A user with a key.
pub struct Person<'a> {
    pub app: &'a TestApp,
    pub key: String,
    pub id: String,
}

impl<'a> Person<'a> {
    pub async fn new(app: &'a TestApp, scopes: &[&str]) -> Self {
        let (key, id) = key(app, scopes, None).await;
        Self { app, key, id }
    }

    pub async fn send(
        &self,
        method: Method,
        path: &str,
        content_type: &str,
        body: impl Into<reqwest::Body>,
    ) -> Answer {
        Answer::of(
            self.app
                .request(method, path)
                .bearer_auth(&self.key)
                .header("content-type", content_type)
                .body(body),
        )
        .await
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.send(Method::GET, path, "", "").await
    }

    pub async fn post(&self, path: &str, body: &Value) -> Answer {
        self.send(Method::POST, path, "application/json", body.to_string())
            .await
    }

    pub async fn put(&self, path: &str, body: &Value) -> Answer {
        self.send(Method::PUT, path, "application/json", body.to_string())
            .await
    }

    /// Uploads CSV in the base frame. Returns the set's summary.
    pub async fn upload(&self, robot: &str, csv: &str) -> Value {
        self.send(
            Method::POST,
            &format!("{robot}/measurement-sets?frame=base"),
            "text/csv",
            csv.to_owned(),
        )
        .await
        .ok(201)
    }

    /// Posts a job and waits for its success.
    pub async fn job(&self, robot: &str, request: &Value) -> Value {
        let mut job = self.post(&format!("{robot}/jobs"), request).await.ok(202);
        while ["queued", "running"].contains(&job["status"].as_str().unwrap()) {
            job = self
                .get(&format!(
                    "/v1/jobs/{}?wait_s=30",
                    job["id"].as_str().unwrap()
                ))
                .await
                .ok(200);
        }
        assert_eq!(job["status"], "succeeded", "{job}");
        job
    }
}
