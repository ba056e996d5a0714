# kincal as a container: `docker build -t kincal .`, then
# `docker run --read-only --cap-drop ALL -p 127.0.0.1:8080:8080 -e KINCAL_INSECURE_HTTP=1 -v kincal-data:/data kincal`.
# Inside the container it listens beyond loopback, which takes TLS or a word: see docs/operations.md.
# All that it writes is in /data, so the root file system may be read-only. docs/operations.md says more.

FROM rust:1.95-slim-bookworm AS build
WORKDIR /build
COPY . .
RUN --mount=type=cache,target=/usr/local/cargo/registry --mount=type=cache,target=/build/target \
    cargo build --release --locked --bin kincal && install -D target/release/kincal out/kincal

FROM debian:bookworm-slim
RUN useradd --system --uid 10001 --no-create-home --home-dir /data --shell /usr/sbin/nologin kincal \
    && install --directory --owner=kincal --group=kincal --mode=0700 /data
COPY --from=build /build/out/kincal /usr/local/bin/kincal
USER 10001
WORKDIR /data
VOLUME /data
ENV KINCAL_DATA_DIR=/data KINCAL_LISTEN=0.0.0.0:8080
EXPOSE 8080
STOPSIGNAL SIGTERM
# Whoever runs the container asks GET /healthz (alive) and GET /readyz (may get traffic) from outside.
HEALTHCHECK NONE
ENTRYPOINT ["kincal"]
CMD ["serve"]
