# docker build -t densecloud . && docker run -p 8080:8080 densecloud
FROM rust:1.95-bookworm AS build
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 python3-pip \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY . .
RUN sh scripts/fetch-onnxruntime.sh && cargo build --release --locked

FROM debian:bookworm-slim
RUN useradd --system --uid 10001 --no-create-home densecloud
# The program looks for the library beside itself.
COPY --from=build /src/target/release/densecloud /src/vendor/onnxruntime/libonnxruntime.so /opt/densecloud/
USER 10001
EXPOSE 8080
ENTRYPOINT ["/opt/densecloud/densecloud"]
CMD ["serve", "--host", "0.0.0.0", "--port", "8080"]
