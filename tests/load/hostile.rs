use crate::app::{Answer, TestApp, paper};
use reqwest::Method;
use std::io::Write;
use std::time::{Duration, Instant};

/// Five times the promised second, for an unoptimised build on a busy machine.
const WITHIN: Duration = Duration::from_secs(5);

async fn upload(
    app: &TestApp,
    robot: &str,
    content_type: &str,
    body: Vec<u8>,
) -> (Answer, Duration) {
    let begun = Instant::now();
    let answer = app
        .post(
            &format!("{robot}/measurement-sets?frame=base"),
            content_type,
            body,
        )
        .await;
    (answer, begun.elapsed())
}

#[tokio::test]
async fn a_million_rows_are_refused_in_time() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let header = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n".to_owned();
    let (answer, took) = upload(
        &app,
        &robot,
        "text/csv",
        (header + &"1,2,3,4,5,6,7,8,9\n".repeat(1_000_000)).into_bytes(),
    )
    .await;
    let problem = answer.problem(422, "invalid_measurements");
    assert_eq!(problem["errors"][0]["code"], "too_many_rows", "{problem}");
    assert!(took < WITHIN, "{took:?}");
}

#[tokio::test]
async fn a_million_points_in_json_are_refused_in_time() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let points = "{\"q_deg\":[],\"position_mm\":[0,0,0]},".repeat(900_000);
    let body = format!(
        "{{\"frame\":\"base\",\"points\":[{}]}}",
        points.trim_end_matches(',')
    );
    let (answer, took) = upload(&app, &robot, "application/json", body.into_bytes()).await;
    let problem = answer.problem(422, "invalid_body");
    assert_eq!(problem["errors"][0]["pointer"], "/points", "{problem}");
    assert!(took < WITHIN, "{took:?}");
}

#[tokio::test]
async fn json_nested_a_million_deep_is_refused_in_time_wherever_it_hides() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    for (open, close) in [("[", "]"), ("{\"a\":", "}")] {
        let deep = format!("{}1{}", open.repeat(1_000_000), close.repeat(1_000_000));
        for body in [
            deep.clone(),
            format!("{{\"frame\":\"base\",\"points\":{deep}}}"),
            format!("{{\"points\":[{{\"q_deg\":{deep}}}]}}"),
        ] {
            let (answer, took) = upload(&app, &robot, "application/json", body.into_bytes()).await;
            assert!(matches!(answer.status, 400 | 422), "{}", answer.text());
            assert!(took < WITHIN, "{took:?}");
        }
    }
}

async fn import(app: &TestApp, urdf: String) -> (Answer, Duration) {
    let begun = Instant::now();
    let path = "/v1/robot-imports?format=urdf";
    let answer = app.post(path, "application/xml", urdf).await;
    (answer, begun.elapsed())
}

fn attributes(n: usize) -> String {
    (0..n).map(|i| format!(" a{i}='1'")).collect()
}

#[tokio::test]
async fn a_urdf_of_too_much_of_anything_is_refused_in_time_with_its_line() {
    let app = TestApp::spawn().await;
    let many = attributes(100_000);
    let namespaces: String = (0..60_000).map(|i| format!(" xmlns:n{i}='u{i}'")).collect();
    let spread: String = (0..50_000)
        .map(|i| format!("<a xmlns:n{i}='u{i}'>"))
        .collect();
    for (urdf, code, line) in [
        (
            format!("<robot>\n<link{many}/></robot>"),
            "too_many_attributes",
            2,
        ),
        (format!("<robot{many}/>"), "too_many_attributes", 1),
        (format!("<robot{namespaces}/>"), "too_many_attributes", 1),
        (format!("<robot>\n\n{spread}"), "too_many_namespaces", 3),
        (
            format!("<robot>{}", "\n<a>".repeat(500_000)),
            "too_deep",
            101,
        ),
        (
            format!("<robot>{}</robot>", "<a/>".repeat(900_000)),
            "too_many_elements",
            1,
        ),
        (
            format!(
                "<robot>{}</robot>",
                format!("<a{}/>\n", attributes(60)).repeat(6_000)
            ),
            "too_many_attributes",
            3_334,
        ),
    ] {
        let start: String = urdf.chars().take(40).collect();
        let (answer, took) = import(&app, urdf).await;
        let problem = answer.problem(422, code);
        let detail = problem["errors"][0]["detail"].as_str().unwrap();
        assert!(
            detail.starts_with(&format!("line {line}: ")),
            "{start}: {detail}"
        );
        assert!(took < WITHIN, "{start}: {took:?}");
    }
    let (answer, took) = import(&app, "<robot>".repeat(700_000)).await;
    assert!(
        matches!(answer.status, 413 | 422) && took < WITHIN,
        "{took:?}"
    );
}

/// A chain of joints, with as many children at the last one as a file may have.
fn star(n: usize) -> String {
    let joint = |parent: usize, child: usize| {
        format!(
            "<joint name='j{child}' type='revolute'><parent link='l{parent}'/><child link='l{child}'/><axis xyz='0 0 1'/></joint>\n"
        )
    };
    let chain: String = (0..190).map(|i| joint(i, i + 1)).collect();
    let ends: String = (191..n).map(|i| joint(190, i)).collect();
    format!("<robot>{chain}{ends}</robot>")
}

