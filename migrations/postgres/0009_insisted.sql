-- The code of the suspicion that an uploader insisted on; no release rests on such a set, neither identified from it nor held out in it.
alter table measurement_set add column insisted_on text;
create trigger measurement_set_insisted_stays before update of insisted_on on measurement_set
    for each row execute function kincal_refuse('an upload is never changed');
create function kincal_refuse_insisted() returns trigger language plpgsql as $$
begin
    if exists (
        select 1 from job j join measurement_set m on m.id = j.measurement_set_id or m.id = j.verify_set_id
        where j.id = new.job_id and m.insisted_on is not null)
    then
        raise exception 'no release rests on an upload that was insisted on' using errcode = 'integrity_constraint_violation';
    end if;
    return new;
end $$;
create trigger parameter_set_insisted before update on parameter_set
    for each row when (new.status = 'released' and old.status <> 'released') execute function kincal_refuse_insisted();
