#!/usr/bin/env bash
# A detector that says where things are, not how they are turned: CycloneDDS plays a camera and, late, rectangles (vision_msgs/Detection2DArray) with
# the frames of bags/tabletop_dense; `pseudoflow run config/graphs/live_rectangles.yaml` finds poses in them, follows, and /object_pose comes back.
# Needs: the Python packages cyclonedds and rosbags (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
out=$(mktemp -d)
trap 'kill %1 2>/dev/null || true; wait; rm -rf "$out"' EXIT
echo "== camera and rectangles -> live graph -> /object_pose, ${FRAMES:-3000} frames at 30 Hz at most, a detector that takes 0.5 s"
"$target/release/pseudoflow" run config/graphs/live_rectangles.yaml --out "$out/run" >"$out/log" 2>&1 &
run=$!
timeout 300 "$python" "$interop/cyclone_live.py" bags/tabletop_dense "${FRAMES:-3000}" 30 0.5 rectangles || { tail -n 40 "$out/log" >&2; exit 1; }
kill -INT "$run"
wait "$run" || { echo "the run did not end in order" >&2; tail -n 40 "$out/log" >&2; exit 1; }
! grep -E "/detections: [0-9]+ dropped" "$out/log" || exit 1
echo "ok: live rectangles"
