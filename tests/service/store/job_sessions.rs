//! The sets of a job of several sessions, on each engine.

use kincal::jobs::queue;
use kincal::store::{
    Conflict, Engine, Error, MeasurementSetRow, NewJob, NewMeasurementSet, NewParameterSet,
    ParameterSetRow, Result, RobotRow, Store, jobs, measurement_sets, parameter_sets, policies,
};
use kincal::wire::policy::PolicyBody;
use sqlx::AssertSqlSafe;

use crate::engines::for_each_engine;
use crate::fixtures::{a_robot, in_transaction, new_job, new_set};
use crate::store::parameter_sets::{
    UNCHECKED_UPDATE, is_refused_by_schema, release_without_checks,
};
use crate::store::verify::broken;

/// Whether a result is the refusal that is expected.
type Refusal = fn(&Result<()>) -> bool;

async fn upload(store: &Store, new: NewMeasurementSet) -> MeasurementSetRow {
    in_transaction(store, async |tx| {
        tx.act_as("key_uploader");
        measurement_sets::insert(tx, &new).await
    })
    .await
}

async fn three_sets(store: &Store, robot: &RobotRow) -> [MeasurementSetRow; 3] {
    [
        upload(store, new_set(robot, b"monday")).await,
        upload(store, new_set(robot, b"tuesday")).await,
        upload(store, new_set(robot, b"wednesday")).await,
    ]
}

fn of_sessions(first: &MeasurementSetRow, further: &[&MeasurementSetRow]) -> NewJob {
    NewJob {
        set_ids: std::iter::once(first)
            .chain(further.iter().copied())
            .map(|set| set.id.clone())
            .collect(),
        ..new_job(first, "{}")
    }
}

/// A candidate of a job of these sessions.
async fn a_candidate_of(store: &Store, new: &NewJob) -> ParameterSetRow {
    let job = in_transaction(store, async |tx| queue::enqueue(tx, new).await).await;
    let set = NewParameterSet {
        body_json: "{}".into(),
        sha256: "00".into(),
        estimate_json: None,
    };
    in_transaction(store, async |tx| {
        parameter_sets::insert(tx, &job.id, &set).await
    })
    .await
}

#[test]
fn a_job_keeps_its_sessions_in_their_order() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let [first, second, third] = three_sets(store, &robot).await;
        let new = of_sessions(&first, &[&third, &second]);
        let job = in_transaction(store, async |tx| queue::enqueue(tx, &new).await).await;
        let ids: Vec<&str> = job.set_ids().collect();
        assert_eq!(ids, [&first.id, &third.id, &second.id]);
        assert_eq!(jobs::get(store, &job.id).await.unwrap(), job);
        let single = in_transaction(store, async |tx| {
            queue::enqueue(tx, &new_job(&first, "{}")).await
        })
        .await;
        assert_eq!(Vec::from_iter(single.set_ids()), [&first.id]);
        assert_eq!(broken(store).await, Vec::<&str>::new());
        for change in [
            "update job_session set place = place + 7",
            "delete from job_session",
        ] {
            let changed = sqlx::query(change).execute(store.readers()).await;
            let refused = changed.unwrap_err().to_string();
            assert!(refused.contains("a job keeps its sessions"), "{refused}");
        }
    });
}

#[test]
fn a_job_of_an_unknown_set_or_of_one_set_twice_is_not_stored() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let [first, second, _] = three_sets(store, &robot).await;
        let mut unknown = of_sessions(&first, &[&second]);
        unknown.set_ids.push("set_0".into());
        let twice = of_sessions(&first, &[&second, &second]);
        let not_found = |stored: &Result<()>| matches!(stored, Err(Error::NotFound));
        let duplicate =
            |stored: &Result<()>| matches!(stored, Err(Error::Conflict(Conflict::Duplicate)));
        let cases: [(NewJob, Refusal); 2] = [(unknown, not_found), (twice, duplicate)];
        for (new, is_refused) in cases {
            let mut tx = store.begin().await.unwrap();
            let stored = match jobs::insert(&mut tx, &new, None).await {
                Ok(_) => tx.commit().await,
                Err(error) => Err(error),
            };
            assert!(is_refused(&stored), "{stored:?}");
        }
    });
}

#[test]
fn an_edit_of_a_jobs_sessions_does_not_stay_hidden() {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let [first, second, third] = three_sets(store, &robot).await;
        let new = of_sessions(&first, &[&second]);
        in_transaction(store, async |tx| queue::enqueue(tx, &new).await).await;
        let single = in_transaction(store, async |tx| {
            queue::enqueue(tx, &new_job(&first, "{}")).await
        })
        .await;
        let drop = match store.engine() {
            Engine::Sqlite => "drop trigger job_session_stays",
            Engine::Postgres => "drop trigger job_session_stays on job_session",
        };
        let run = async |sql: String| {
            let done = sqlx::query(AssertSqlSafe(sql)).execute(store.readers());
            done.await.unwrap();
        };
        run(drop.to_owned()).await;
        assert_eq!(
            broken(store).await,
            ["I9"],
            "the schema has lost its trigger"
        );
        let change = |id: &str| format!("update job_session set measurement_set_id = '{id}'");
        run(change(&third.id)).await;
        assert_eq!(
            broken(store).await.len(),
            2,
            "the chain has the sets as they were"
        );
        run(change(&second.id)).await;
        assert_eq!(broken(store).await, ["I9"]);
        // a set that is added to a job of one set
        run(format!(
            "insert into job_session (job_id, place, measurement_set_id) values ('{}', 1, '{}')",
            single.id, second.id
        ))
        .await;
        assert_eq!(broken(store).await.len(), 2);
    });
}

#[test]
fn no_set_is_released_that_rests_on_a_session_which_was_insisted_on_or_was_uploaded_by_who_releases()
 {
    for_each_engine(async |database| {
        let store = &database.store;
        let robot = a_robot(store, "r").await;
        let [first, second, third] = three_sets(store, &robot).await;
        let insisted = NewMeasurementSet {
            insisted_on: Some("frame_suspect".into()),
            ..new_set(&robot, b"thursday")
        };
        let insisted = upload(store, insisted).await;
        let refused = "one of the sessions that were fitted does not allow this release";
        let candidate = a_candidate_of(store, &of_sessions(&first, &[&second, &insisted])).await;
        is_refused_by_schema(release_without_checks(store, &candidate).await, refused);

        let own = NewMeasurementSet {
            uploaded_by: Some("key_1".into()),
            ..new_set(&robot, b"friday")
        };
        let own = in_transaction(store, async |tx| {
            tx.act_as("key_1");
            measurement_sets::insert(tx, &own).await
        })
        .await;
        let by_two = a_candidate_of(store, &of_sessions(&first, &[&own])).await;
        let by_another = a_candidate_of(store, &of_sessions(&first, &[&third])).await;
        let policy = PolicyBody {
            second_person_required: true,
            ..PolicyBody::default()
        };
        in_transaction(store, async |tx| {
            policies::put(tx, &robot.id, &policy, "boss").await
        })
        .await;
        // the update that a faulty server would write
        let write = async |candidate: &ParameterSetRow| {
            sqlx::query(UNCHECKED_UPDATE)
                .bind(&candidate.id)
                .bind("same_upload")
                .bind(0.1)
                .bind("key_1")
                .execute(store.readers())
                .await
        };
        let error = write(&by_two).await.unwrap_err().to_string();
        assert!(error.contains(refused), "{error}");
        write(&by_another).await.unwrap();
    });
}
