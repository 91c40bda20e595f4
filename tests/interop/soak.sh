#!/usr/bin/env bash
# Frames through a live graph over the real transport, with an engine that only answers: what the processes hold must stay as it is.
#   tests/interop/soak.sh            some, part of tests/run
#   FRAMES=100000 tests/interop/soak.sh
# Needs: the Python packages cyclonedds, Pillow, rosbags and onnx.
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
out=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$out"' EXIT
"$python" "$interop/stub_engine.py" "$out/stub.onnx"
"$target/release/pseudoflow" run tests/interop/soak.yaml --out "$out/run" --set model="$out/stub.onnx" \
    --set recorder.path="$out/recording" >"$out/log" 2>&1 &
run=$!
"$python" "$interop/cyclone_soak.py" "${FRAMES:-1500}" "$run" "$out/run" || { tail -n 40 "$out/log" >&2; exit 1; }
kill -INT "$run"
wait "$run" || { echo "the run did not end in order" >&2; tail -n 40 "$out/log" >&2; exit 1; }
grep -A 8 "^node " "$out/log"
"$target/release/pseudoflow" bag info "$out/recording" | head -n 20
echo "ok: soak"
