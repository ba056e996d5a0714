//! SQL: the newest set of a robot that waits for a decision, or was decided on.

/// The newest set of robot `r` that was not withdrawn, and neither archived nor of an archived job.
macro_rules! newest_set {
    () => {
        "(select p.id from parameter_set p where p.robot_id = r.id and p.status <> 'withdrawn'
        and not exists (select 1 from archived x where x.id in (p.id, p.job_id)) order by p.created_at_ms desc, p.id desc limit 1)"
    };
}
pub(super) use newest_set;
