-- Networks of what links and physics leave, beside those of link parameters: a job may keep one of each.

create table residual_network (
    id             text   not null primary key,
    robot_id       text   not null references robot (id),
    job_id         text   not null unique references job (id),
    model          text   not null,
    preset         text   not null,
    metadata_json  text   not null,
    weights        bytea  not null,
    weights_sha256 text   not null,
    created_at_ms  bigint not null
);
create index residual_network_newest on residual_network (robot_id, created_at_ms, id);

-- Where the training of a job's own begins.
alter table job add column residual_network_input_id text references residual_network (id);
