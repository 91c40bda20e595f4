#!/usr/bin/env bash
# `adapt` takes the recording of a bent camera: OpenCV bends the demo's as three lenses would, the player rectifies it, and labels come of it as of the straight one.
# Needs: the Python packages rosbags, PyYAML and opencv-python-headless (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for lens in ${LENSES:-straight equidistant}; do
    bag=$folder/$lens
    "$python" tests/compare/bend_recording.py bags/tabletop_demo "$bag" "${lens/straight/plumb_bob}" $([ "$lens" != straight ] || echo straight)
    # 3: trained, and found not better, as is to be expected of so few steps.
    "$target/release/pseudoflow" adapt --bag "$bag" --init /initial_poses --objects config/objects/tabletop \
        --weights config/weights/nano_tabletop.safetensors --out "$bag.safetensors" --steps "${STEPS:-5}" --batch 1 \
        --partners 1 --size "${SIZE:-64}" --tau 16 2>"$bag.log" || [ $? = 3 ] || { tail -n 20 "$bag.log"; exit 1; }
    ! cmp -s "$bag.adapt/teacher.safetensors" config/weights/nano_tabletop.safetensors
    [ "$lens" = straight ] || grep -q "images are rectified: $lens" "$bag.log"
    cp "$bag.adapt/adapt.csv" "$bag.csv"
done
"$python" - "$folder" <<'PY'
import csv, pathlib, sys
rows = {path.stem: list(csv.DictReader(path.open())) for path in pathlib.Path(sys.argv[1]).glob("*.csv")}
for lens, steps in rows.items():
    kept, straight = (float(of[-1]["valid_fraction"]) for of in (steps, rows["straight"]))
    print(f"{lens}: {len(steps)} steps, labels on {kept:.3f} of the surface, off by {float(steps[-1]['epe_px']):.2f} px from the student")
    assert len(steps) == len(rows["straight"]) and abs(kept - straight) < 0.05, (lens, kept, straight)
PY
echo "ok: adapt bent"
