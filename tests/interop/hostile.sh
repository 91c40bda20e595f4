#!/usr/bin/env bash
# Somebody on the network who sends every message wrong in every way: none ends the run or is missed in the account, and the good frames'
# poses are those of a run without him, to the bit. Needs: the Python packages cyclonedds, rosbags and Pillow.
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
out=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$out"' EXIT
for transport in ${TRANSPORTS:-raw compressed}; do
    image=/camera/image_raw
    [ "$transport" = raw ] || image=$image/compressed
    for mood in calm hostile; do
        echo "== $transport images, $mood"
        here=$out/$transport.$mood
        "$target/release/pseudoflow" run tests/interop/hostile.yaml --out "$here" --set recorder.path="$here.bag" \
            --set transport="$transport" --set image="$image" >"$here.log" 2>&1 &
        run=$!
        timeout 900 "$python" "$interop/cyclone_hostile.py" bags/tabletop_dense "${FRAMES:-8}" "$transport" "$mood" "$here.json" \
            || { tail -n 60 "$here.log" >&2; exit 1; }
        kill -INT "$run"
        wait "$run" || { echo "the run did not end in order" >&2; tail -n 60 "$here.log" >&2; exit 1; }
        "$target/release/pseudoflow" bag info "$here.bag" >/dev/null
        "$python" - "$here" "$mood" <<'PY'
import json, sys
nodes = json.load(open(sys.argv[1] + "/summary.json"))["nodes"]
assert not any(node["restarts"] for node in nodes), "a node was started again"
bad = {node["name"]: (node["bad"], node["last_bad"]) for node in nodes if node["bad"]}
assert set(bad) == ({"bridge"} if sys.argv[2] == "hostile" else set()), bad
print("the run's summary:", bad or "nothing bad")
PY
    done
    cmp "$out/$transport.calm.json" "$out/$transport.hostile.json" || { echo "poses differ" >&2; exit 1; }
done
echo "ok: hostile"
