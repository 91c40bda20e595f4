#!/usr/bin/env bash
# Builds the package as a ROS 2 workspace does (colcon, colcon-ros-cargo, cargo-ament-build; no ROS needed), then starts what was installed
# as a launch file does. Needs: cargo-ament-build on the PATH or in PEERS, colcon-core and colcon-ros-cargo beside PYTHON.
source "$(dirname "$0")/../interop/environment.sh"
# Not part of tests/run yet: colcon-cargo hands --cargo-args to `cargo metadata` too, which refuses --release.
workspace=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$workspace"' EXIT
export PATH="$(dirname "$(command -v "$python")"):${PEERS:-/nonexistent}/bin:$PATH"
command -v cargo-ament-build >/dev/null || cargo install --quiet --locked --root "${PEERS:?}" cargo-ament-build@0.1.11
mkdir -p "$workspace/build"
# What is compiled already is not compiled again.
ln -s "$target" "$workspace/build/pseudoflow"
cd "$workspace"
colcon build --base-paths "$root/nodes/cli" --packages-select pseudoflow --cargo-args --release
installed=$workspace/install/pseudoflow
for file in lib/pseudoflow/pseudoflow share/pseudoflow/package.xml share/pseudoflow/launch/track.launch.yaml \
    share/pseudoflow/rviz/pseudoflow.rviz share/pseudoflow/config/graphs/live_track.yaml \
    share/ament_index/resource_index/packages/pseudoflow; do
    [ -e "$installed/$file" ] || { echo "not installed: $file" >&2; exit 1; }
done
printf '/left/pseudoflow:\n  ros__parameters: {window: 3}\n' >"$workspace/f.yaml"
cp "$interop/camera.yaml" "$workspace/camera.yaml"
cd "$installed/share/pseudoflow"
"$installed/lib/pseudoflow/pseudoflow" run "$workspace/camera.yaml" --out "$workspace/run" --set recorder.path="$workspace/bag" \
    --ros-args -r __ns:=/left --params-file "$workspace/f.yaml" >"$workspace/log" 2>&1 &
run=$!
for _ in $(seq 300); do
    grep -q "node /left/pseudoflow" "$workspace/log" && break
    sleep 0.1
done
grep -q "node /left/pseudoflow" "$workspace/log" || { cat "$workspace/log" >&2; exit 1; }
kill -INT "$run"
wait "$run"
echo "ok: colcon"
