-- The jobs that a job's result rests on, and theirs. is_held 1: it holds parameter values that they identified. 0: it kept a residual network whose
-- training went on from theirs. What speaks against their uploads speaks against its parameter set.
create table job_source (
    job_id        text   not null references job (id),
    source_job_id text   not null references job (id),
    is_held       bigint not null check (is_held in (0, 1)),
    primary key (job_id, source_job_id)
);
insert into job_source (job_id, source_job_id, is_held)
with recursive direct (job_id, source_job_id, is_held) as (
    select j.id, p.job_id, 1 from job j join parameter_set p on p.id = j.parameter_set_input_id
    where j.kind = 'identify' and json_extract(j.request_json, '$.parameters.rest') = 'parameter_set'
    union select j.id, r.job_id, 0 from job j join residual_network r on r.id = j.residual_network_input_id
        join residual_network kept on kept.job_id = j.id
), rests (job_id, source_job_id, is_held) as (
    select job_id, source_job_id, is_held from direct
    union select rests.job_id, direct.source_job_id, rests.is_held * direct.is_held from rests join direct on direct.job_id = rests.source_job_id
)
select job_id, source_job_id, max(is_held) from rests group by job_id, source_job_id;
create trigger job_source_stays before update on job_source
begin
    select raise(abort, 'the sources of a job never change');
end;
create trigger job_source_is_kept before delete on job_source
begin
    select raise(abort, 'the sources of a job are never deleted');
end;

create trigger parameter_set_sources before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from job_source s join job_upload u on u.job_id = s.source_job_id join measurement_set m on m.id = u.measurement_set_id
    left join robot_policy p on p.robot_id = new.robot_id
    where s.job_id = new.job_id
        and (m.insisted_on is not null
            or (s.is_held = 1 and p.second_person_required = 1 and coalesce(m.uploaded_by, new.released_by) = new.released_by)))
begin
    select raise(abort, 'the uploads that the set rests on do not allow this release');
end;

-- 1: the errors of a session are several times those on the points that were held out when the set was identified.
alter table verification add column is_worse bigint not null default 0 check (is_worse in (0, 1));
