# The binary and its configuration, without a GPU: docker build -t pseudoflow . && docker run --net=host --ipc=host pseudoflow \
#   run config/graphs/live_track.yaml --ros-args -p camera.image:=/camera/image_raw
# Discovery needs the host's network, and the nodes share images in the host's /dev/shm.
FROM rust:1.95-bookworm AS build
WORKDIR /src
COPY . .
RUN cargo build --release --locked -p pseudoflow

FROM debian:bookworm-slim
COPY --from=build /src/target/release/pseudoflow /usr/local/bin/
WORKDIR /opt/pseudoflow
COPY config config
COPY bags bags
ENTRYPOINT ["pseudoflow"]
CMD ["--help"]
