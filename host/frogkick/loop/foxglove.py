"""Foxglove's own schemas: poses, paths, frames and drawings as its viewer knows them.

Loaded only where an MCAP is written: its packages are an extra.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.schema import build_file_descriptor_set

from frogkick.loop.export_mcap import Schema

Said = tuple[Schema, bytes]

_LINE_M, _LETTER_M = 0.003, 0.02
_PREDICTED = Color(r=0.80, g=0.47, b=0.65, a=1.0)  # as in the pictures


@cache
def _schema(kind: Any) -> Schema:
    name = str(kind.DESCRIPTOR.full_name)
    return Schema(name, "protobuf", "protobuf", build_file_descriptor_set(kind).SerializeToString())


def _said(message: Any) -> Said:
    return _schema(message.__class__), message.SerializeToString(deterministic=True)


def _stamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 10**9, nanos=time_ns % 10**9)


def _rotation(heading_rad: float) -> Quaternion:
    return Quaternion(z=math.sin(heading_rad / 2.0), w=math.cos(heading_rad / 2.0))


def _pose(pose: Sequence[float]) -> Pose:
    x, y, heading = (float(value) for value in pose)
    return Pose(position=Vector3(x=x, y=y), orientation=_rotation(heading))


class Foxglove:
    """Messages of each schema: (schema, bytes). Poses are x (m), y (m), heading (rad) in the named frame."""

    def pose(self, time_ns: int, frame: str, pose: Sequence[float]) -> Said:
        """A pose at a time."""
        return _said(PoseInFrame(timestamp=_stamp(time_ns), frame_id=frame, pose=_pose(pose)))

    def poses(self, time_ns: int, frame: str, poses: Sequence[Sequence[float]]) -> Said:
        """A row of poses: a path."""
        every = [_pose(pose) for pose in poses]
        return _said(PosesInFrame(timestamp=_stamp(time_ns), frame_id=frame, poses=every))

    def transform(self, time_ns: int, parent: str, child: str, pose: Sequence[float]) -> Said:
        """Where a frame is in another one."""
        x, y, heading = (float(value) for value in pose)
        return _said(
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
    ) -> Said:
        """The chosen action: a line from where the robot is to where it will be, its name beside it."""
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
        return _said(SceneUpdate(entities=[entity]))
