//! TLS, with certificates made for each test and `curl` as a client that checks them.

use crate::app::TestApp;
use crate::raw::Raw;
use kincal::config::{LimitsConfig, ServeConfig, TlsConfig};
use kincal::http::server;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Exit code of curl for a certificate that it cannot verify.
const NOT_VOUCHED_FOR: i32 = 60;

/// Makes a self-signed certificate for 127.0.0.1 and its key, as in docs/operations.md.
fn certificate(dir: &Path, name: &str) -> TlsConfig {
    certificate_of(
        dir,
        name,
        "subjectAltName=IP:127.0.0.1",
        "basicConstraints=critical,CA:FALSE",
    )
}

fn certificate_of(dir: &Path, name: &str, names: &str, constraints: &str) -> TlsConfig {
    let [certificate, key] = ["crt", "key"].map(|ending| dir.join(format!("{name}.{ending}")));
    let mut openssl = Command::new("openssl");
    openssl.args([
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "2",
    ]);
    openssl.args([
        "-subj",
        "/CN=kincal test",
        "-addext",
        names,
        "-addext",
        constraints,
    ]);
    let made = openssl
        .arg("-keyout")
        .arg(&key)
        .arg("-out")
        .arg(&certificate)
        .output()
        .expect("openssl is installed");
    assert!(
        made.status.success(),
        "{}",
        String::from_utf8_lossy(&made.stderr)
    );
    TlsConfig {
        tls_cert: Some(certificate),
        tls_key: Some(key),
        insecure_http: false,
    }
}

/// Starts a server with TLS. Returns it, the file of its certificate, and the temporary folder.
async fn server() -> (TestApp, PathBuf, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let tls = certificate(dir.path(), "server");
    server_with(tls, dir).await
}

async fn server_with(
    tls: TlsConfig,
    dir: tempfile::TempDir,
) -> (TestApp, PathBuf, tempfile::TempDir) {
    let certificate = tls.tls_cert.clone().unwrap();
    let limits = LimitsConfig {
        client_timeout_s: 2,
        ..LimitsConfig::default()
    };
    let config = ServeConfig {
        tls,
        limits,
        ..ServeConfig::loopback(dir.path().join("data"), 0)
    };
    (TestApp::with_config(config).await, certificate, dir)
}

/// Runs a blocking command without blocking the server, which shares this thread's runtime.
async fn curl(arguments: Vec<String>) -> Output {
    let mut command = Command::new("curl");
    command
        .args([
            "--silent",
            "--show-error",
            "--noproxy",
            "*",
            "--max-time",
            "60",
        ])
        .args(arguments);
    tokio::task::spawn_blocking(move || command.output().expect("curl is installed"))
        .await
        .unwrap()
}

async fn get(app: &TestApp, path: &str, trusted: &Path, more: &[&str]) -> Output {
    let url = format!("{}{path}", app.server.url());
    let arguments = ["--fail", "--cacert", trusted.to_str().unwrap(), &url];
    curl(
        arguments
            .iter()
            .chain(more)
            .map(|text| (*text).to_owned())
            .collect(),
    )
    .await
}

#[tokio::test]
async fn requests_are_answered_over_tls_to_clients_that_check_the_certificate() {
    let (app, certificate, _dir) = server().await;
    assert!(
        app.server.url().starts_with("https://"),
        "{}",
        app.server.url()
    );
    for version in [&["--tlsv1.3"][..], &["--tls-max", "1.2"]] {
        let health = get(&app, "/healthz", &certificate, version).await;
        assert!(
            health.status.success(),
            "{version:?}: {}",
            String::from_utf8_lossy(&health.stderr)
        );
    }
    let robot = format!("{}/data/paper/robot.json", env!("CARGO_MANIFEST_DIR"));
    let body = format!("@{robot}");
    let post = get(
        &app,
        "/v1/robots",
        &certificate,
        &[
            "--header",
            "content-type: application/json",
            "--data-binary",
            &body,
        ],
    )
    .await;
    let stored: serde_json::Value = serde_json::from_slice(&post.stdout).unwrap();
    let read = get(
        &app,
        &format!("/v1/robots/{}", stored["id"].as_str().unwrap()),
        &certificate,
        &[],
    )
    .await;
    assert_eq!(
        serde_json::from_slice::<serde_json::Value>(&read.stdout).unwrap(),
        stored
    );
}

