"""Messages in Foxglove's schemas and in two of ours. Their packages are an extra."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf import message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.schema import build_file_descriptor_set


@dataclass(frozen=True)
class Schema:
    """Name and content of a channel's schema."""

    name: str
    data: bytes


Payload = tuple[Schema, bytes]

_LINE_M, _LETTER_M = 0.003, 0.02
_PREDICTED = Color(r=0.80, g=0.47, b=0.65, a=1.0)  # as in the pictures


@cache
def _schema(kind: Any) -> Schema:
    name = str(kind.DESCRIPTOR.full_name)
    return Schema(name, build_file_descriptor_set(kind).SerializeToString())


def _payload(message: Any) -> Payload:
    return _schema(message.__class__), message.SerializeToString(deterministic=True)


def _declared(name: str, /, **kinds: int) -> Any:
    """A message ``frogkick.NAME`` with a field of each kind; limbs are a list."""
    file = FileDescriptorProto(name=f"frogkick/{name}.proto", package="frogkick", syntax="proto3")
    message = file.message_type.add(name=name)
    for number, (field, kind) in enumerate(kinds.items(), 1):
        label = "LABEL_REPEATED" if field == "limbs" else "LABEL_OPTIONAL"
        message.field.add(name=field, number=number, type=kind, label=FieldDescriptorProto.Label.Value(label))
    pool = DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"frogkick.{name}"))


_INT, _NUMBER, _TEXT = (
    FieldDescriptorProto.TYPE_SINT32,
    FieldDescriptorProto.TYPE_DOUBLE,
    FieldDescriptorProto.TYPE_STRING,
)
_DECISION = _declared("Decision", action=_INT, name=_TEXT, cost=_NUMBER, plan_s=_NUMBER)
_STROKE = _declared("Stroke", limb_mask=_INT, limbs=_INT, pulse_s=_NUMBER)


def _stamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 10**9, nanos=time_ns % 10**9)


def _rotation(heading_rad: float) -> Quaternion:
    return Quaternion(z=math.sin(heading_rad / 2.0), w=math.cos(heading_rad / 2.0))


def _pose(pose: Sequence[float]) -> Pose:
    x, y, heading = (float(value) for value in pose)
    return Pose(position=Vector3(x=x, y=y), orientation=_rotation(heading))


class Foxglove:
    """Messages of each schema: (schema, bytes). Poses are x (m), y (m), heading (rad) in the named frame."""

    def decision(self, **values: Any) -> Payload:
        """A decision: action (-1: unseen), its name, cost and planning time (s); NaN: unknown."""
        return _payload(_DECISION(**values))

    def stroke(self, **values: Any) -> Payload:
        """A pulse: its limbs as bits and as numbers, and its length (s)."""
        return _payload(_STROKE(**values))

    def pose(self, time_ns: int, frame: str, pose: Sequence[float]) -> Payload:
        """A pose at a time."""
        return _payload(PoseInFrame(timestamp=_stamp(time_ns), frame_id=frame, pose=_pose(pose)))

    def poses(self, time_ns: int, frame: str, poses: Sequence[Sequence[float]]) -> Payload:
        """A row of poses: a path."""
        return _payload(
            PosesInFrame(timestamp=_stamp(time_ns), frame_id=frame, poses=[_pose(pose) for pose in poses])
        )

    def transform(self, time_ns: int, parent: str, child: str, pose: Sequence[float]) -> Payload:
        """Pose of a frame in its parent."""
        x, y, heading = (float(value) for value in pose)
        return _payload(
            FrameTransform(
                timestamp=_stamp(time_ns),
                parent_frame_id=parent,
                child_frame_id=child,
                translation=Vector3(x=x, y=y),
                rotation=_rotation(heading),
            )
        )

    def step(
        self, time_ns: int, frame: str, step: Sequence[Sequence[float]], action: str, lifetime_ns: int
    ) -> Payload:
        """The chosen action: a line from the robot's pose to the predicted one, with the action's name."""
        points = [Point3(x=float(pose[0]), y=float(pose[1])) for pose in step]
        line = LinePrimitive(
            type=LinePrimitive.Type.LINE_STRIP,
            pose=_pose((0.0, 0.0, 0.0)),
            thickness=_LINE_M,
            points=points,
            color=_PREDICTED,
        )
        text = TextPrimitive(
            pose=_pose(step[1]), billboard=True, font_size=_LETTER_M, color=_PREDICTED, text=action
        )
        entity = SceneEntity(
            timestamp=_stamp(time_ns),
            frame_id=frame,
            id="plan",
            lifetime=Duration(seconds=lifetime_ns // 10**9, nanos=lifetime_ns % 10**9),
            lines=[line],
            texts=[text],
        )
        return _payload(SceneUpdate(entities=[entity]))
