-- What a robot has under a name: mappings of columns, work frames and tools. A document is never changed. The highest version of a name is in force: a
-- counter, because the clock may be set back. Mappings of columns were in a table of their own, the newest by the clock.
create table named_document (
    id            text   not null primary key,
    robot_id      text   not null references robot (id),
    kind          text   not null check (kind in ('columns', 'work_frame', 'tool')),
    name          text   not null,
    version       bigint not null check (version > 0),
    content_json  text   not null,
    created_by    text   not null,
    created_at_ms bigint not null,
    unique (robot_id, kind, name, version)
);
insert into named_document (id, robot_id, kind, name, version, content_json, created_by, created_at_ms)
select id, robot_id, 'columns', name, row_number() over (partition by robot_id, name order by id), columns_json, created_by, created_at_ms
from column_mapping;
drop table column_mapping;
create trigger named_document_stays before update on named_document
begin
    select raise(abort, 'a named document is never changed: its next version takes its place');
end;
