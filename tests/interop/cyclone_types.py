"""The ROS 2 messages that the interop tests exchange, as CycloneDDS types, written down from the .msg files."""

import functools
from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint16, uint32
from cyclonedds.internal import InvalidSample


def taken(reader, most=1000):
    """Messages that have come, without what says no more than that a publisher has gone."""
    return [sample for sample in reader.take(N=most) if not isinstance(sample, InvalidSample)]


def ros(package, name):
    return f"{package}::msg::dds_::{name}_"


@dataclass
class Time(IdlStruct, typename=ros("builtin_interfaces", "Time")):
    sec: int32
    nanosec: uint32

    @property
    def ns(self):
        return self.sec * 1_000_000_000 + self.nanosec


@dataclass
class Header(IdlStruct, typename=ros("std_msgs", "Header")):
    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename=ros("geometry_msgs", "Point")):
    x: float64
    y: float64
    z: float64


@dataclass
class Vector3(IdlStruct, typename=ros("geometry_msgs", "Vector3")):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename=ros("geometry_msgs", "Quaternion")):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename=ros("geometry_msgs", "Pose")):
    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename=ros("geometry_msgs", "PoseStamped")):
    header: Header
    pose: Pose


@dataclass
class PoseWithCovariance(IdlStruct, typename=ros("geometry_msgs", "PoseWithCovariance")):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class PoseWithCovarianceStamped(IdlStruct, typename=ros("geometry_msgs", "PoseWithCovarianceStamped")):
    header: Header
    pose: PoseWithCovariance


@dataclass
class VisionInfo(IdlStruct, typename=ros("vision_msgs", "VisionInfo")):
    header: Header
    method: str
    database_location: str
    database_version: int32


@dataclass
class VisionClass(IdlStruct, typename=ros("vision_msgs", "VisionClass")):
    class_id: uint16
    class_name: str


@dataclass
class LabelInfo(IdlStruct, typename=ros("vision_msgs", "LabelInfo")):
    header: Header
    class_map: sequence[VisionClass]
    threshold: float32


@dataclass
class String(IdlStruct, typename=ros("std_msgs", "String")):
    data: str


@dataclass
class ObjectHypothesis(IdlStruct, typename=ros("vision_msgs", "ObjectHypothesis")):
    class_id: str
    score: float64


@dataclass
class ObjectHypothesisWithPose(IdlStruct, typename=ros("vision_msgs", "ObjectHypothesisWithPose")):
    hypothesis: ObjectHypothesis
    pose: PoseWithCovariance


@dataclass
class BoundingBox3D(IdlStruct, typename=ros("vision_msgs", "BoundingBox3D")):
    center: Pose
    size: Vector3


@dataclass
class Detection3D(IdlStruct, typename=ros("vision_msgs", "Detection3D")):
    header: Header
    results: sequence[ObjectHypothesisWithPose]
    bbox: BoundingBox3D
    id: str


@dataclass
class Detection3DArray(IdlStruct, typename=ros("vision_msgs", "Detection3DArray")):
    header: Header
    detections: sequence[Detection3D]


@dataclass
class Transform(IdlStruct, typename=ros("geometry_msgs", "Transform")):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename=ros("geometry_msgs", "TransformStamped")):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename=ros("tf2_msgs", "TFMessage")):
    transforms: sequence[TransformStamped]


@dataclass
class Image(IdlStruct, typename=ros("sensor_msgs", "Image")):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class CompressedImage(IdlStruct, typename=ros("sensor_msgs", "CompressedImage")):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class RegionOfInterest(IdlStruct, typename=ros("sensor_msgs", "RegionOfInterest")):
    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@dataclass
class CameraInfo(IdlStruct, typename=ros("sensor_msgs", "CameraInfo")):
    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@dataclass
class Point2D(IdlStruct, typename=ros("vision_msgs", "Point2D")):
    x: float64
    y: float64


@dataclass
class Pose2D(IdlStruct, typename=ros("vision_msgs", "Pose2D")):
    position: Point2D
    theta: float64


@dataclass
class BoundingBox2D(IdlStruct, typename=ros("vision_msgs", "BoundingBox2D")):
    center: Pose2D
    size_x: float64
    size_y: float64


@dataclass
class Detection2D(IdlStruct, typename=ros("vision_msgs", "Detection2D")):
    header: Header
    results: sequence[ObjectHypothesisWithPose]
    bbox: BoundingBox2D
    id: str


@dataclass
class Detection2DArray(IdlStruct, typename=ros("vision_msgs", "Detection2DArray")):
    header: Header
    detections: sequence[Detection2D]


@dataclass
class KeyValue(IdlStruct, typename=ros("diagnostic_msgs", "KeyValue")):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename=ros("diagnostic_msgs", "DiagnosticStatus")):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename=ros("diagnostic_msgs", "DiagnosticArray")):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class Log(IdlStruct, typename=ros("rcl_interfaces", "Log")):
    stamp: Time
    level: uint8
    name: str
    msg: str
    file: str
    function: str
    line: uint32


@dataclass
class Gid(IdlStruct, typename=ros("rmw_dds_common", "Gid")):
    """Since Iron; Humble's has 24 bytes."""

    data: array[uint8, 16]


@dataclass
class NodeEntitiesInfo(IdlStruct, typename=ros("rmw_dds_common", "NodeEntitiesInfo")):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename=ros("rmw_dds_common", "ParticipantEntitiesInfo")):
    gid: Gid
    node_entities_info_seq: sequence[NodeEntitiesInfo]


@functools.cache
def garbled(kind):
    """A type of the same name that says nothing of what that type says: a message that cannot be read."""
    name = kind.__idl_typename__.replace(".", "::")

    @dataclass
    class Garbled(IdlStruct, typename=name):
        byte: uint8

    return Garbled
