-- Whose turn it is: clients that wait at the same time are served one job each in turn, however many jobs one of them has posted.
alter table job add column client text not null default '';
alter table job add column turn bigint not null default 0;
drop index job_waiting;
create index job_waiting on job (deaths, priority desc, turn, created_at_ms, id) where status = 'queued';
create index job_turns on job (priority, turn) where status = 'queued';
create index job_turns_of_client on job (client, priority, turn) where status = 'queued';
