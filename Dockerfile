# The binary and its configuration, without a GPU: docker build -t pseudoflow . && docker run --net=host --ipc=host pseudoflow \
#   run config/graphs/live_track.yaml --ros-args -p camera.image:=/camera/image_raw
# Discovery needs the host's network, and the nodes share images in the host's /dev/shm.
FROM rust:1.95-bookworm AS build
WORKDIR /src
COPY . .
RUN cargo build --release --locked -p pseudoflow

# The engine for networks on processors: three times as fast as the one inside the binary.
FROM python:3.11-slim-bookworm AS engine
RUN pip install --no-cache-dir --target /engine onnxruntime==1.31.1

FROM debian:bookworm-slim
COPY --from=build /src/target/release/pseudoflow /usr/local/bin/
COPY --from=engine /engine/onnxruntime/capi/libonnxruntime.so.1.31.1 /usr/local/lib/
ENV ORT_DYLIB_PATH=/usr/local/lib/libonnxruntime.so.1.31.1
WORKDIR /opt/pseudoflow
COPY config config
COPY bags bags
ENTRYPOINT ["pseudoflow"]
CMD ["--help"]
