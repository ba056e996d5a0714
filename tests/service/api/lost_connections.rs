//! The command line behind a network that breaks: what was sent once is done once, and who waits for a job is not sent away.

use crate::app::{TestApp, paper, text};
use crate::people::{Person, guarded};
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::process::{Command, Output};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

/// What becomes of a connection.
enum Fate {
    /// Closed before it is read.
    Refused,
    /// The first request is answered 503, to be sent again at once.
    Busy,
    /// The server is reached, and all is cut once it has said this.
    CutAfter(&'static str),
}

/// An address through which the server is reached, after these connections as well as ever.
async fn breaking(server: SocketAddr, fates: impl IntoIterator<Item = Fate>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let mut fates: VecDeque<Fate> = fates.into_iter().collect();
    tokio::spawn(async move {
        while let Ok((client, _)) = listener.accept().await {
            match fates.pop_front() {
                Some(Fate::Refused) => drop(client),
                Some(Fate::Busy) => busy(client).await,
                Some(Fate::CutAfter(said)) => drop(tokio::spawn(cut_after(client, server, said))),
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
    // what is not read would make the end a reset
    while client.read(&mut request).await.is_ok_and(|n| n > 0) {}
}

async fn cut_after(client: TcpStream, server: SocketAddr, said: &str) {
    let (mut from_client, mut to_client) = client.into_split();
    let (mut from_server, mut to_server) = TcpStream::connect(server).await.unwrap().into_split();
    let asking =
        tokio::spawn(async move { tokio::io::copy(&mut from_client, &mut to_server).await });
    let mut told = Vec::new();
    while !told.ends_with(said.as_bytes()) {
        let Ok(byte) = from_server.read_u8().await else {
            break;
        };
        told.push(byte);
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
    // the upload's answer is cut within its body; the events after the first; and the server is away when they are asked for again
    let fates = [
        Fate::CutAfter("\r\n\r\n{"),
        Fate::Busy,
        Fate::CutAfter("event: progress"),
        Fate::Refused,
        Fate::Busy,
    ];
    let url = breaking(app.server.address, fates).await;
    let arguments = [
        "submit", "--robot", &robot, &set, "--wait", "--method", "pso", "--preset", "paper",
    ];
    let (code, told, complaints) = kincal(&url, &person.key, &arguments).await;
    assert_eq!(code, Some(0), "{complaints}");
    assert!(told.contains("verify (50), after"), "{told}");
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
    let url = breaking(app.server.address, (0..100).map(|_| Fate::Busy)).await;
    let (code, _, complaints) = kincal(&url, &person.key, &["robots"]).await;
    assert_eq!(code, Some(1), "{complaints}");
    assert!(
        complaints.contains("the server answered 503"),
        "{complaints}"
    );
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let begun = std::time::Instant::now();
    let (code, _, complaints) = kincal(&format!("http://{free}"), &person.key, &["robots"]).await;
    assert_eq!(code, Some(1), "{complaints}");
    assert!(
        complaints.contains("is it running, and is --server right?")
            && begun.elapsed().as_secs() < 5,
        "{complaints}"
    );
}
