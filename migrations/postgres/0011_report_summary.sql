-- The report of each job without its lists over points, for what needs a few of its facts: a report of 20,000 points has 9 MB. A table of its own,
-- as on SQLite.
create table report_summary (
    job_id       text not null primary key references job (id),
    summary_json text not null
);
create trigger report_summary_stays before update on report_summary
    for each row execute function kincal_refuse('the result of a job is never changed');
create trigger report_summary_is_kept before delete on report_summary
    for each row execute function kincal_refuse('the result of a job is never deleted');
