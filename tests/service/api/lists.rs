//! Lists: order, filters, totals and cursors, alone and together.

use crate::app::{TestApp, text};
use crate::engines::for_each_engine;
use crate::fixtures::{a_robot, in_transaction};
use crate::people::{guarded, key, with_key};
use kincal::store::{Archivable, ListRequest, archive, robots};
use kincal::wire::page::{ArchivedFilter, Sort};
use reqwest::Method;
use serde_json::{Value, json};

fn robot(name: &str, serial_number: &str) -> Value {
    let link = json!({"a_mm": 1.5, "alpha_deg": -90.0, "d_mm": 0.1, "theta_offset_deg": 0.0});
    json!({"name": name, "serial_number": serial_number, "links": [link]})
}

/// The named field of every item on all pages of a list, and the total, which is the same on each page.
async fn all_pages(app: &TestApp, path: &str, field: &str) -> (Vec<String>, u64) {
    let (mut found, mut total, mut cursor) = (Vec::new(), None, String::new());
    loop {
        let page = app.get(&format!("{path}{cursor}")).await.ok(200);
        let items = page["items"].as_array().unwrap();
        found.extend(items.iter().map(|item| text(&item[field]).to_owned()));
        let now = page["total"].as_u64().unwrap();
        assert_eq!(*total.get_or_insert(now), now, "{path}");
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => return (found, now),
        }
    }
}

#[tokio::test]
async fn robots_are_searched_and_sorted_page_by_page() {
    let app = TestApp::spawn().await;
    for (name, serial_number) in [
        ("delta", "SN-100%"),
        ("Alpha", "SN-1001"),
        ("charlie", "X_7"),
        ("bravo", "X57"),
    ] {
        app.post_json("/v1/robots", &robot(name, serial_number))
            .await
            .ok(201);
    }
    let names = async |query: &str| {
        let (names, total) = all_pages(&app, &format!("/v1/robots?{query}"), "name").await;
        assert_eq!(names.len() as u64, total, "{query}");
        names
    };
    assert_eq!(
        names("limit=1").await,
        ["bravo", "charlie", "Alpha", "delta"]
    );
    assert_eq!(
        names("limit=3&sort=created_at").await,
        ["delta", "Alpha", "charlie", "bravo"]
    );
    assert_eq!(
        names("limit=1&sort=name").await,
        ["Alpha", "bravo", "charlie", "delta"]
    );
    assert_eq!(
        names("limit=2&sort=-name").await,
        ["delta", "charlie", "bravo", "Alpha"]
    );
    // Names and serial numbers, upper and lower case alike; `%` and `_` are characters.
    assert_eq!(
        names("limit=1&sort=name&search=A").await,
        ["Alpha", "bravo", "charlie", "delta"]
    );
    assert_eq!(names("limit=1&search=sn-1001").await, ["Alpha"]);
    assert_eq!(names("limit=1&search=100%25").await, ["delta"]);
    assert_eq!(names("limit=1&search=x_").await, ["charlie"]);
    assert_eq!(names("limit=1&search=nothing").await, [""; 0]);

    // A cursor belongs to its order.
    let page = app.get("/v1/robots?limit=1&sort=name").await.ok(200);
    let cursor = text(&page["next_cursor"]);
    for query in ["sort=-name", "sort=created_at", "limit=1"] {
        app.get(&format!("/v1/robots?{query}&cursor={cursor}"))
            .await
            .problem(400, "invalid_cursor");
    }
    for query in [
        "sort=size".to_owned(),
        "archived=maybe".into(),
        format!("search={}", "a".repeat(201)),
        "search=%00".into(),
        "status=ok".into(),
    ] {
        app.get(&format!("/v1/robots?{query}"))
            .await
            .problem(400, "invalid_query");
    }
}

#[tokio::test]
async fn filters_cursors_and_the_archive_work_together() {
    let app = TestApp::spawn().await;
    for i in 0..6 {
        let created = app
            .post_json("/v1/robots", &robot(&format!("cell {i}"), "S"))
            .await
            .ok(201);
        if i % 2 == 0 {
            let path = format!("/v1/robots/{}/archive", text(&created["id"]));
            app.post(&path, "", "").await.ok(200);
        }
    }
    let names = async |query: &str| {
        all_pages(
            &app,
            &format!("/v1/robots?limit=1&sort=name&{query}"),
            "name",
        )
        .await
    };
    assert_eq!(
        names("search=CELL").await,
        (vec!["cell 1".into(), "cell 3".into(), "cell 5".into()], 3)
    );
    assert_eq!(
        names("search=cell&archived=true").await,
        (vec!["cell 0".into(), "cell 2".into(), "cell 4".into()], 3)
    );
    assert_eq!(names("archived=all").await.1, 6);
    assert_eq!(names("archived=false").await.1, 3);
}

