-- What cannot be undone or forged quietly: the audit chain, the life of a parameter set, bytes that stay as they came.

-- Each entry's hash covers its content and the hash of the entry before it (src/store/audit.rs).
create table audit (
    seq         bigint not null primary key,
    at_ms       bigint not null,
    actor       text   not null,
    event       text   not null,
    subject     text   not null,
    detail_json text   not null,
    sha256      text   not null unique
);
create index audit_of_subject on audit (subject, event);

create table audit_head (
    only_row    bigint not null primary key check (only_row = 1),
    seq         bigint not null,
    sha256      text   not null,
    begun_at_ms bigint not null
);
insert into audit_head (only_row, seq, sha256, begun_at_ms) select 1, 0, '', now_ms from clock;

-- The trigger's argument says why.
create function kincal_refuse() returns trigger language plpgsql as $$
begin
    raise exception '%', tg_argv[0] using errcode = 'integrity_constraint_violation';
end $$;

create trigger audit_entry_stays before update on audit
    for each row execute function kincal_refuse('an audit entry is never changed');
create trigger audit_entry_is_kept before delete on audit
    for each row execute function kincal_refuse('an audit entry is never deleted');

-- How often the whole process died while the job ran: counted apart from the attempts, and such jobs come last.
alter table job add column deaths bigint not null default 0 check (deaths >= 0);
drop index job_waiting;
create index job_waiting on job (deaths, priority desc, created_at_ms, id) where status = 'queued';
-- The sessions that were scored against a parameter set.
create index job_verifying on job (parameter_set_input_id, created_at_ms, id) where kind = 'verify';

alter table parameter_set add column released_by text;
alter table parameter_set add column withdrawn_by text;

create trigger parameter_set_life before update of status on parameter_set
    for each row when ((old.status = 'withdrawn' and new.status <> 'withdrawn')
        or (old.status <> 'candidate' and new.status = 'candidate')
        or (old.status <> 'released' and old.status <> 'superseded' and new.status = 'superseded'))
    execute function kincal_refuse('a parameter set goes candidate, released, superseded or withdrawn, and never back from withdrawn');
create trigger parameter_set_checks before update on parameter_set
    for each row when (new.status = 'released' and old.status <> 'released'
        and (new.release_checks_json not like '%"passed":true%' or new.release_checks_json like '%"passed":false%'))
    execute function kincal_refuse('a parameter set is released with checks, all of them passed');
create trigger parameter_set_stays before update of id, robot_id, job_id, body_json, sha256 on parameter_set
    for each row execute function kincal_refuse('the content of a parameter set is never changed');
create trigger parameter_set_is_kept before delete on parameter_set
    for each row when (old.released_at_ms is not null)
    execute function kincal_refuse('a parameter set that was released is never deleted');
create trigger measurement_set_stays before update of id, robot_id, frame, content_type, body, sha256 on measurement_set
    for each row execute function kincal_refuse('an upload is never changed');
create trigger robot_stays before update of id, body_json on robot
    for each row execute function kincal_refuse('a robot is never changed: store a new one');
create trigger job_stays_over before update of status on job
    for each row when (old.status in ('succeeded', 'failed', 'cancelled') and new.status <> old.status)
    execute function kincal_refuse('a job ends once');
