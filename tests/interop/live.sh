#!/usr/bin/env bash
# The whole live graph as a robot uses it: CycloneDDS plays a camera and a detector with the frames of bags/tabletop_dense (a camera moves as one does),
# `pseudoflow run config/graphs/live.yaml` refines them in its processes, and /object_pose comes back by CycloneDDS.
# Needs: the Python packages cyclonedds and rosbags (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
out=$(mktemp -d)
trap 'kill %1 2>/dev/null || true; wait; rm -rf "$out"' EXIT
echo "== camera -> live graph -> /object_pose, 300 frames at 30 Hz, a detector that takes 0.5 s"
# The camera publishes compressed images alone: the bridge takes what is there.
"$target/release/pseudoflow" run config/graphs/live.yaml --out "$out/run" >"$out/log" 2>&1 &
run=$!
timeout 150 "$python" "$interop/cyclone_live.py" bags/tabletop_dense 300 30 0.5 || { tail -n 40 "$out/log" >&2; exit 1; }
kill -INT "$run"
wait "$run" || { echo "the run did not end in order" >&2; tail -n 40 "$out/log" >&2; exit 1; }
# No answer was thrown away for want of its image.
! grep -E "/detections: [0-9]+ dropped" "$out/log" || exit 1
echo "ok: live"
