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
    for each row execute function kincal_refuse('a version of a robot is never changed: edit it again');
create trigger robot_version_is_kept before delete on robot_version
    for each row execute function kincal_refuse('a version of a robot is never deleted');
create function kincal_refuse_joint_map() returns trigger language plpgsql as $$
begin
    if new.joint_map_version = new.version
        and exists (select 1 from parameter_set p where p.robot_id = new.robot_id and p.released_at_ms is not null)
    then
        raise exception 'a set was released with this joint map, so it is never changed' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create trigger robot_joint_map_stays before insert on robot_version
    for each row execute function kincal_refuse_joint_map();

-- The version of its robot that a job computes with; no row for version 1. A table of its own, as on SQLite.
create table job_robot_version (
    job_id  text   not null primary key references job (id),
    version bigint not null check (version > 1)
);
create trigger job_robot_version_stays before update on job_robot_version
    for each row execute function kincal_refuse('a job keeps the version of its robot');
create trigger job_robot_version_is_kept before delete on job_robot_version
    for each row execute function kincal_refuse('a job keeps the version of its robot');

-- What was put away, until it is restored.
create table archived (
    id             text   not null primary key,
    kind           text   not null check (kind in ('robot', 'measurement_set', 'job', 'parameter_set', 'network')),
    robot_id       text   not null references robot (id),
    archived_by    text   not null,
    archived_at_ms bigint not null
);
create trigger archived_stays before update on archived
    for each row execute function kincal_refuse('archive it anew instead');
create function kincal_refuse_archiving_released() returns trigger language plpgsql as $$
begin
    if new.kind = 'parameter_set' and exists (select 1 from parameter_set p where p.id = new.id and p.released_at_ms is not null)
    then
        raise exception 'a parameter set that was released is never archived' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create trigger archived_not_released before insert on archived
    for each row execute function kincal_refuse_archiving_released();
create function kincal_refuse_archiving_open_job() returns trigger language plpgsql as $$
begin
    if new.kind = 'job' and exists (select 1 from job j where j.id = new.id and j.status in ('queued', 'running'))
    then
        raise exception 'a job that has not ended is not archived' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create trigger archived_job_is_over before insert on archived
    for each row execute function kincal_refuse_archiving_open_job();

create function kincal_refuse_archived_robot() returns trigger language plpgsql as $$
begin
    if exists (select 1 from archived a where a.id = new.robot_id)
    then
        raise exception 'the robot is archived' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create trigger measurement_set_robot_in_use before insert on measurement_set
    for each row execute function kincal_refuse_archived_robot();
create trigger frames_robot_in_use before insert on frames
    for each row execute function kincal_refuse_archived_robot();
create trigger job_robot_in_use before insert on job
    for each row execute function kincal_refuse_archived_robot();
-- A rollback releases a superseded set, and stays possible on an archived robot.
create function kincal_refuse_release_of_archived() returns trigger language plpgsql as $$
begin
    if exists (
        select 1 from archived a where a.id = new.id or (a.id = new.robot_id and old.status = 'candidate'))
    then
        raise exception 'the parameter set or its robot is archived' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create trigger parameter_set_in_use before update on parameter_set
    for each row when (new.status = 'released' and old.status <> 'released') execute function kincal_refuse_release_of_archived();
create function kincal_refuse_other_joint_map() returns trigger language plpgsql as $$
begin
    if coalesce((select v.joint_map_version from robot r join robot_version v on v.robot_id = r.id and v.version = r.version
            where r.id = new.robot_id), 1)
        <> coalesce((select v.joint_map_version from job_robot_version j join robot_version v on v.robot_id = new.robot_id and v.version = j.version
            where j.job_id = new.job_id), 1)
    then
        raise exception 'the parameter set was identified with a joint map that its robot no longer has' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create trigger parameter_set_joint_map before update on parameter_set
    for each row when (new.status = 'released' and old.status <> 'released') execute function kincal_refuse_other_joint_map();

-- The robots as they are now.
create view robot_now as
    select r.id, r.name, coalesce(v.body_json, r.body_json) as body_json, r.created_at_ms, r.check_job_id, r.check_seq, r.checked_seq,
        r.checked_reason, r.checked_by, r.checked_at_ms, r.version, coalesce(v.joint_map_version, 1) as joint_map_version, lower(r.name) as sort_name,
        coalesce(cast(coalesce(v.body_json, r.body_json) as json) ->> 'serial_number', '') as serial_number, a.archived_at_ms
    from robot r
    left join robot_version v on v.robot_id = r.id and v.version = r.version
    left join archived a on a.id = r.id;

-- Lists and their totals are read from an index alone.
drop index job_newest;
create index job_newest on job (robot_id, created_at_ms, id, status, kind);
create index job_newest_of_all on job (created_at_ms, id, robot_id, status, kind);
drop index parameter_set_newest;
create index parameter_set_newest on parameter_set (robot_id, created_at_ms, id, status);
