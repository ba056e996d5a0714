//! The command line on an unreliable network: a request takes effect once, and `--wait` survives lost connections.

use crate::app::{TestApp, paper, text};
use crate::people::{Person, guarded};
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::process::{Command, Output};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

/// Behaviour of the proxy for one connection.
enum Fault {
    /// Closed before anything is read.
    Refused,
    /// The first request is answered 503 with an immediate retry.
    Busy,
    /// Forwarded, and cut when the server has sent this text.
    CutAfter(&'static str),
}

/// Starts a proxy to the server with these faults for its first connections; later ones are forwarded. Returns its address.
async fn breaking(server: SocketAddr, faults: impl IntoIterator<Item = Fault>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let mut faults: VecDeque<Fault> = faults.into_iter().collect();
    tokio::spawn(async move {
        while let Ok((client, _)) = listener.accept().await {
            match faults.pop_front() {
                Some(Fault::Refused) => drop(client),
                Some(Fault::Busy) => busy(client).await,
                Some(Fault::CutAfter(marker)) => {
                    drop(tokio::spawn(cut_after(client, server, marker)))
                }
                None => drop(tokio::spawn(async move {
                    let (mut client, mut server) =
                        (client, TcpStream::connect(server).await.unwrap());
                    let _ = tokio::io::copy_bidirectional(&mut client, &mut server).await;
                })),
            }
        }
    });
    format!("http://{address}")
}

async fn busy(mut client: TcpStream) {
    let mut request = vec![0; 65_536];
    let _ = client.read(&mut request).await;
    let answer = "HTTP/1.1 503 Service Unavailable\r\nretry-after: 0\r\ncontent-length: 2\r\nconnection: close\r\n\r\n{}";
    let _ = client.write_all(answer.as_bytes()).await;
    let _ = client.shutdown().await;
    // Unread data would turn the close into a reset.
    while client.read(&mut request).await.is_ok_and(|n| n > 0) {}
}

async fn cut_after(client: TcpStream, server: SocketAddr, marker: &str) {
    let (mut from_client, mut to_client) = client.into_split();
    let (mut from_server, mut to_server) = TcpStream::connect(server).await.unwrap().into_split();
    let asking =
        tokio::spawn(async move { tokio::io::copy(&mut from_client, &mut to_server).await });
    let mut received = Vec::new();
    while !received.ends_with(marker.as_bytes()) {
        let Ok(byte) = from_server.read_u8().await else {
            break;
        };
        received.push(byte);
        if to_client.write_all(&[byte]).await.is_err() {
            break;
        }
    }
    asking.abort();
}

async fn kincal(url: &str, key: &str, arguments: &[&str]) -> (Option<i32>, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_kincal"));
    command
        .args(arguments)
        .env("KINCAL_SERVER", url)
        .env("KINCAL_KEY", key);
    let output: Output =
        tokio::task::spawn_blocking(move || command.output().expect("the binary runs"))
            .await
            .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

async fn robot(person: &Person<'_>) -> String {
    let robot = person
        .post(
            "/v1/robots",
            &serde_json::from_slice(&paper("robot.json")).unwrap(),
        )
        .await
        .ok(201);
    text(&robot["id"]).to_owned()
}

async fn n_items(person: &Person<'_>, path: &str) -> usize {
    person.get(path).await.ok(200)["items"]
        .as_array()
        .unwrap()
        .len()
}

fn set() -> String {
    format!("{}/data/paper/first_noisy.csv", env!("CARGO_MANIFEST_DIR"))
}

async fn somebody(app: &TestApp) -> Person<'_> {
    Person::new(app, &["read", "upload", "identify"]).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_that_breaks_again_and_again_costs_nothing_but_time() {
    let (app, _dir) = guarded(1).await;
    let person = somebody(&app).await;
    let (robot, set) = (robot(&person).await, set());
    // The upload's answer is cut within its body, that to the job within its status, and the next connections fail.
    let faults = [
        Fault::CutAfter("\r\n\r\n{"),
        Fault::Busy,
        Fault::CutAfter("queued"),
        Fault::Refused,
        Fault::Busy,
    ];
    let url = breaking(app.server.address, faults).await;
    let arguments = [
        "submit", "--robot", &robot, &set, "--wait", "--method", "pso", "--preset", "paper",
    ];
    let (code, received, stderr) = kincal(&url, &person.key, &arguments).await;
    assert_eq!(code, Some(0), "{stderr}");
    assert!(received.contains("verify (50), after"), "{received}");
    for what in ["measurement-sets", "jobs"] {
        assert_eq!(
            n_items(&person, &format!("/v1/robots/{robot}/{what}")).await,
            1,
            "{what}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_stays_busy_is_given_up_and_one_that_is_not_there_is_said_at_once() {
    let (app, _dir) = guarded(0).await;
    let person = somebody(&app).await;
    let url = breaking(app.server.address, (0..100).map(|_| Fault::Busy)).await;
    let (code, _, stderr) = kincal(&url, &person.key, &["robots"]).await;
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stderr.contains("the server answered 503"), "{stderr}");
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let (code, _, stderr) = kincal(&format!("http://{free}"), &person.key, &["robots"]).await;
    assert_eq!(code, Some(1), "{stderr}");
    assert!(
        stderr.contains("is it running, and is --server right?"),
        "{stderr}"
    );
}
