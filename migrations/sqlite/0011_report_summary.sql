-- The report of each job without its lists over points, for what needs a few of its facts: a report of 20,000 points has 9 MB. A table of its own,
-- because SQLite reads a row from its beginning, and a new column of the job would come after its report (step 7).
create table report_summary (
    job_id       text not null primary key references job (id),
    summary_json text not null
);
create trigger report_summary_stays before update on report_summary
begin
    select raise(abort, 'the result of a job is never changed');
end;
create trigger report_summary_is_kept before delete on report_summary
begin
    select raise(abort, 'the result of a job is never deleted');
end;