#[tokio::test]
async fn a_urdf_of_many_joints_is_answered_in_time_and_shortly() {
    let app = TestApp::spawn().await;
    for (n, code) in [(4_999, "several_chains"), (20_000, "too_many_joints")] {
        let (answer, took) = import(&app, star(n)).await;
        answer.problem(422, code);
        assert!(answer.bytes.len() < 4_000, "{}", answer.text());
        assert!(took < WITHIN, "{n} joints: {took:?}");
    }
}

/// The most expensive description that is accepted: the most attributes, each with a prefix that is looked up among all namespaces.
fn costly_urdf() -> String {
    let namespaces: String = (0..64).map(|i| format!(" xmlns:n{i}='u{i}'")).collect();
    let attributes: String = (0..64).map(|i| format!(" n63:a{i}='1'")).collect();
    format!(
        "<robot{namespaces}>{}</robot>",
        format!("<a{attributes}/>").repeat(3_120)
    )
}

#[tokio::test]
async fn clients_that_send_a_costly_urdf_and_go_away_leave_no_work_behind() {
    const CLIENTS: usize = 64;
    let app = TestApp::spawn().await;
    let urdf = costly_urdf();
    let (answer, one) = import(&app, urdf.clone()).await;
    answer.problem(422, "no_joints");
    assert!(one < WITHIN, "{one:?}");
    let head = format!(
        "POST /v1/robot-imports?format=urdf HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/xml\r\ncontent-length: {}\r\n\r\n",
        urdf.len()
    );
    let request = head.into_bytes().into_iter().chain(urdf.into_bytes());
    let request: std::sync::Arc<[u8]> = request.collect();
    let mut clients = tokio::task::JoinSet::new();
    for _ in 0..CLIENTS {
        let (address, request) = (app.server.address, request.clone());
        clients.spawn(async move {
            let mut client = crate::raw::Raw::connect(address).await;
            client.send(&request).await;
        });
    }
    clients.join_all().await;
    let gone = Instant::now();
    // Requests of disconnected clients may still arrive: the server may refuse until their permits are free again.
    let (answer, took) = loop {
        let (answer, took) = import(&app, costly_urdf()).await;
        if answer.status != 503 {
            break (answer, took);
        }
        assert!(
            gone.elapsed() < WITHIN,
            "work goes on for clients that are gone"
        );
    };
    answer.problem(422, "no_joints");
    let free = "kincal_permits_available{kind=\"calculations\"} 64";
    while !app.get("/metrics").await.text().contains(free) {
        assert!(gone.elapsed() < WITHIN, "permits are not given back");
    }
    eprintln!(
        "one takes {one:?}; after {CLIENTS} had gone the next was answered in {:?}, {took:?} of it its own",
        gone.elapsed()
    );
}

#[tokio::test]
async fn a_gzip_bomb_is_not_unpacked() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    for encoding in ["gzip", "deflate", "br", "zstd", "gzip, identity"] {
        let request = app.request(Method::POST, &format!("{robot}/measurement-sets"));
        let request = request
            .header("content-type", "text/csv")
            .header("content-encoding", encoding)
            .body(vec![0x1f; 1000]);
        Answer::of(request)
            .await
            .problem(415, "unsupported_media_type");
    }
}

#[tokio::test]
async fn a_body_that_hides_its_length_is_cut_off_at_the_limit() {
    let app = TestApp::spawn().await;
    let robot = app.paper_robot().await;
    let mut client = crate::raw::Raw::connect(app.server.address).await;
    let mut head = Vec::new();
    write!(head, "POST {robot}/measurement-sets HTTP/1.1\r\nhost: localhost\r\ncontent-type: text/csv\r\ntransfer-encoding: chunked\r\n\r\n")
        .unwrap();
    client.send(&head).await;
    let chunk = [b"100000\r\n".as_slice(), &vec![b'1'; 0x10_0000], b"\r\n"].concat();
    for _ in 0..40 {
        if !client.send(&chunk).await {
            break;
        }
    }
    let answer = client.rest().await;
    assert!(
        answer.is_empty() || answer.starts_with("HTTP/1.1 413"),
        "{answer}"
    );
    assert_eq!(app.get("/healthz").await.status, 200);
}

#[tokio::test]
async fn many_large_bodies_at_once_are_all_answered_and_small_ones_go_on() {
    let app = std::sync::Arc::new(TestApp::spawn().await);
    let robot = app.paper_robot().await;
    let body = a_full_body();
    let mut uploads = tokio::task::JoinSet::new();
    for _ in 0..16 {
        let (app, robot, body) = (app.clone(), robot.clone(), body.clone());
        uploads.spawn(async move {
            let request = app
                .request(Method::POST, &format!("{robot}/measurement-sets"))
                .header("content-type", "text/csv")
                .body(body);
            // A server that answers before it has read everything may close while the client still writes.
            request.send().await.map(|response| {
                (
                    response.status().as_u16(),
                    response.headers().contains_key("retry-after"),
                )
            })
        });
    }
    app.upload(&robot, "first.csv").await;
    let answers = uploads.join_all().await;
    let known = answers.iter().flatten().collect::<Vec<_>>();
    assert!(
        known
            .iter()
            .all(|answer| matches!(answer, (422, false) | (503, true))),
        "{known:?}"
    );
    assert!(known.iter().any(|answer| answer.0 == 422), "{known:?}");
    let (answer, _) = upload(&app, &robot, "text/csv", paper("first.csv")).await;
    answer.ok(201);
}

/// A body of the largest size without useful content.
fn a_full_body() -> Vec<u8> {
    let mut body = b"q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\n".to_vec();
    body.resize(kincal::http::MAX_BODY_BYTES, b'1');
    body
}
