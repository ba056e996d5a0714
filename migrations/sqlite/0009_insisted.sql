-- The code of the suspicion that an uploader insisted on; no release rests on such a set, neither identified from it nor held out in it.
alter table measurement_set add column insisted_on text;
create trigger measurement_set_insisted_stays before update of insisted_on on measurement_set
begin
    select raise(abort, 'an upload is never changed');
end;
create trigger parameter_set_insisted before update on parameter_set
when new.status = 'released' and old.status <> 'released' and exists (
    select 1 from job j join measurement_set m on m.id = j.measurement_set_id or m.id = j.verify_set_id
    where j.id = new.job_id and m.insisted_on is not null)
begin
    select raise(abort, 'no release rests on an upload that was insisted on');
end;
