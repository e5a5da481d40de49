# docker build -t densecloud . && docker run -p 8080:8080 -v densecloud:/var/lib/densecloud densecloud
FROM rust:1.95-bookworm AS build
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 python3-pip \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY . .
RUN sh scripts/fetch-onnxruntime.sh && cargo build --release --locked

FROM debian:bookworm-slim
# The folder of the jobs is the user's: a new volume there is, too. A folder of the host must be given to uid 10001.
RUN useradd --system --uid 10001 --no-create-home densecloud \
    && install -d -o 10001 -m 0700 /var/lib/densecloud
# The program looks for the library beside itself.
COPY --from=build /src/target/release/densecloud /src/vendor/onnxruntime/libonnxruntime.so /opt/densecloud/
# Whom to believe that a database or a store is who it says.
COPY --from=build /etc/ssl/certs/ca-certificates.crt /etc/ssl/certs/
USER 10001
# In the environment, so that the health check knows them, too.
ENV DENSECLOUD_HOST=0.0.0.0 DENSECLOUD_PORT=8080
VOLUME /var/lib/densecloud
EXPOSE 8080
HEALTHCHECK --interval=15s --timeout=6s --start-period=60s \
    CMD ["/opt/densecloud/densecloud", "healthcheck"]
ENTRYPOINT ["/opt/densecloud/densecloud"]
# Other arguments take its place: jobs that are shared with other machines are in no folder.
CMD ["serve", "--data-dir", "/var/lib/densecloud"]
