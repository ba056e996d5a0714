-- A job's row with its long documents at the end: SQLite reads a row from its beginning as far as it has to, and what came after a report of
-- 100 KB was 22 pages away. What is added to a job from here on belongs into a table of its own, or before the documents by a step like this.

-- The rows that refer to jobs find them again before this is committed.
pragma defer_foreign_keys = on;

create table job_moved as select * from job;
drop table job;

create table job (
    id                        text   not null primary key,
    robot_id                  text   not null references robot (id),
    measurement_set_id        text   not null references measurement_set (id),
    verify_set_id             text   references measurement_set (id),
    frames_id                 text   references frames (id),
    network_input_id          text   references network (id),
    residual_network_input_id text   references residual_network (id),
    parameter_set_input_id    text   references parameter_set (id),
    kind                      text   not null check (kind in ('identify', 'verify')),
    method                    text   not null,
    status                    text   not null check (status in ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    priority                  bigint not null,
    client                    text   not null default '',
    turn                      bigint not null default 0,
    attempt                   bigint not null check (attempt >= 0),
    deaths                    bigint not null default 0 check (deaths >= 0),
    owner                     text,
    lease_until_ms            bigint,
    cancel_requested_at_ms    bigint,
    result_sha256             text,
    created_at_ms             bigint not null,
    started_at_ms             bigint,
    finished_at_ms            bigint,
    request_json              text   not null,
    progress_json             text,
    error_json                text,
    convergence_json          text,
    report_json               text,
    check ((status = 'running') = (lease_until_ms is not null)),
    check (status <> 'running' or owner is not null),
    check ((status in ('succeeded', 'failed', 'cancelled')) = (finished_at_ms is not null)),
    check ((status = 'succeeded') = (report_json is not null)),
    check ((status = 'failed') = (error_json is not null))
);
insert into job (id, robot_id, measurement_set_id, verify_set_id, frames_id, network_input_id, residual_network_input_id,
        parameter_set_input_id, kind, method, status, priority, client, turn, attempt, deaths, owner, lease_until_ms, cancel_requested_at_ms,
        result_sha256, created_at_ms, started_at_ms, finished_at_ms, request_json, progress_json, error_json, convergence_json, report_json)
    select id, robot_id, measurement_set_id, verify_set_id, frames_id, network_input_id, residual_network_input_id,
        parameter_set_input_id, kind, method, status, priority, client, turn, attempt, deaths, owner, lease_until_ms, cancel_requested_at_ms,
        result_sha256, created_at_ms, started_at_ms, finished_at_ms, request_json, progress_json, error_json, convergence_json, report_json
    from job_moved;
drop table job_moved;

create index job_waiting on job (deaths, priority desc, turn, created_at_ms, id) where status = 'queued';
create index job_waiting_of_robot on job (robot_id) where status = 'queued';
create index job_turns on job (priority, turn) where status = 'queued';
create index job_turns_of_client on job (client, priority, turn) where status = 'queued';
create index job_leased on job (lease_until_ms) where status = 'running';
create index job_newest on job (robot_id, created_at_ms, id);
create index job_verifying on job (parameter_set_input_id, created_at_ms, id) where kind = 'verify';

create trigger job_stays_over before update of status on job
when old.status in ('succeeded', 'failed', 'cancelled') and new.status <> old.status
begin
    select raise(abort, 'a job ends once');
end;
create trigger job_report_stays before update of report_json, convergence_json, result_sha256 on job
when old.status in ('succeeded', 'failed', 'cancelled')
begin
    select raise(abort, 'the result of a job is never changed');
end;
