//! The cookie of a signed-in browser: made from a key, read by no script, of no use to pages of other origins, ended by sign-out and revocation.

use crate::app::{Answer, TestApp, paper, text};
use crate::people::{guarded, key, revoke, with_key};
use reqwest::Method;

/// Signs in with a key. Returns the header that sets the cookie.
async fn sign_in(app: &TestApp, key: &str, origin: Option<&str>) -> String {
    let mut request = app.request(Method::PUT, "/v1/session").bearer_auth(key);
    if let Some(origin) = origin {
        request = request.header("origin", origin);
    }
    let answer = Answer::of(request).await;
    assert_eq!(answer.status, 204, "{}", answer.text());
    answer.header("set-cookie").expect("a cookie").to_owned()
}

/// The part of a `Set-Cookie` that a browser sends back.
fn pair(set_cookie: &str) -> &str {
    set_cookie.split(';').next().unwrap()
}

async fn ask(
    app: &TestApp,
    method: Method,
    path: &str,
    cookie: &str,
    more: &[(&str, &str)],
) -> Answer {
    let mut request = app
        .request(method, path)
        .header("cookie", cookie)
        .header("content-type", "application/json")
        .body(paper("robot.json"));
    for (name, value) in more {
        request = request.header(*name, *value);
    }
    Answer::of(request).await
}

#[tokio::test]
async fn a_key_becomes_a_cookie_that_opens_links_and_that_no_script_reads() {
    let (app, _dir) = guarded(0).await;
    let (reader, _) = key(&app, &["read"], None).await;
    let set = sign_in(&app, &reader, None).await;
    for attribute in ["; HttpOnly", "; SameSite=Strict", "; Path=/v1"] {
        assert!(set.contains(attribute), "{set}");
    }
    assert!(
        !set.contains("Secure") && !set.contains("Max-Age") && !set.contains("Expires"),
        "it ends with the browser, and plain HTTP on loopback can keep it: {set}"
    );
    let others = format!("theme=dark; {}; kincal_session_old=x", pair(&set));
    assert_eq!(
        ask(&app, Method::GET, "/v1/robots", &others, &[])
            .await
            .status,
        200
    );
    // It may do what the key may do, and no more.
    ask(
        &app,
        Method::POST,
        "/v1/robots",
        pair(&set),
        &[("x-kincal-session", "1")],
    )
    .await
    .problem(403, "insufficient_scope");
}

#[tokio::test]
async fn the_cookie_is_kept_to_tls_where_the_browser_came_by_tls() {
    let (app, _dir) = guarded(0).await;
    let (reader, _) = key(&app, &["read"], None).await;
    let set = sign_in(&app, &reader, Some("https://cal.example")).await;
    assert!(set.contains("; Secure"), "{set}");
}

#[tokio::test]
async fn a_page_of_another_origin_can_do_nothing_with_the_cookie() {
    let (app, _dir) = guarded(0).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let set = sign_in(&app, &admin, None).await;
    let cookie = pair(&set);
    ask(&app, Method::POST, "/v1/robots", cookie, &[])
        .await
        .problem(403, "forbidden");
    for site in ["cross-site", "same-site"] {
        let more = [("x-kincal-session", "1"), ("sec-fetch-site", site)];
        ask(&app, Method::POST, "/v1/robots", cookie, &more)
            .await
            .problem(403, "forbidden");
        ask(&app, Method::GET, "/v1/robots", cookie, &more)
            .await
            .problem(403, "forbidden");
    }
    let preflight = app
        .request(Method::OPTIONS, "/v1/robots")
        .header("origin", "http://evil.example")
        .header("access-control-request-method", "POST")
        .header("access-control-request-headers", "x-kincal-session");
    let preflight = Answer::of(preflight).await;
    assert!(
        preflight.header("access-control-allow-origin").is_none()
            && preflight.header("access-control-allow-headers").is_none(),
        "no other origin may send the header"
    );
    let robots = ask(&app, Method::GET, "/v1/robots", cookie, &[]).await;
    assert_eq!(
        robots.ok(200)["items"].as_array().unwrap().len(),
        0,
        "nothing was made"
    );
    // The dashboard itself sends the header.
    let own = [("x-kincal-session", "1"), ("sec-fetch-site", "same-origin")];
    let made = ask(&app, Method::POST, "/v1/robots", cookie, &own).await;
    assert_eq!(made.status, 201, "{}", made.text());
}

#[tokio::test]
async fn sign_out_and_revocation_end_the_session() {
    let (app, _dir) = guarded(0).await;
    let (reader, id) = key(&app, &["read"], None).await;
    let set = sign_in(&app, &reader, None).await;
    let replaced = sign_in(&app, &reader, None).await;
    assert!(
        !set.contains(&reader) && pair(&set) != pair(&replaced),
        "a random token"
    );
    // A sign-out that another origin asks for does nothing.
    ask(&app, Method::DELETE, "/v1/session", pair(&set), &[])
        .await
        .problem(403, "forbidden");
    let out = ask(
        &app,
        Method::DELETE,
        "/v1/session",
        pair(&set),
        &[("x-kincal-session", "1")],
    )
    .await;
    assert_eq!(out.status, 204);
    let cleared = out.header("set-cookie").unwrap();
    assert!(
        cleared.starts_with("kincal_session=;") && cleared.contains("; Max-Age=0"),
        "{cleared}"
    );
    let read = async |set: &str| ask(&app, Method::GET, "/v1/robots", pair(set), &[]).await;
    let ended = read(&set).await.problem(401, "unauthorized");
    assert!(text(&ended["detail"]).contains("sign in again"), "{ended}");
    assert_eq!(read(&replaced).await.status, 200, "another browser");
    // Signing in anew ends the session that this browser had.
    let again = app
        .request(Method::PUT, "/v1/session")
        .bearer_auth(&reader)
        .header("cookie", pair(&replaced));
    let again = Answer::of(again)
        .await
        .header("set-cookie")
        .unwrap()
        .to_owned();
    read(&replaced).await.problem(401, "unauthorized");
    assert_eq!(read(&again).await.status, 200);

    revoke(&app, &id).await;
    let refused = read(&again).await;
    refused.problem(401, "unauthorized");
    assert!(
        refused
            .header("set-cookie")
            .is_some_and(|cookie| cookie.contains("; Max-Age=0")),
        "the browser forgets a session that ended"
    );
}

#[tokio::test]
async fn a_header_counts_before_the_cookie_and_nonsense_is_no_session() {
    let (app, _dir) = guarded(0).await;
    let (reader, _) = key(&app, &["read"], None).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let set = sign_in(&app, &reader, None).await;
    let request = app
        .request(Method::POST, "/v1/robots")
        .bearer_auth(&admin)
        .header("cookie", pair(&set))
        .header("content-type", "application/json")
        .body(paper("robot.json"));
    assert_eq!(Answer::of(request).await.status, 201);
    for nonsense in [
        "kincal_session",
        "kincal_session=",
        "kincal_session=kincal_0",
        // the key itself is no session
        &format!("kincal_session={reader}"),
        ";;;",
    ] {
        ask(&app, Method::GET, "/v1/robots", nonsense, &[])
            .await
            .problem(401, "unauthorized");
    }
    // An unknown key makes no session.
    with_key(&app, Method::PUT, "/v1/session", "kincal_0", vec![])
        .await
        .problem(401, "unauthorized");
}