#[tokio::test]
async fn another_certificate_is_not_taken_for_the_servers() {
    let (app, _, dir) = server().await;
    let other = certificate(dir.path(), "other").tls_cert.unwrap();
    let refused = get(&app, "/healthz", &other, &[]).await;
    assert_eq!(
        refused.status.code(),
        Some(NOT_VOUCHED_FOR),
        "{}",
        String::from_utf8_lossy(&refused.stderr)
    );
}

/// Runs the command line without the certificates that this machine trusts.
async fn kincal(
    app: &TestApp,
    arguments: &[&str],
    variables: &[(&str, &Path)],
) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_kincal"));
    command
        .args(["robots", "--server", &app.server.url()])
        .args(arguments)
        .env("SSL_CERT_FILE", "/dev/null")
        .env_remove("SSL_CERT_DIR");
    command.envs(variables.iter().copied());
    let output = tokio::task::spawn_blocking(move || command.output().expect("the binary runs"))
        .await
        .unwrap();
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_speaks_tls_and_checks_who_is_there() {
    let (app, trusted, dir) = server().await;
    let other = certificate(dir.path(), "other").tls_cert.unwrap();
    let output = kincal(&app, &["--ca-cert", trusted.to_str().unwrap()], &[]).await;
    assert_eq!(output, (Some(0), String::new()));
    let output = kincal(&app, &[], &[("SSL_CERT_FILE", &trusted)]).await;
    assert_eq!(
        output,
        (Some(0), String::new()),
        "one that the system trusts"
    );
    for arguments in [vec![], vec!["--ca-cert", other.to_str().unwrap()]] {
        let (code, complaints) = kincal(&app, &arguments, &[]).await;
        assert_eq!(code, Some(1), "{arguments:?}: {complaints}");
        // With other system certificates, or none at all.
        let reason = if arguments.is_empty() {
            "no certificate can be checked"
        } else {
            "is not trusted"
        };
        assert!(
            complaints.contains(reason)
                && complaints.contains("by --ca-cert FILE or KINCAL_CA_CERT"),
            "{arguments:?}: {complaints}"
        );
    }
    let none = dir.path().join("data");
    let (code, complaints) = kincal(&app, &["--ca-cert", none.to_str().unwrap()], &[]).await;
    assert_eq!(code, Some(2), "{complaints}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_certificate_that_is_refused_says_what_to_do_about_it() {
    let (ours, others) = (
        "subjectAltName=IP:127.0.0.1",
        "subjectAltName=DNS:cell-4.example",
    );
    let (server_s, authority_s) = (
        "basicConstraints=critical,CA:FALSE",
        "basicConstraints=critical,CA:TRUE",
    );
    for (names, constraints, advice) in [
        (
            ours,
            authority_s,
            "make one for the server with basicConstraints=CA:FALSE",
        ),
        (
            others,
            server_s,
            "name the server in --server as its certificate does",
        ),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let tls = certificate_of(dir.path(), "server", names, constraints);
        let (app, trusted, _dir) = server_with(tls, dir).await;
        let (code, complaints) = kincal(&app, &["--ca-cert", trusted.to_str().unwrap()], &[]).await;
        assert_eq!(code, Some(1), "{complaints}");
        assert!(
            complaints.contains("is not trusted") && complaints.contains(advice),
            "{complaints}"
        );
        assert_eq!(
            complaints.contains("cell-4.example"),
            names == others,
            "whose name it has: {complaints}"
        );
    }
}

#[tokio::test]
async fn browsers_are_told_to_come_by_tls_again() {
    let (app, certificate, _dir) = server().await;
    for path in ["/", "/healthz", "/v1/robots", "/nowhere"] {
        let url = format!("{}{path}", app.server.url());
        let trusted = certificate.to_str().unwrap();
        let arguments = ["--include", "--cacert", trusted, &url];
        let output = curl(arguments.map(str::to_owned).to_vec()).await.stdout;
        let output = String::from_utf8(output).unwrap().to_lowercase();
        assert!(
            output.contains("strict-transport-security: max-age=31536000\r\n"),
            "{path}: {output}"
        );
    }
    let plain = TestApp::spawn().await.get("/healthz").await;
    assert_eq!(plain.header("strict-transport-security"), None);
}

#[tokio::test]
async fn plain_http_is_not_answered_on_the_port_of_tls() {
    let (app, certificate, _dir) = server().await;
    let mut plain = Raw::connect(app.server.address).await;
    plain
        .send(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n")
        .await;
    let output = plain.rest().await;
    assert!(!output.contains("HTTP/1.1"), "{output:?}");
    assert!(
        get(&app, "/healthz", &certificate, &[])
            .await
            .status
            .success(),
        "others go on"
    );
}

#[tokio::test]
async fn answers_without_a_route_carry_hsts() {
    let (app, certificate, _dir) = server().await;
    let many: Vec<String> = (0..101).map(|i| format!("x-{i}: a")).collect();
    let many = many.iter().flat_map(|header| ["--header", header]);
    let wrong_length = ["--header", "content-length: many"];
    for (status, more) in [(431, many.collect::<Vec<_>>()), (400, wrong_length.into())] {
        let url = format!("{}/healthz", app.server.url());
        let arguments = ["--include", "--cacert", certificate.to_str().unwrap(), &url];
        let arguments = arguments.iter().chain(&more);
        let answer = curl(arguments.map(|text| (*text).to_owned()).collect()).await;
        let output = String::from_utf8(answer.stdout).unwrap().to_lowercase();
        assert!(
            output.starts_with(&format!("http/1.1 {status} ")),
            "{output}"
        );
        assert!(
            output.contains("strict-transport-security: max-age="),
            "{output}"
        );
        assert!(output.contains("application/problem+json"), "{output}");
    }
}

#[tokio::test]
async fn a_client_that_never_shakes_hands_is_cut_off() {
    let (app, ..) = server().await;
    // Fails where the connection stays open for longer than the helper's patience.
    Raw::connect(app.server.address).await.rest().await;
}

#[tokio::test]
async fn a_key_that_is_not_the_certificates_ends_the_start_and_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let (one, other) = (
        certificate(dir.path(), "one"),
        certificate(dir.path(), "other"),
    );
    let empty = dir.path().join("empty");
    std::fs::write(&empty, "").unwrap();
    for (tls, named) in [
        (
            TlsConfig {
                tls_key: other.tls_key,
                ..one.clone()
            },
            "other.key",
        ),
        (
            TlsConfig {
                tls_cert: Some(empty),
                ..one.clone()
            },
            "empty",
        ),
        (
            TlsConfig {
                tls_key: Some(dir.path().join("nowhere")),
                ..one
            },
            "nowhere",
        ),
    ] {
        let config = ServeConfig {
            tls,
            ..ServeConfig::loopback(dir.path().join("data"), 0)
        };
        let error = server::start(&config).await.expect_err(named).to_string();
        assert!(
            error.starts_with("TLS: ") && error.contains(named),
            "{error}"
        );
    }
}

#[test]
fn plain_http_beyond_loopback_is_wrong_usage_unless_it_is_said_aloud() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let beyond = format!("0.0.0.0:{}", taken.local_addr().unwrap().port());
    let dir = tempfile::tempdir().unwrap();
    let serve = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_kincal"));
        command
            .args(["serve", "--listen", &beyond, "--data-dir"])
            .arg(dir.path())
            .args(more);
        let output = command.env_remove("KINCAL_INSECURE_HTTP").output().unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let (code, message) = serve(&[]);
    assert_eq!(code, Some(2), "{message}");
    assert!(
        ["--tls-cert", "--insecure-http", "0.0.0.0"]
            .iter()
            .all(|part| message.contains(part)),
        "{message}"
    );
    // The port is in use, so nothing is served to the network: the settings were accepted, and only the address was refused.
    let (code, message) = serve(&["--insecure-http"]);
    assert_eq!(
        (code, message.contains("cannot listen")),
        (Some(1), true),
        "{message}"
    );
}
