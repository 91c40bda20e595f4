#!/usr/bin/env bash
# How long a 640 x 480 frame takes between two processes, in turn over iceoryx2 (runtime's example `hop_bench`) and over
# DDS (RustDDS, 127.0.0.1). Event-driven at both ends, one copy of the pixels into the message in both.
#   hop_over_dds.sh [FRAMES] [ROUNDS]
set -euo pipefail
cd "$(dirname "$0")/../.."
export ROS_LOCALHOST_ONLY=1 ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$(($$ % 100))}
cargo build --quiet --release --workspace --examples
examples="${CARGO_TARGET_DIR:-target}/release/examples"
for _ in $(seq "${2:-3}"); do
    "$examples/hop_bench" "${1:-300}"
    "$examples/hop_over_dds" "${1:-300}"
done
