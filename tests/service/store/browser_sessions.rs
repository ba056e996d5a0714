//! Sessions of browsers: found by any node, ended by sign-out, revocation and age.

use kincal::store::browser_sessions::{self, MAX_AGE_MS, MAX_OF_KEY};
use kincal::store::{NewApiKey, Store, api_keys};
use sqlx::AssertSqlSafe;

use crate::engines::for_each_engine;
use crate::fixtures::in_transaction;

async fn a_key(store: &Store, name: &str) -> String {
    let new = NewApiKey {
        name: name.into(),
        key_sha256: format!("hash of {name}"),
        scopes_json: "[]".into(),
        robots_json: None,
    };
    let row = in_transaction(store, async |tx| api_keys::insert(tx, &new).await).await;
    row.id
}

async fn begin(store: &Store, token: &str, key_id: &str) {
    in_transaction(store, async |tx| {
        browser_sessions::begin(tx, token, key_id).await
    })
    .await;
}

async fn is_open(store: &Store, token: &str) -> bool {
    let found = browser_sessions::find(store, token).await.unwrap();
    found.is_some()
}

/// Makes sessions older.
async fn age(store: &Store, which: &str, by_ms: i64) {
    let sql =
        format!("update browser_session set created_at_ms = created_at_ms - {by_ms} where {which}");
    sqlx::query(AssertSqlSafe(sql))
        .execute(store.readers())
        .await
        .unwrap();
}

async fn n_rows(store: &Store) -> i64 {
    sqlx::query_scalar("select count(*) from browser_session")
        .fetch_one(store.readers())
        .await
        .unwrap()
}

#[test]
fn a_session_ends_by_sign_out_by_age_and_with_its_key_and_its_row_is_deleted() {
    for_each_engine(async |database| {
        let store = &database.store;
        let (one, other) = (a_key(store, "one").await, a_key(store, "other").await);
        for (token, key) in [("a", &one), ("b", &one), ("c", &other), ("d", &one)] {
            begin(store, token, key).await;
        }
        let found = browser_sessions::find(store, "c").await.unwrap().unwrap();
        assert_eq!(found, api_keys::get(store, &other).await.unwrap());
        assert!(!is_open(store, "e").await);

        in_transaction(store, async |tx| browser_sessions::end(tx, "a").await).await;
        assert!(!is_open(store, "a").await && is_open(store, "b").await);
        age(store, "token_sha256 = 'b'", MAX_AGE_MS + 1).await;
        assert!(!is_open(store, "b").await && is_open(store, "d").await);
        in_transaction(store, async |tx| api_keys::revoke(tx, &other).await).await;
        assert!(!is_open(store, "c").await && is_open(store, "d").await);

        assert_eq!(n_rows(store).await, 3);
        begin(store, "e", &one).await;
        assert_eq!(n_rows(store).await, 2);
        assert!(is_open(store, "d").await && is_open(store, "e").await);
    });
}

#[test]
fn one_more_session_than_a_key_may_have_ends_its_oldest() {
    for_each_engine(async |database| {
        let store = &database.store;
        let (one, other) = (a_key(store, "one").await, a_key(store, "other").await);
        begin(store, "another key", &other).await;
        age(store, "1 = 1", 1).await;
        for i in 0..=MAX_OF_KEY {
            age(store, "1 = 1", 1).await;
            begin(store, &i.to_string(), &one).await;
        }
        assert_eq!(n_rows(store).await, MAX_OF_KEY + 1);
        assert!(!is_open(store, "0").await && is_open(store, "1").await);
        assert!(is_open(store, "another key").await);
    });
}
