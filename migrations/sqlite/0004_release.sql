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

create trigger parameter_set_policy before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from robot_policy p where p.robot_id = new.robot_id and (
        (p.independent_session_required = 1 and coalesce(new.release_evidence, 'none') <> 'independent_session')
        or (p.tolerance_mm is not null and (new.release_uncertainty_mm is null or new.release_uncertainty_mm > p.tolerance_mm))
        or (p.second_person_required = 1 and not exists (
            select 1 from job j join measurement_set m on m.id = j.measurement_set_id
            where j.id = new.job_id and m.uploaded_by <> new.released_by))))
begin
    select raise(abort, 'the robot''s policy does not allow this release');
end;
create trigger parameter_set_no_better before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from job where kind = 'verify' and parameter_set_input_id = new.id and status = 'succeeded'
        and report_json like '%"code":"no_better_than_nominal"%')
begin
    select raise(abort, 'a parameter set that was shown to be no better than nominal is never released');
end;
create trigger measurement_set_uploader_stays before update of uploaded_by, serial_number on measurement_set
begin
    select raise(abort, 'an upload is never changed');
end;
