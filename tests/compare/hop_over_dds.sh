#!/usr/bin/env bash
# How long a 640 x 480 frame takes between two processes over DDS (RustDDS, 127.0.0.1), to hold beside the hop over
# iceoryx2. Event-driven at both ends; prints p50 and p99.  hop_over_dds.sh [FRAMES]
set -euo pipefail
cd "$(dirname "$0")/../.."
export ROS_LOCALHOST_ONLY=1 ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$(($$ % 100))}
cargo run --quiet --release -p pseudoflow-bridge --example hop_over_dds -- "${1:-300}"