#[tokio::test]
async fn jobs_of_all_robots_are_listed_as_far_as_the_key_may_see_them() {
    let (app, _dir) = guarded(0).await;
    let (admin, _) = key(&app, &["admin"], None).await;
    let post = async |path: &str, content_type: &str, body: Vec<u8>| {
        let request = app.request(Method::POST, path).bearer_auth(&admin);
        let request = request.header("content-type", content_type).body(body);
        crate::app::Answer::of(request).await.json()
    };
    let mut robots = Vec::new();
    for _ in 0..2 {
        let body = crate::app::paper("robot.json");
        let robot = post("/v1/robots", "application/json", body).await;
        let robot = text(&robot["id"]).to_owned();
        let path = format!("/v1/robots/{robot}/measurement-sets?frame=base");
        let set = post(&path, "text/csv", crate::app::paper("first.csv")).await;
        for kind in ["identify", "verify"] {
            let request = json!({"measurement_set_id": set["id"], "kind": kind});
            let path = format!("/v1/robots/{robot}/jobs");
            let job = post(&path, "application/json", request.to_string().into_bytes()).await;
            assert_eq!(job["status"], "queued", "{job}");
        }
        robots.push(robot);
    }
    let list = async |key: &str, query: &str| {
        let path = format!("/v1/jobs?{query}");
        with_key(&app, Method::GET, &path, key, Vec::new()).await
    };
    let total = async |key: &str, query: &str| list(key, query).await.ok(200)["total"].clone();
    assert_eq!(total(&admin, "").await, 4);
    assert_eq!(total(&admin, "status=queued&kind=verify").await, 2);
    assert_eq!(total(&admin, "status=running").await, 0);
    let of_robot = format!("robot_id={}", robots[0]);
    assert_eq!(total(&admin, &of_robot).await, 2);
    assert_eq!(total(&admin, &format!("{of_robot}&kind=identify")).await, 1);
    let (limited, _) = key(&app, &["read"], Some(vec![&robots[1]])).await;
    let seen = list(&limited, "limit=1").await.ok(200);
    assert_eq!(
        (&seen["total"], &seen["items"][0]["robot_id"]),
        (&json!(2), &json!(robots[1]))
    );
    list(&limited, &of_robot).await.problem(404, "not_found");
    list(&admin, "sort=name")
        .await
        .problem(400, "invalid_query");

    // A cancelled job has another status; the list of one robot takes the same filters.
    let job = text(&seen["items"][0]["id"]).to_owned();
    let path = format!("/v1/jobs/{job}/cancel");
    with_key(&app, Method::POST, &path, &admin, Vec::new())
        .await
        .ok(200);
    let path = format!("/v1/robots/{}/jobs?status=cancelled", robots[1]);
    let cancelled = with_key(&app, Method::GET, &path, &admin, Vec::new())
        .await
        .ok(200);
    assert_eq!(
        (&cancelled["total"], &cancelled["items"][0]["id"]),
        (&json!(1), &json!(job))
    );
}

#[test]
fn both_engines_search_sort_and_page_alike() {
    for_each_engine(async |database| {
        let store = &database.store;
        let mut ids = Vec::new();
        for name in ["b", "A", "d_1", "dx1", "c"] {
            ids.push(a_robot(store, name).await.id);
        }
        in_transaction(store, async |tx| {
            archive::archive(tx, Archivable::Robot, &ids[4], &ids[4], "key_1").await
        })
        .await;
        let names = async |sort: Sort, search: &str, archived: ArchivedFilter| {
            let mut request = ListRequest {
                limit: 2,
                sort,
                archived,
                search: search.into(),
                ..ListRequest::all()
            };
            let mut names = Vec::new();
            loop {
                let found = robots::search(store, None, &request).await.unwrap();
                names.extend(found.items.into_iter().map(|row| row.name));
                match found.next_cursor {
                    // As a client sends it back.
                    Some(next) => request.cursor = Some(next.to_string().parse().unwrap()),
                    None => {
                        assert_eq!(names.len() as i64, found.total);
                        return names;
                    }
                }
                assert!(request.is_consistent());
            }
        };
        use ArchivedFilter::{All, False, True};
        assert_eq!(names(Sort::Name, "", False).await, ["A", "b", "d_1", "dx1"]);
        assert_eq!(
            names(Sort::NameDescending, "", All).await,
            ["dx1", "d_1", "c", "b", "A"]
        );
        assert_eq!(names(Sort::Newest, "", True).await, ["c"]);
        assert_eq!(
            names(Sort::Oldest, "", All).await,
            ["b", "A", "d_1", "dx1", "c"]
        );
        assert_eq!(names(Sort::Oldest, "D_", All).await, ["d_1"]);
        assert_eq!(names(Sort::Oldest, "a", All).await, ["A"]);
    });
}
