-- Column types are limited to what passes through sqlx's Any driver on both engines:
-- text, bigint (epoch milliseconds, counts), bytea. Documents are JSON text the store does not interpret.

create view clock as
    select cast(floor(extract(epoch from clock_timestamp()) * 1000) as bigint) as now_ms;

create table robot (
    id            text   not null primary key,
    name          text   not null,
    body_json     text   not null,
    created_at_ms bigint not null
);
create index robot_newest on robot (created_at_ms, id);

create table measurement_set (
    id               text   not null primary key,
    robot_id         text   not null references robot (id),
    name             text,
    frame            text   not null check (frame in ('base', 'instrument')),
    content_type     text   not null,
    body             bytea  not null,
    sha256           text   not null,
    n_points         bigint not null,
    n_configurations bigint not null,
    n_targets        bigint not null,
    warnings_json    text   not null,
    created_at_ms    bigint not null
);
create index measurement_set_newest on measurement_set (robot_id, created_at_ms, id);

create table frames (
    id            text   not null primary key,
    robot_id      text   not null references robot (id),
    content_type  text   not null,
    body          bytea  not null,
    result_json   text   not null,
    created_at_ms bigint not null
);
create index frames_newest on frames (robot_id, created_at_ms, id);

create table job (
    id                     text   not null primary key,
    robot_id               text   not null references robot (id),
    measurement_set_id     text   not null references measurement_set (id),
    verify_set_id          text   references measurement_set (id),
    frames_id              text   references frames (id),
    network_input_id       text,
    parameter_set_input_id text,
    kind                   text   not null check (kind in ('identify', 'verify')),
    method                 text   not null,
    request_json           text   not null,
    status                 text   not null check (status in ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    priority               bigint not null,
    attempt                bigint not null check (attempt >= 0),
    owner                  text,
    lease_until_ms         bigint,
    cancel_requested_at_ms bigint,
    progress_json          text,
    error_json             text,
    report_json            text,
    convergence_json       text,
    result_sha256          text,
    created_at_ms          bigint not null,
    started_at_ms          bigint,
    finished_at_ms         bigint,
    check ((status = 'running') = (lease_until_ms is not null)),
    check (status <> 'running' or owner is not null),
    check ((status in ('succeeded', 'failed', 'cancelled')) = (finished_at_ms is not null)),
    check ((status = 'succeeded') = (report_json is not null)),
    check ((status = 'failed') = (error_json is not null))
);
create index job_waiting on job (priority desc, created_at_ms, id) where status = 'queued';
create index job_waiting_of_robot on job (robot_id) where status = 'queued';
create index job_leased on job (lease_until_ms) where status = 'running';
create index job_newest on job (robot_id, created_at_ms, id);

create table network (
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
create index network_newest on network (robot_id, created_at_ms, id);

create table parameter_set (
    id                  text   not null primary key,
    robot_id            text   not null references robot (id),
    job_id              text   not null unique references job (id),
    status              text   not null check (status in ('candidate', 'released', 'superseded', 'withdrawn')),
    body_json           text   not null,
    sha256              text   not null,
    created_at_ms       bigint not null,
    released_at_ms      bigint,
    release_reason      text,
    release_checks_json text,
    withdrawn_at_ms     bigint,
    withdraw_reason     text,
    check (status not in ('released', 'superseded') or released_at_ms is not null),
    check (released_at_ms is null or release_checks_json is not null),
    check ((status = 'withdrawn') = (withdrawn_at_ms is not null))
);
create index parameter_set_newest on parameter_set (robot_id, created_at_ms, id);
create unique index parameter_set_one_released on parameter_set (robot_id) where status = 'released';

alter table job add foreign key (network_input_id) references network (id);
alter table job add foreign key (parameter_set_input_id) references parameter_set (id);

create table idempotency (
    key_holder      text   not null,
    method          text   not null,
    path            text   not null,
    idempotency_key text   not null,
    request_sha256  text   not null,
    status          bigint,
    location        text,
    content_type    text,
    response_body   bytea,
    created_at_ms   bigint not null,
    primary key (key_holder, method, path, idempotency_key)
);
create index idempotency_oldest on idempotency (created_at_ms);

create table api_key (
    id            text   not null primary key,
    name          text   not null,
    key_sha256    text   not null unique,
    scopes_json   text   not null,
    robots_json   text,
    created_at_ms bigint not null,
    revoked_at_ms bigint
);
create index api_key_newest on api_key (created_at_ms, id);
