"""Every field of every message that the live graph receives, wrong in every way.

`WRONG[topic]()` gives pairs: the kind under which the bridge must count the message, and a function that spoils a good one of the
stamp of the image that is on its way. A pair with a list as kind counts more than once.
"""

import math

import cyclone_types as ros

NAN, INF = math.nan, math.inf
HUGE = 2**32 - 1


def change(kind, *spoil):
    return kind, lambda message: [one(message) for one in spoil]


def put(path, value):
    """Sets a field; numbers in the path are places in sequences."""

    def spoil(message):
        *way, last = path
        for step in way:
            message = message[step] if isinstance(step, int) else getattr(message, step)
        if isinstance(last, int):
            message[last] = value
        else:
            setattr(message, last, value)

    return spoil


def shift(seconds, ns=0):
    def spoil(message):
        stamp = message.header.stamp
        message.header.stamp = ros.Time(*divmod((stamp.sec + seconds) * 10**9 + stamp.nanosec + ns, 10**9))

    return spoil


STAMPS = [
    change("stamp", put(["header", "stamp", "sec"], -1)),
    change("stamp", put(["header", "stamp", "sec"], -(2**31))),
    change("stamp", put(["header", "stamp", "nanosec"], 10**9)),
    change("stamp", put(["header", "stamp", "nanosec"], HUGE)),
]


def images():
    def of(*spoil):
        return change("image", *spoil)

    def data(bytes_of):
        return lambda m: setattr(m, "data", bytes_of(m.data))

    small = [put(["width"], 1), put(["height"], 1), put(["step"], 3), data(lambda d: d[:3])]
    return STAMPS + [
        change("frame_id", put(["header", "frame_id"], "f" * 64)),
        change("frame_id", put(["header", "frame_id"], "f" * 100_000)),
        *[of(put(["encoding"], name)) for name in ["16UC1", "32FC1", "", "rgb", "bayer_", "x" * 5000, "nv12\n"]],
        of(put(["width"], 0)), of(put(["height"], 0)), of(put(["width"], 0), put(["height"], 0)),
        of(put(["width"], HUGE)), of(put(["height"], HUGE)), of(put(["width"], HUGE), put(["height"], HUGE)),
        of(put(["width"], HUGE), put(["step"], HUGE)), of(put(["height"], 2**31), put(["step"], 2**31)),
        of(put(["step"], 0)), of(put(["step"], 1)), of(put(["step"], HUGE)),
        of(data(lambda d: d[:100])), of(data(lambda d: d[:0])), of(data(lambda d: d[:-1])),
        # Good in itself, but not of the size that its calibration is for.
        change("calibration", *small),
        *[change("unpaired", shift(10**6 + i)) for i in range(15)],
    ]


def files():
    def of(*spoil):
        return change("image", *spoil)

    def data(bytes_of):
        return lambda m: setattr(m, "data", bytes_of(bytes(m.data)))

    # A PNG that claims 4 billion pixels a side.
    bomb = bytes.fromhex("89504e470d0a1a0a0000000d49484452ffffffffffffffff0802000000") + bytes(20)
    return STAMPS + [
        change("frame_id", put(["header", "frame_id"], "f" * 64)),
        of(data(lambda d: b"")), of(data(lambda d: d[:10])), of(data(lambda d: bytes(len(d)))), of(data(lambda d: d[::-1])),
        of(data(lambda d: bomb)), of(data(lambda d: b"GIF89a" + bytes(100))),
        of(put(["format"], "16UC1; compressedDepth"), data(lambda d: d[12:])),
        *[change("unpaired", shift(10**6 + i)) for i in range(15)],
    ]


