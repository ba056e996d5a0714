-- What the columns of a robot's files mean, under a name. A new mapping of a name is a new row, and the newest one holds.
create table column_mapping (
    id            text   not null primary key,
    robot_id      text   not null references robot (id),
    name          text   not null,
    columns_json  text   not null,
    created_by    text   not null,
    created_at_ms bigint not null
);
create index column_mapping_of_robot on column_mapping (robot_id, name, created_at_ms, id);
create trigger column_mapping_stays before update on column_mapping
begin
    select raise(abort, 'a mapping of columns is never changed');
end;
-- How an upload was read: separator, decimal mark, columns, and how two files were joined. None for JSON and for older sets.
alter table measurement_set add column reading_json text;
create trigger measurement_set_reading_stays before update of reading_json on measurement_set
begin
    select raise(abort, 'an upload is never changed');
end;
