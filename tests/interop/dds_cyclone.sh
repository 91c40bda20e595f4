#!/usr/bin/env bash
# CycloneDDS, one of the two middlewares under ROS 2, receives every pose of the bridge and plays its camera.
# Needs: the Python packages cyclonedds and Pillow (PYTHON names the interpreter).
source "$(dirname "$0")/environment.sh"
cd "$interop"
both "poses: bridge -> CycloneDDS, 100 frames" \
    "$python" cyclone_receive_poses.py 100 -- "$publish_poses" 100 60 1
both "images: CycloneDDS -> camera, 100 frames of 640 x 480" \
    "$receive_images" raw 100 -- "$python" cyclone_send_images.py raw 100 30
both "compressed images: CycloneDDS -> camera, 100 frames of 640 x 480" \
    "$receive_images" compressed 100 -- "$python" cyclone_send_images.py compressed 100 30
echo "ok: CycloneDDS"
