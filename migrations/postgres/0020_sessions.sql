-- The further sets of a job of several sessions; `job.measurement_set_id` is the first. A table of its own, as on SQLite.
create table job_session (
    job_id             text   not null references job (id),
    place              bigint not null check (place > 0),
    measurement_set_id text   not null references measurement_set (id),
    primary key (job_id, place),
    unique (job_id, measurement_set_id)
);
create index job_session_set on job_session (measurement_set_id);
create trigger job_session_stays before update on job_session
    for each row execute function kincal_refuse('a job keeps its sessions');
create trigger job_session_is_kept before delete on job_session
    for each row execute function kincal_refuse('a job keeps its sessions');

-- Every set that a job fits or scores, without its verify set.
create view job_upload as
    select id as job_id, measurement_set_id from job
    union all select job_id, measurement_set_id from job_session;

-- What parameter_set_insisted and the second person's rule of parameter_set_policy ask of the first set, of the further ones.
create function kincal_refuse_by_sessions() returns trigger language plpgsql as $$
begin
    if exists (
        select 1 from job_session s join measurement_set m on m.id = s.measurement_set_id
        where s.job_id = new.job_id and (m.insisted_on is not null
            or (coalesce(m.uploaded_by, new.released_by) = new.released_by
                and exists (select 1 from robot_policy p where p.robot_id = new.robot_id and p.second_person_required = 1))))
    then
        raise exception 'one of the sessions that were fitted does not allow this release' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create trigger parameter_set_sessions before update on parameter_set
    for each row when (new.status = 'released' and old.status <> 'released') execute function kincal_refuse_by_sessions();
