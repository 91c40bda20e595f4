#!/usr/bin/env bash
# `rosbags` (rosbag2 anew in Python) and rerun read what the recorder writes (two files: it is killed half-way) and the
# bag of the demo; what `rosbags` writes, plain and compressed, is played and recorded again. Needs: the Python packages rosbags, rerun-sdk, pillow and numpy (PYTHON names the interpreter).
set -euo pipefail
interop=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$interop/../.." && pwd)
python=${PYTHON:-${PEERS:+$PEERS/bin/python}}
python=${python:-python3}
target=${CARGO_TARGET_DIR:-$root/target}
if [ -z "${SKIP_BUILD:-}" ]; then
    cargo build --release --manifest-path "$root/Cargo.toml" --workspace --bins --example write_recording
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$target/release/examples/write_recording" "$folder/run" 20 "$root/config/objects/tabletop"

cd "$interop"
"$python" read_with_rosbags.py "$folder/run" /camera/image/compressed=20 /camera/camera_info=20 /overlay/compressed=20 \
    /initial_poses=20 /object_poses=20 /object_poses/refused=20 /object_pose=20 /objects/cracker_box/pose=20 /tf=20
"$python" read_with_rosbags.py "$folder/run/run_1.mcap" /camera/image/compressed=10
"$python" read_with_rosbags.py "$root/bags/tabletop_demo" /camera/image/compressed=15 \
    /camera/camera_info=15 /initial_poses=15
"$python" read_with_rerun.py "$folder/run" /camera/image/compressed /camera/camera_info /overlay/compressed \
    /initial_poses /object_poses /object_pose /tf
"$python" read_with_rerun.py "$root/bags/tabletop_demo" /camera/image/compressed /camera/camera_info /initial_poses

for compression in "" zstd; do
    "$python" write_with_rosbags.py "$folder/theirs$compression" $compression
    "$target/release/pseudoflow" run replay.yaml --out "$folder/run$compression" \
        --set player.source="$folder/theirs$compression" --set recorder.path="$folder/replayed$compression"
    "$python" read_with_rosbags.py "$folder/replayed$compression" /camera/image/compressed=10 \
        /camera/camera_info=10 /object_poses=10
done
echo "ok: rosbags and rerun"
