-- A session in which a set is far off may mean that the robot has changed. It counts against the set until somebody has given a reason after it and
-- the set has fitted a session that was measured later.
drop trigger parameter_set_no_better;
create trigger parameter_set_no_better before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from verification v where v.parameter_set_id = new.id and v.kind = 'session' and v.is_better = 0 and v.fit <> 'does_not_fit'
        and not (v.fit = 'set_far_off' and v.seq <= (select r.checked_seq from robot r where r.id = new.robot_id)
            and exists (select 1 from verification w where w.parameter_set_id = v.parameter_set_id and w.seq > v.seq and w.kind = 'session'
                and w.fit = 'fits' and w.is_better = 1 and w.evidence = 'independent_session' and w.is_repeat = 0)))
begin
    select raise(abort, 'a parameter set that was shown to be no better than nominal is never released');
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
                where v.parameter_set_id = new.id and v.fit <> 'does_not_fit' and v.after_rms_mm > p.tolerance_mm
        and not (v.fit = 'set_far_off' and v.seq <= (select r.checked_seq from robot r where r.id = new.robot_id)
            and exists (select 1 from verification w where w.parameter_set_id = v.parameter_set_id and w.seq > v.seq and w.kind = 'session'
                and w.fit = 'fits' and w.is_better = 1 and w.evidence = 'independent_session' and w.is_repeat = 0)))))
        or (p.second_person_required = 1 and not exists (
            select 1 from job j join measurement_set m on m.id = j.measurement_set_id
            where j.id = new.job_id and m.uploaded_by <> new.released_by))))
begin
    select raise(abort, 'the robot''s policy does not allow this release');
end;
