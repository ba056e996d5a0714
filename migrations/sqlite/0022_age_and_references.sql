-- Named documents of kind reference: lengths with a certificate that the instrument measured. As in step 18, a check constraint that concerns no stored
-- row is changed in the schema's text, and the column added below makes other connections read it again.
pragma writable_schema = on;
update sqlite_schema set sql = replace(sql, 'kind in (''columns'', ''work_frame'', ''tool'')', 'kind in (''columns'', ''work_frame'', ''tool'', ''reference'')')
where type = 'table' and name = 'named_document';
pragma writable_schema = reset;

-- The number in the audit chain of the upload in which the points of the job appeared first; of several sessions, the newest of these. A copy is as
-- old as what it copies. 0: unknown, as for jobs of older versions; then the job's own uploads count.
alter table verification add column measured_seq bigint not null default 0;

-- Two rules change. A session that is no evidence (`evidence` none) does not condemn a set: neither for being no better than nominal, nor because
-- its few points have no stated uncertainty. A session whose errors are several times those of the identification (`is_worse`) does not support one.
drop trigger parameter_set_no_better;
create trigger parameter_set_no_better before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from verification v where v.parameter_set_id = new.id and v.kind = 'session' and v.is_better = 0 and v.fit <> 'does_not_fit'
        and v.evidence <> 'none'
        and not (v.fit = 'set_far_off' and v.seq <= (select r.checked_seq from robot r where r.id = new.robot_id)
            and exists (select 1 from verification w where w.parameter_set_id = v.parameter_set_id and w.seq > v.seq and w.kind = 'session'
                and w.fit = 'fits' and w.is_better = 1 and w.is_worse = 0 and w.evidence = 'independent_session' and w.is_repeat = 0)))
begin
    select raise(abort, 'a parameter set that was shown to be no better than nominal is never released');
end;

drop trigger parameter_set_sessions_fit;
create trigger parameter_set_sessions_fit before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from robot r where r.id = new.robot_id and r.check_job_id is null and (
        exists (select 1 from verification v
            where v.parameter_set_id = new.id and v.kind = 'session' and v.fit = 'set_far_off' and v.seq > r.checked_seq)
        or (r.check_seq > r.checked_seq and not exists (select 1 from verification v
            where v.parameter_set_id = new.id and v.seq > r.check_seq and v.is_repeat = 0 and (v.kind = 'identification'
                or (v.fit = 'fits' and v.is_better = 1 and v.is_worse = 0 and v.evidence = 'independent_session'))))))
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
                where v.parameter_set_id = new.id and v.fit <> 'does_not_fit'
        and v.n_points > 0 and (v.after_rms_mm is null or v.after_rms_mm > p.tolerance_mm or (p.decision_rule = 'guarded_acceptance'
            and (v.kind = 'identification' or v.evidence <> 'none')
            and (v.after_expanded_mm is null or v.after_rms_mm + v.after_expanded_mm > p.tolerance_mm)))
        and not (v.fit = 'set_far_off' and v.seq <= (select r.checked_seq from robot r where r.id = new.robot_id)
            and exists (select 1 from verification w where w.parameter_set_id = v.parameter_set_id and w.seq > v.seq and w.kind = 'session'
                and w.fit = 'fits' and w.is_better = 1 and w.is_worse = 0 and w.evidence = 'independent_session' and w.is_repeat = 0)))))
        or (p.second_person_required = 1 and not exists (
            select 1 from job j join measurement_set m on m.id = j.measurement_set_id
            where j.id = new.job_id and m.uploaded_by <> new.released_by))))
begin
    select raise(abort, 'the robot''s policy does not allow this release');
end;

-- The age of the same bytes.
create index measurement_set_bytes on measurement_set (robot_id, sha256);
