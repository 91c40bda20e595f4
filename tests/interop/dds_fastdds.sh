#!/usr/bin/env bash
# Fast DDS, one of the two middlewares under ROS 2, receives every pose of the bridge and plays its camera.
# Needs: g++, libfastrtps-dev, libfastcdr-dev (Debian), and Pillow (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
build=$target/interop-fastdds
mkdir -p "$build"
for program in receive_poses send_images; do
    g++ -std=c++17 -O2 -Wall -Wextra -o "$build/$program" "$interop/fastdds/$program.cpp" -lfastrtps -lfastcdr
done
"$python" - "$build" <<'PYTHON'
import sys
from PIL import Image

for index in range(100):
    picture = Image.new("RGB", (640, 480), (index % 256, 100, 200))
    picture.save(f"{sys.argv[1]}/{index}.jpg", quality=95, subsampling=0)
PYTHON
both "poses: bridge -> Fast DDS, 100 frames" \
    "$build/receive_poses" 100 -- "$publish_poses" 100 60 1
both "images: Fast DDS -> camera, 100 frames of 640 x 480" \
    "$receive_images" raw 100 -- "$build/send_images" raw 100 30
both "compressed images: Fast DDS -> camera, 100 frames of 640 x 480" \
    "$receive_images" compressed 100 -- "$build/send_images" compressed 100 30 "$build"
echo "ok: Fast DDS"
