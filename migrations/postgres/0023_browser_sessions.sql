-- Sessions of browsers that signed in with a key. The table has only the SHA-256 of a session's token, as `api_key` has of a key.
create table browser_session (
    token_sha256  text   not null primary key,
    key_id        text   not null references api_key (id),
    created_at_ms bigint not null
);
create index browser_session_of_key on browser_session (key_id, created_at_ms);
