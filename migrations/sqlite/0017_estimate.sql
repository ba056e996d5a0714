-- The estimate of a parameter set, with its covariance: later sessions are compared with it, and the earlier one is not fitted again. Sets of
-- older versions have none.
create table estimate (
    parameter_set_id text not null primary key references parameter_set (id),
    estimate_json    text not null
);
create trigger estimate_stays before update on estimate
begin
    select raise(abort, 'the result of a job is never changed');
end;
create trigger estimate_is_kept before delete on estimate
begin
    select raise(abort, 'the result of a job is never deleted');
end;
