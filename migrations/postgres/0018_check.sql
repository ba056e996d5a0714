-- Jobs of kind check.
alter table job drop constraint job_kind_check;
alter table job add constraint job_kind_check check (kind in ('identify', 'verify', 'check'));

-- How a figure is compared with the tolerance (ILAC-G8:09/2019): `guarded_acceptance` adds its expanded uncertainty first. None: the policy was set
-- when the figure alone was compared, and that stays so.
alter table robot_policy add column decision_rule text check (decision_rule in ('simple_acceptance', 'guarded_acceptance'));
-- Expanded uncertainty of after_rms_mm (95 %). None where it cannot be stated, and in what older versions found.
alter table verification add column after_expanded_mm double precision;

create or replace function kincal_refuse_by_policy() returns trigger language plpgsql as $$
begin
    if exists (
        select 1 from robot_policy p where p.robot_id = new.robot_id and (
            (p.independent_session_required = 1 and (coalesce(new.release_evidence, 'none') <> 'independent_session'
                or not exists (select 1 from verification v
                    where v.parameter_set_id = new.id and v.fit = 'fits' and v.evidence = 'independent_session')))
            or (p.tolerance_mm is not null and (new.release_uncertainty_mm is null or new.release_uncertainty_mm > p.tolerance_mm
                or exists (select 1 from verification v
                    where v.parameter_set_id = new.id and v.fit <> 'does_not_fit'
        and v.n_points > 0 and (v.after_rms_mm is null or v.after_rms_mm > p.tolerance_mm or (p.decision_rule = 'guarded_acceptance'
            and (v.after_expanded_mm is null or v.after_rms_mm + v.after_expanded_mm > p.tolerance_mm)))
        and not (v.fit = 'set_far_off' and v.seq <= (select r.checked_seq from robot r where r.id = new.robot_id)
            and exists (select 1 from verification w where w.parameter_set_id = v.parameter_set_id and w.seq > v.seq and w.kind = 'session'
                and w.fit = 'fits' and w.is_better = 1 and w.evidence = 'independent_session' and w.is_repeat = 0)))))
            or (p.second_person_required = 1 and not exists (
                select 1 from job j join measurement_set m on m.id = j.measurement_set_id
                where j.id = new.job_id and m.uploaded_by <> new.released_by))))
    then
        raise exception 'the robot''s policy does not allow this release' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
