#!/usr/bin/env bash
# A camera whose lens bends, live: CycloneDDS plays a recording that OpenCV has bent, and the poses that come back are those of the same recording
# in replay, to the bit. BAG, SIZE and LENSES name other ones: what a bag scores, it scores live.
# Needs: the Python packages cyclonedds, rosbags, PyYAML, Pillow and opencv-python-headless (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
out=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$out"' EXIT
for lens in ${LENSES:-rational_polynomial}; do
    "$python" tests/compare/bend_recording.py "${BAG:-bags/tabletop_demo}" "$out/$lens" "$lens"
    "$target/release/pseudoflow" run config/graphs/refine.yaml --without bridge,evaluator --out "$out/$lens.run" --set source="$out/$lens" \
        --set size_px="${SIZE:-64}" --set recorder.path="$out/$lens.replay" --set recorder.overlay=null >"$out/log" 2>&1 || { tail -n 40 "$out/log" >&2; exit 1; }
    "$target/release/pseudoflow" run tests/interop/bent.yaml --out "$out/$lens.live" --set size_px="${SIZE:-64}" >"$out/log" 2>&1 &
    run=$!
    timeout 1800 "$python" "$interop/cyclone_bent.py" "$out/$lens" "$out/$lens.replay" || { tail -n 40 "$out/log" >&2; exit 1; }
    kill -INT "$run"
    wait "$run" || { echo "the run did not end in order" >&2; tail -n 40 "$out/log" >&2; exit 1; }
    grep -q "images are rectified: $lens" "$out/log"
done
echo "ok: bent"
