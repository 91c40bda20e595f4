"""What OpenCV makes of lenses and pixels, as golden values for pseudoflow-edge's tests:

    camera_vs_opencv.py OUT.json

Rectification maps (plumb_bob, rational_polynomial: initUndistortRectifyMap; equidistant: fisheye) with a rotation and
another camera matrix, at scattered pixels; and small images in each encoding with their RGB by cvtColor.
"""

import json
import sys

import cv2
import numpy

SIZE = (640, 480)
K = numpy.array([[520.0, 0, 322.3], [0, 518.0, 236.1], [0, 0, 1]])
P = numpy.array([[480.0, 0, 318.0], [0, 482.0, 241.5], [0, 0, 1]])
R = cv2.Rodrigues(numpy.array([0.01, -0.02, 0.005]))[0]
LENSES = {
    "plumb_bob": [-0.28, 0.09, 0.0012, -0.0007, -0.013],
    "plumb_bob4": [0.11, -0.17, -0.0004, 0.0009],
    "rational_polynomial": [0.42, -2.1, 0.0006, -0.0003, 1.4, 0.31, -1.95, 1.33],
    "equidistant": [-0.013, 0.021, -0.017, 0.004],
}


def maps(model, d):
    if model == "equidistant":
        fisheye = getattr(cv2, "fisheye", cv2)
        return fisheye.initUndistortRectifyMap(K, numpy.array(d), R, P, SIZE, cv2.CV_32FC1)
    return cv2.initUndistortRectifyMap(K, numpy.array(d), R, P, SIZE, cv2.CV_32FC1)


def lenses():
    rng = numpy.random.default_rng(1)
    pixels = [[0, 0], [639, 0], [0, 479], [639, 479]]
    pixels += [[int(x), int(y)] for x, y in zip(rng.integers(0, 640, 60), rng.integers(0, 480, 60), strict=True)]
    out = []
    for name, d in LENSES.items():
        x, y = maps(name.rstrip("4"), d)
        out.append({"model": name.rstrip("4"), "d": d, "pixels": pixels,
                    "source": [[float(x[v, u]), float(y[v, u])] for u, v in pixels]})
    return {"size": SIZE, "k": K.ravel().tolist(), "p": P.ravel().tolist(), "r": R.ravel().tolist(), "lenses": out}


def scene(width, height):
    """A smooth picture with some edges, RGB."""
    y, x = numpy.mgrid[0:height, 0:width]
    rgb = numpy.stack([127 + 100 * numpy.sin(x / 5), 127 + 100 * numpy.cos(y / 4), 20 + 4 * (x + y)], -1)
    rgb[height // 2 :, width // 2 :] = [200, 60, 30]
    return rgb.clip(0, 255).astype(numpy.uint8)


def mosaic(rgb, pattern):
    plane = numpy.zeros(rgb.shape[:2], numpy.uint8)
    for i, colour in enumerate(pattern):
        plane[i // 2 :: 2, i % 2 :: 2] = rgb[i // 2 :: 2, i % 2 :: 2, "rgb".index(colour)]
    return plane


def pixels():
    rgb = scene(24, 16)
    out = []

    def add(encoding, data, step, expected):
        out.append({"encoding": encoding, "width": 24, "height": 16, "step": step,
                    "data": numpy.ascontiguousarray(data).tobytes().hex(), "rgb": expected.tobytes().hex()})

    for pattern, code in {"rggb": "BG", "bggr": "RG", "gbrg": "GR", "grbg": "GB"}.items():
        plane = mosaic(rgb, pattern)
        add(f"bayer_{pattern}8", plane, 24, cv2.cvtColor(plane, getattr(cv2, f"COLOR_Bayer{code}2RGB")))
    rng = numpy.random.default_rng(2)
    packed = rng.integers(0, 256, (16, 24, 2), dtype=numpy.uint8)
    for encodings, code in ((("yuv422", "uyvy"), cv2.COLOR_YUV2RGB_UYVY), (("yuv422_yuy2", "yuyv"), cv2.COLOR_YUV2RGB_YUY2)):
        for encoding in encodings:
            add(encoding, packed, 48, cv2.cvtColor(packed, code))
    planes = rng.integers(0, 256, (24, 24), dtype=numpy.uint8)
    add("nv12", planes, 24, cv2.cvtColor(planes, cv2.COLOR_YUV2RGB_NV12))
    add("nv21", planes, 24, cv2.cvtColor(planes, cv2.COLOR_YUV2RGB_NV21))
    deep = rng.integers(0, 65536, (16, 24, 3), dtype=numpy.uint16)
    to_8 = lambda image: cv2.convertScaleAbs(image, alpha=255 / 65535)  # noqa: E731
    add("rgb16", deep, 144, to_8(deep))
    add("bgr16", deep, 144, cv2.cvtColor(to_8(deep), cv2.COLOR_BGR2RGB))
    add("mono16", deep[:, :, 0], 48, cv2.cvtColor(to_8(deep[:, :, 0].copy()), cv2.COLOR_GRAY2RGB))
    return out


def main(path):
    with open(path, "w", encoding="utf-8") as file:
        json.dump({"opencv": cv2.__version__, "camera": lenses(), "pixels": pixels()}, file)


main(*sys.argv[1:])
