#!/usr/bin/env bash
# Builds the package as a ROS 2 workspace does (colcon, colcon-ros-cargo, cargo-ament-build; no ROS needed), then starts what was installed
# as a launch file does and hears it publish below /left.
# Needs: colcon-core, colcon-ros-cargo, cargo-ament-build and cyclonedds beside PYTHON.
source "$(dirname "$0")/../interop/environment.sh"
workspace=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$workspace"' EXIT
export PATH="$(dirname "$(command -v "$python")"):$PATH"
mkdir -p "$workspace/build"
# What is compiled already is not compiled again: the same target folder, and `--workspace` for the same features.
ln -s "$target" "$workspace/build/pseudoflow"
cd "$workspace"
# colcon-cargo 0.2 reads `cargo metadata`, one line, from a pipe as lines of at most 64 KiB: this workspace's has 100. From a terminal it
# reads it whole, so it is given one.
on_terminal() { "$python" -c 'import pty, sys; sys.exit(pty.spawn(sys.argv[1:]) >> 8)' "$@"; }
on_terminal colcon build --base-paths "$root/nodes/cli" --packages-select pseudoflow --cargo-args --release --workspace
installed=$workspace/install/pseudoflow
for file in lib/pseudoflow/pseudoflow share/pseudoflow/package.xml share/pseudoflow/launch/track.launch.yaml \
    share/pseudoflow/rviz/pseudoflow.rviz share/pseudoflow/config/graphs/live_track.yaml \
    share/ament_index/resource_index/packages/pseudoflow; do
    [ -e "$installed/$file" ] || { echo "not installed: $file" >&2; exit 1; }
done
cat >"$workspace/f.yaml" <<YAML
/left/pseudoflow:
  ros__parameters: {recorder.path: $workspace/bag}
YAML
cp "$interop/camera.yaml" "$workspace/camera.yaml"
cd "$installed/share/pseudoflow"
"$installed/lib/pseudoflow/pseudoflow" run "$workspace/camera.yaml" --out "$workspace/run" \
    --ros-args -r __ns:=/left --params-file "$workspace/f.yaml" >"$workspace/run.log" 2>&1 &
run=$!
timeout 90 "$python" "$root/tests/packaging/hear_left.py" || { cat "$workspace/run.log" >&2; exit 1; }
kill -INT "$run"
wait "$run"
grep -q "$workspace/bag: no frame came" "$workspace/run.log" || { echo "the parameter file did not reach the recorder" >&2; cat "$workspace/run.log" >&2; exit 1; }
echo "ok: colcon"
