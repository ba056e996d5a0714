-- What a release rests on stays as it was computed.

create trigger job_report_stays before update of report_json, convergence_json, result_sha256 on job
    for each row when (old.status in ('succeeded', 'failed', 'cancelled'))
    execute function kincal_refuse('the result of a job is never changed');
create trigger frames_stay before update of id, robot_id, content_type, body, result_json on frames
    for each row execute function kincal_refuse('frames are never changed: upload the sweeps again');
