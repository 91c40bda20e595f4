#!/usr/bin/env bash
# Two graphs side by side, started as ROS 2 starts nodes, share no topic but those that all nodes share; parameter files and remapping
# rules reach them, what reaches nothing is one line each, and what is said at the start is heard on /rosout. Needs: the Python package cyclonedds (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
out=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$out"' EXIT
# Named in the log as not honoured.
export ROS_DISCOVERY_SERVER=127.0.0.1:11811
cat >"$out/left.yaml" <<'YAML'
/left/eye:
  ros__parameters:
    qos_overrides: {/left/object_pose: {publisher: {reliability: best_effort}}}
/somebody/else:
  ros__parameters: {window: 99}
YAML
cat >"$out/other.yaml" <<'YAML'
/somebody/else:
  ros__parameters: {window: 99}
YAML
"$target/release/pseudoflow" run tests/interop/camera.yaml --out "$out/l" --ros-args -r __ns:=/left -r __node:=eye \
    -r image_raw:=/camera/image_raw -r never:=ever -p recorder.path:="$out/left_bag" --params-file "$out/left.yaml" --params-file "$out/other.yaml" \
    --log-level warn >"$out/left.log" 2>&1 &
left=$!
"$target/release/pseudoflow" run tests/interop/camera.yaml --out "$out/r" --ros-args -r __ns:=/right \
    -p recorder.path:="$out/right_bag" >"$out/right.log" 2>&1 &
right=$!
timeout 120 "$python" "$interop/cyclone_namespaces.py" || { tail -n 40 "$out"/*.log >&2; exit 1; }
kill -INT "$left" "$right"
wait "$left" "$right" || { echo "a run did not end in order" >&2; tail -n 40 "$out"/*.log >&2; exit 1; }
[ "$(grep -c "remapping /left/never:=/left/ever matches no topic" "$out/left.log")" = 1 ]
[ "$(grep -c "other.yaml: no parameters for /left/eye" "$out/left.log")" = 1 ]
! grep -q " INFO " "$out/left.log"
grep -q " INFO " "$out/right.log"
echo "ok: namespaces"
