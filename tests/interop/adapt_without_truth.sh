#!/usr/bin/env bash
# Ground truth in a recording changes nothing: a bag with the true poses as one more topic and the same bag without give
# the same bytes of weights. Needs: the Python package rosbags (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
cd "$root"
[ -n "${SKIP_BUILD:-}" ] || cargo build --release --workspace
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$python" tests/interop/copy_with_truth.py bags/tabletop_demo "$folder/without"
"$python" tests/interop/copy_with_truth.py bags/tabletop_demo "$folder/with" bags/tabletop_demo_truth/scene_gt.json
for bag in without with; do
    # 3: trained, and found not better, as is to be expected of so few steps.
    "$target/release/pseudoflow" adapt --bag "$folder/$bag" --init /initial_poses --objects config/objects/tabletop \
        --weights config/weights/nano_tabletop.safetensors --out "$folder/$bag.safetensors" --steps 5 --batch 1 \
        --partners 1 --size 64 --tau 16 2>"$folder/$bag.log" || [ $? = 3 ] || { tail -n 20 "$folder/$bag.log"; exit 1; }
done
cmp "$folder/without.adapt/teacher.safetensors" "$folder/with.adapt/teacher.safetensors"
! cmp -s "$folder/with.adapt/teacher.safetensors" config/weights/nano_tabletop.safetensors
grep -q "/ground_truth" <("$target/release/pseudoflow" bag info "$folder/with")
echo "ok: the truth in a bag is not used"
