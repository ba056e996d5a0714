//! The stored estimate of each parameter set, see `wire::estimate`.

use super::sql::{self, values};
use super::{Hashed, Result, Store, Tx};

pub(super) const ALL_QUERIES: &[&str] = &[INSERT, OF_PARAMETER_SET, ALL];

const INSERT: &str = "insert into estimate (parameter_set_id, estimate_json) values ($1, $2)";

const OF_PARAMETER_SET: &str = "select estimate_json from estimate where parameter_set_id = $1";

/// Ids of parameter sets with their estimates, for `verify-store`.
pub(super) const ALL: &str = "
    select parameter_set_id, estimate_json from estimate where parameter_set_id > $1 order by parameter_set_id limit cast($2 as bigint)";

/// Stores the estimate of a new parameter set.
pub(super) async fn insert(
    tx: &mut Tx,
    parameter_set_id: &str,
    json: &Hashed<String>,
) -> Result<()> {
    let values = values![parameter_set_id, json.content()];
    sql::execute(tx.connection(), INSERT, values).await?;
    Ok(())
}

/// The estimate of a parameter set, if one was stored.
pub async fn of_parameter_set(store: &Store, parameter_set_id: &str) -> Result<Option<String>> {
    let values = values![parameter_set_id];
    sql::first_value(store.readers(), OF_PARAMETER_SET, values).await
}
