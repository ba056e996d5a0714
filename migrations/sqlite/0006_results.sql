-- What a release rests on stays as it was computed.

create trigger job_report_stays before update of report_json, convergence_json, result_sha256 on job
when old.status in ('succeeded', 'failed', 'cancelled')
begin
    select raise(abort, 'the result of a job is never changed');
end;
create trigger frames_stay before update of id, robot_id, content_type, body, result_json on frames
begin
    select raise(abort, 'frames are never changed: upload the sweeps again');
end;
