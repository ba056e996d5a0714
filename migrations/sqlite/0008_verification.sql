-- What the gates of a release need, as columns: written when a job ends, so that no gate, history or trigger reads a report's text.
-- Order is by counters and never by a clock.

-- What each succeeded job says about the parameter set that it identified or scored. `seq` counts the rows of one robot.
-- `check_seq` is the last session that did not fit it when the job began; `is_repeat` says that its points are of before that, or may be.
create table verification (
    job_id           text   not null primary key references job (id),
    robot_id         text   not null references robot (id),
    parameter_set_id text   references parameter_set (id),
    kind             text   not null check (kind in ('identification', 'session')),
    seq              bigint not null,
    n_points         bigint not null,
    before_rms_mm    double precision,
    after_rms_mm     double precision,
    is_better        bigint not null check (is_better in (0, 1)),
    fit              text   not null check (fit in ('fits', 'set_far_off', 'does_not_fit')),
    evidence         text   not null check (evidence in ('none', 'same_upload', 'independent_session')),
    is_repeat        bigint not null check (is_repeat in (0, 1)),
    check_seq        bigint not null,
    uncertainty_mm   double precision,
    unique (robot_id, seq)
);
create index verification_of_set on verification (parameter_set_id, seq);
create trigger verification_stays before update on verification
begin
    select raise(abort, 'what a verification found is never changed');
end;
create trigger verification_is_kept before delete on verification
begin
    select raise(abort, 'what a verification found is never deleted');
end;

-- The session that does not fit the robot, while it is in the state check_robot; and who last said that the robot is well, and why. `check_seq` is
-- the number of the last session that did not fit, also when the state is over.
alter table robot add column check_job_id text;
alter table robot add column check_seq bigint not null default 0;
alter table robot add column checked_seq bigint not null default 0;
alter table robot add column checked_reason text;
alter table robot add column checked_by text;
alter table robot add column checked_at_ms bigint;

-- `release_seq` orders the releases of a robot, `supersedes_id` is the set that was active before the last release.
alter table parameter_set add column release_seq bigint;
alter table parameter_set add column supersedes_id text references parameter_set (id);
update parameter_set set release_seq = (
    select max(a.seq) from audit a where a.subject = parameter_set.id and a.event = 'parameter_set_released')
where released_at_ms is not null;
-- Released before there was an audit chain: before all others, in the only order that is known.
update parameter_set set release_seq = (
    select count(*) from parameter_set o
    where o.released_at_ms < parameter_set.released_at_ms or (o.released_at_ms = parameter_set.released_at_ms and o.id <= parameter_set.id))
    - (select count(*) from parameter_set) - 1
where released_at_ms is not null and release_seq is null;
-- A release writes both entries in one transaction, this one first.
update parameter_set set supersedes_id = (
    select a.subject from audit a where a.seq = parameter_set.release_seq - 1 and a.event = 'parameter_set_superseded')
where release_seq > 1;

-- How many gates were passed at the last release, and how many were not.
alter table parameter_set add column release_n_passed bigint;
alter table parameter_set add column release_n_failed bigint;
drop trigger parameter_set_checks;
create trigger parameter_set_checks before update on parameter_set
when new.status = 'released' and old.status <> 'released'
    and (coalesce(new.release_n_passed, 0) < 1 or coalesce(new.release_n_failed, 1) <> 0)
begin
    select raise(abort, 'a parameter set is released with checks, all of them passed');
end;

drop trigger parameter_set_no_better;
create trigger parameter_set_no_better before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from verification v where v.parameter_set_id = new.id and v.kind = 'session' and v.is_better = 0 and v.fit <> 'does_not_fit')
begin
    select raise(abort, 'a parameter set that was shown to be no better than nominal is never released');
end;
create trigger parameter_set_check_robot before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from robot r where r.id = new.robot_id and r.check_job_id is not null)
begin
    select raise(abort, 'the robot is in the state check_robot: a session did not fit it');
end;
-- Until somebody says why: a session that the set missed by far; and a session that did not fit the robot, unless the set was identified from what
-- was measured since, or fits such a session.
create trigger parameter_set_sessions_fit before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from robot r where r.id = new.robot_id and r.check_job_id is null and (
        exists (select 1 from verification v
            where v.parameter_set_id = new.id and v.kind = 'session' and v.fit = 'set_far_off' and v.seq > r.checked_seq)
        or (r.check_seq > r.checked_seq and not exists (select 1 from verification v
            where v.parameter_set_id = new.id and v.seq > r.check_seq and v.is_repeat = 0 and (v.kind = 'identification'
                or (v.fit = 'fits' and v.is_better = 1 and v.evidence = 'independent_session'))))))
begin
    select raise(abort, 'a session speaks against the parameter set or did not fit the robot, and none since supports the set');
end;
drop trigger parameter_set_policy;
create trigger parameter_set_policy before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from robot_policy p where p.robot_id = new.robot_id and (
        (p.independent_session_required = 1 and (coalesce(new.release_evidence, 'none') <> 'independent_session'
            or not exists (select 1 from verification v
                where v.parameter_set_id = new.id and v.fit = 'fits' and v.evidence = 'independent_session')))
        or (p.tolerance_mm is not null and (new.release_uncertainty_mm is null or new.release_uncertainty_mm > p.tolerance_mm
            or exists (select 1 from verification v
                where v.parameter_set_id = new.id and v.fit <> 'does_not_fit' and v.after_rms_mm > p.tolerance_mm)))
        or (p.second_person_required = 1 and not exists (
            select 1 from job j join measurement_set m on m.id = j.measurement_set_id
            where j.id = new.job_id and m.uploaded_by <> new.released_by))))
begin
    select raise(abort, 'the robot''s policy does not allow this release');
end;
