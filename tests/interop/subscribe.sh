#!/usr/bin/env bash
# The example that subscribes from Python, without ROS: it prints what the bridge publishes.
# Needs: the Python package cyclonedds (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
out=$(mktemp)
trap 'rm -f "$out"' EXIT
prints=(bash -o pipefail -c '"$0" "$1" 20 | tee "$2"' "$python" "$root/nodes/cli/examples/subscribe.py" "$out")
both "example: bridge -> subscribe.py, 20 poses" "${prints[@]}" -- "$publish_poses" 60 30 1
# Frame 3, if it came: 3 mm to the right, 6 mm up, turned by 0.03 rad about z.
grep -qF "camera_optical: x +0.003 y -0.006 z +1.009 m, rotation +0.000 +0.000 +0.015 +1.000" "$out"
[ "$(wc -l <"$out")" = 20 ]
echo "ok: subscribe.py"