def infos():
    def of(*spoil):
        return change("calibration", *spoil)

    bent = put(["d"], [-0.1, 0.0, 0.0, 0.0, 0.0])
    return STAMPS + [
        *[of(put(["k", at], value)) for at in (0, 4) for value in (NAN, INF, -INF, 0.0, -600.0)],
        *[of(put(["k", at], value)) for at in (2, 5) for value in (NAN, INF)],
        of(put(["k", 1], 3.0)),
        *[of(put(["d"], [value] * 5)) for value in (NAN, INF, -INF)],
        of(put(["d"], [0.1] * 3)), of(put(["d"], [0.1] * 14)), of(put(["d"], [0.1] * 100_000)),
        of(put(["distortion_model"], "thin_prism"), bent), of(put(["distortion_model"], "x" * 5000), bent),
        of(put(["distortion_model"], "equidistant"), put(["d"], [0.1] * 5)),
        # Folds back within the image.
        of(put(["d"], [-9.0, 0.0, 0.0, 0.0, 0.0])),
        *[of(put(["r", at], value)) for at in (0, 8) for value in (NAN, INF, 5.0)],
        of(put(["r"], [0.5] * 9)),
        *[of(bent, put(["p", at], value)) for at in (0, 5) for value in (NAN, -1.0)],
        of(put(["width"], 77)), of(put(["height"], 77)), of(put(["width"], 0)), of(put(["width"], HUGE)),
        of(put(["binning_x"], HUGE)), of(put(["binning_y"], 3)),
        of(put(["roi", "x_offset"], HUGE)), of(put(["roi", "y_offset"], 10**6)),
        of(put(["roi", "width"], HUGE)), of(put(["roi", "width"], 5), put(["roi", "height"], 5)),
        *[change("unpaired", shift(10**6 + i)) for i in range(15)],
    ]


def headers():
    """What is wrong in the headers of answers."""
    return STAMPS + [
        change("frame_id", put(["header", "frame_id"], "elsewhere")),
        change("frame_id", put(["header", "frame_id"], "")),
        change("frame_id", put(["header", "frame_id"], "f" * 100_000)),
        change("late", shift(-100)), change("stamp", shift(0, -1)),
        *[change("future", shift(10**6 + i)) for i in range(15)],
    ]


def results():
    """What is wrong in what answers say of one object."""
    said = ["detections", 0, "results", 0, "hypothesis"]
    return [
        change("empty", put(["detections", 0, "results"], [])),
        *[change("unknown object", put([*said, "class_id"], name)) for name in ["teapot", "", "4", "-1", "9" * 40, "x" * 5000]],
        *[change("score", put([*said, "score"], value)) for value in (NAN, INF, -INF)],
        (["unknown object"] * 500, lambda m: [put([*said, "class_id"], "teapot")(m), setattr(m, "detections", m.detections * 500)]),
    ]


def detections():
    pose = ["detections", 0, "results", 0, "pose"]
    at, turn = [*pose, "pose", "position"], [*pose, "pose", "orientation"]

    def of(*spoil):
        return change("pose", *spoil)

    return headers() + results() + [
        *[of(put([*at, axis], value)) for axis in "xyz" for value in (NAN, INF, -INF, 1e30)],
        of(put([*at, "z"], 0.0)), of(put([*at, "z"], -0.5)),
        *[of(put([*turn, axis], value)) for axis in "xyzw" for value in (NAN, INF, 7.0)],
        of(*[put([*turn, axis], 0.0) for axis in "xyzw"]),
        *[change("covariance", put([*pose, "covariance", at], value)) for at in (0, 20, 35) for value in (NAN, INF)],
    ]


def rectangles():
    box = ["detections", 0, "bbox"]
    middle = [*box, "center", "position"]

    def of(*spoil):
        return change("rectangle", *spoil)

    return headers() + results() + [
        *[of(put([*middle, axis], value)) for axis in "xy" for value in (NAN, INF)],
        *[of(put([*box, side], value)) for side in ("size_x", "size_y") for value in (NAN, INF, 0.0, -5.0)],
        change("outside", put([*middle, "x"], 1e6)), change("outside", put([*middle, "y"], -1e30)),
    ]


WRONG = {
    "/camera/image_raw": images, "/camera/image_raw/compressed": files, "/camera/camera_info": infos,
    "/detections": detections, "/rectangles": rectangles,
}
