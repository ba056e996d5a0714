//! Withdrawn parameter sets of a robot, with which a set that is to be released is compared.

use super::from_row::row;
use super::sql::{self, values};
use super::{Result, Store, Tx};

pub(super) const ALL_QUERIES: &[&str] = &[HELD, OF_ROBOT, COUNT];

// A withdrawn set whose values the job holds.
const HELD: &str = "
    select p.id from parameter_set p where p.status = 'withdrawn'
        and p.job_id in (select s.source_job_id from job_source s where s.job_id = $1 and s.is_held = 1)
    order by p.id limit 1";

const OF_ROBOT: &str = "
    select id, job_id, body_json from parameter_set where robot_id = $1 and status = 'withdrawn' order by id desc limit cast($2 as bigint)";

const COUNT: &str =
    "select count(*) from parameter_set where robot_id = $1 and status = 'withdrawn'";

row! {
    /// A withdrawn parameter set.
    #[derive(Clone, Debug, PartialEq)]
    pub struct WithdrawnSet {
        /// `par_…`
        pub id: String,
        /// The job that identified it.
        pub job_id: String,
        /// Its content, `wire::parameter_set::ParameterSetContent`.
        pub body_json: String,
    }
}

/// Id of a withdrawn parameter set whose values the job holds, if there is one.
pub async fn held(store: &Store, job_id: &str) -> Result<Option<String>> {
    sql::first_value(store.readers(), HELD, values![job_id]).await
}

/// The newest withdrawn parameter sets of a robot, at most `limit`.
pub async fn of_robot(store: &Store, robot_id: &str, limit: i64) -> Result<Vec<WithdrawnSet>> {
    sql::all(store.readers(), OF_ROBOT, values![robot_id, limit]).await
}

/// Number of withdrawn parameter sets of a robot.
pub async fn count(store: &Store, robot_id: &str) -> Result<i64> {
    sql::value(store.readers(), COUNT, values![robot_id]).await
}

/// As [`count`], in a transaction.
pub(super) async fn count_in(tx: &mut Tx, robot_id: &str) -> Result<i64> {
    sql::value(tx.connection(), COUNT, values![robot_id]).await
}
