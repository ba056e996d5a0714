-- Robots that are edited, and things that are put away.

-- A robot after an edit. The robot's own row keeps it as it was created, which is version 1; `robot.version` is the one in force and `robot.name` its
-- name. `joint_map_version` is the version in which the joint map last changed.
alter table robot add column version bigint not null default 1;
create table robot_version (
    robot_id          text   not null references robot (id),
    version           bigint not null check (version > 1),
    joint_map_version bigint not null check (joint_map_version between 1 and version),
    body_json         text   not null,
    changed_by        text   not null,
    changed_at_ms     bigint not null,
    primary key (robot_id, version)
);
create trigger robot_version_stays before update on robot_version
begin
    select raise(abort, 'a version of a robot is never changed: edit it again');
end;
create trigger robot_version_is_kept before delete on robot_version
begin
    select raise(abort, 'a version of a robot is never deleted');
end;
create trigger robot_joint_map_stays before insert on robot_version
when new.joint_map_version = new.version
    and exists (select 1 from parameter_set p where p.robot_id = new.robot_id and p.released_at_ms is not null)
begin
    select raise(abort, 'a set was released with this joint map, so it is never changed');
end;

-- The version of its robot that a job computes with; no row for version 1. A table of its own, because a new column of the job would come after its
-- report (step 7).
create table job_robot_version (
    job_id  text   not null primary key references job (id),
    version bigint not null check (version > 1)
);
create trigger job_robot_version_stays before update on job_robot_version
begin
    select raise(abort, 'a job keeps the version of its robot');
end;
create trigger job_robot_version_is_kept before delete on job_robot_version
begin
    select raise(abort, 'a job keeps the version of its robot');
end;

-- What was put away, until it is restored.
create table archived (
    id             text   not null primary key,
    kind           text   not null check (kind in ('robot', 'measurement_set', 'job', 'parameter_set', 'network')),
    robot_id       text   not null references robot (id),
    archived_by    text   not null,
    archived_at_ms bigint not null
);
create trigger archived_stays before update on archived
begin
    select raise(abort, 'archive it anew instead');
end;
create trigger archived_not_released before insert on archived
when new.kind = 'parameter_set' and exists (select 1 from parameter_set p where p.id = new.id and p.released_at_ms is not null)
begin
    select raise(abort, 'a parameter set that was released is never archived');
end;
create trigger archived_job_is_over before insert on archived
when new.kind = 'job' and exists (select 1 from job j where j.id = new.id and j.status in ('queued', 'running'))
begin
    select raise(abort, 'a job that has not ended is not archived');
end;

create trigger measurement_set_robot_in_use before insert on measurement_set
when exists (select 1 from archived a where a.id = new.robot_id)
begin
    select raise(abort, 'the robot is archived');
end;
create trigger frames_robot_in_use before insert on frames
when exists (select 1 from archived a where a.id = new.robot_id)
begin
    select raise(abort, 'the robot is archived');
end;
create trigger job_robot_in_use before insert on job
when exists (select 1 from archived a where a.id = new.robot_id)
begin
    select raise(abort, 'the robot is archived');
end;
-- A rollback releases a superseded set, and stays possible on an archived robot.
create trigger parameter_set_in_use before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from archived a where a.id = new.id or (a.id = new.robot_id and old.status = 'candidate'))
begin
    select raise(abort, 'the parameter set or its robot is archived');
end;
create trigger parameter_set_joint_map before update on parameter_set
when new.status = 'released' and old.status <> 'released'
    and coalesce((select v.joint_map_version from robot r join robot_version v on v.robot_id = r.id and v.version = r.version
            where r.id = new.robot_id), 1)
        <> coalesce((select v.joint_map_version from job_robot_version j join robot_version v on v.robot_id = new.robot_id and v.version = j.version
            where j.job_id = new.job_id), 1)
begin
    select raise(abort, 'the parameter set was identified with a joint map that its robot no longer has');
end;

-- The robots as they are now.
create view robot_now as
    select r.id, r.name, coalesce(v.body_json, r.body_json) as body_json, r.created_at_ms, r.check_job_id, r.check_seq, r.checked_seq,
        r.checked_reason, r.checked_by, r.checked_at_ms, r.version, coalesce(v.joint_map_version, 1) as joint_map_version, lower(r.name) as sort_name,
        coalesce(json_extract(coalesce(v.body_json, r.body_json), '$.serial_number'), '') as serial_number, a.archived_at_ms
    from robot r
    left join robot_version v on v.robot_id = r.id and v.version = r.version
    left join archived a on a.id = r.id;

-- Lists and their totals are read from an index alone.
drop index job_newest;
create index job_newest on job (robot_id, created_at_ms, id, status, kind);
create index job_newest_of_all on job (created_at_ms, id, robot_id, status, kind);
drop index parameter_set_newest;
create index parameter_set_newest on parameter_set (robot_id, created_at_ms, id, status);
