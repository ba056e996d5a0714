-- Work frames and tools of a robot, under a name. A new frame of a name is a new row, and the newest one holds.
create table named_frame (
    id            text   not null primary key,
    robot_id      text   not null references robot (id),
    kind          text   not null check (kind in ('work_frame', 'tool')),
    name          text   not null,
    content_json  text   not null,
    created_by    text   not null,
    created_at_ms bigint not null
);
create index named_frame_of_robot on named_frame (robot_id, kind, name, id);
create trigger named_frame_stays before update on named_frame
    for each row execute function kincal_refuse('a work frame or tool is never changed: a new one takes its place');
