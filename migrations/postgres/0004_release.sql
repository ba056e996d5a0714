-- What a robot asks of a release, kept by the schema as well as by the code.

create table robot_policy (
    robot_id                     text   not null primary key references robot (id),
    tolerance_mm                 double precision check (tolerance_mm > 0),
    independent_session_required bigint not null check (independent_session_required in (0, 1)),
    second_person_required       bigint not null check (second_person_required in (0, 1)),
    version                      bigint not null check (version > 0),
    changed_by                   text   not null,
    changed_at_ms                bigint not null
);

-- Who uploaded (the id of a key) and the serial number that the uploader stated; unknown for what is older.
alter table measurement_set add column uploaded_by text;
alter table measurement_set add column serial_number text;

-- What the release rests on.
alter table parameter_set add column release_evidence text check (release_evidence in ('none', 'same_upload', 'independent_session'));
alter table parameter_set add column release_uncertainty_mm double precision;

-- A trigger's condition cannot look into other tables here, so the function does.
create function kincal_refuse_by_policy() returns trigger language plpgsql as $$
begin
    if exists (
        select 1 from robot_policy p where p.robot_id = new.robot_id and (
            (p.independent_session_required = 1 and coalesce(new.release_evidence, 'none') <> 'independent_session')
            or (p.tolerance_mm is not null and (new.release_uncertainty_mm is null or new.release_uncertainty_mm > p.tolerance_mm))
            or (p.second_person_required = 1 and not exists (
                select 1 from job j join measurement_set m on m.id = j.measurement_set_id
                where j.id = new.job_id and m.uploaded_by <> new.released_by))))
    then
        raise exception 'the robot''s policy does not allow this release' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create function kincal_refuse_no_better() returns trigger language plpgsql as $$
begin
    if exists (
        select 1 from job where kind = 'verify' and parameter_set_input_id = new.id and status = 'succeeded'
            and report_json like '%"code":"no_better_than_nominal"%')
    then
        raise exception 'a parameter set that was shown to be no better than nominal is never released'
            using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;

create trigger parameter_set_policy before update on parameter_set
    for each row when (new.status = 'released' and old.status <> 'released') execute function kincal_refuse_by_policy();
create trigger parameter_set_no_better before update on parameter_set
    for each row when (new.status = 'released' and old.status <> 'released') execute function kincal_refuse_no_better();
create trigger measurement_set_uploader_stays before update of uploaded_by, serial_number on measurement_set
    for each row execute function kincal_refuse('an upload is never changed');
