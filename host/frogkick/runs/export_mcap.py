"""Export of a run as MCAP for Foxglove: poses, path and plan in its own schemas, decisions and strokes in
ours. It needs the packages of the extra ``mcap``.

All messages are protobuf, and the file contains their schemas. Times are of the wall clock where the log has
it, else they count from 1970. Poses are in the pool's frame; the robot's frame has x forward and y left.
"""

from __future__ import annotations

import json
import math
import pathlib
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import Any

import numpy as np
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
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from frogkick.core.files import atomic_path, write_text
from frogkick.runs.runlog import RunLog

POOL, ROBOT = "pool", "robot"
"""Names of frames."""

CHANNELS = ("/fix", "/estimate", "/predicted", "/truth", "/path", "/plan", "/tf", "/decision", "/stroke")
"""Channels without a message are left out."""

LAYOUT = {
    "configById": {
        "3D!pool": {
            "followTf": POOL,
            "followMode": "follow-none",
            "cameraState": {"perspective": False, "distance": 2.0, "phi": 0.0, "thetaOffset": 90.0},
            "topics": {
                topic: {"visible": True} for topic in CHANNELS if topic not in ("/decision", "/stroke")
            },
        },
        "StateTransitions!actions": {
            "isSynced": True,
            "paths": [{"value": "/decision.name", "timestampMethod": "receiveTime"}],
        },
        "Plot!decisions": {
            "isSynced": True,
            "xAxisVal": "timestamp",
            "paths": [
                {"value": f"/decision.{key}", "enabled": True, "timestampMethod": "receiveTime"}
                for key in ("cost", "plan_s")
            ],
        },
    },
    "globalVariables": {},
    "userNodes": {},
    "playbackConfig": {"speed": 1},
    "layout": {
        "direction": "row",
        "first": "3D!pool",
        "second": {"direction": "column", "first": "StateTransitions!actions", "second": "Plot!decisions"},
        "splitPercentage": 65,
    },
}
"""Foxglove's layout: the pool from above, the actions, and the cost of decisions."""


_LINE_M, _LETTER_M = 0.003, 0.02
_PREDICTED = Color(r=0.80, g=0.47, b=0.65, a=1.0)  # as in the pictures


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


def _ns(time_s: float) -> int:
    return round(float(time_s) * 1e9)


def _rotation(heading_rad: float) -> Quaternion:
    return Quaternion(z=math.sin(heading_rad / 2.0), w=math.cos(heading_rad / 2.0))


def _pose(pose: Iterable[float]) -> Pose:
    x, y, heading = (float(value) for value in pose)
    return Pose(position=Vector3(x=x, y=y), orientation=_rotation(heading))


def export_mcap(run: RunLog, target: pathlib.Path) -> dict[str, int]:
    """Write an MCAP, and beside it a layout for Foxglove (*Import from file...* among its layouts).

    Returns:
        Number of messages of each channel.

    Raises:
        InputError: the file cannot be written.
    """
    messages = sorted(_messages(run), key=lambda message: message[1])
    counts: dict[str, int] = {}
    with atomic_path(target) as temporary, temporary.open("wb") as file:
        # Uncompressed: the bytes do not depend on the version of a compressor.
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="", library="frogkick")
        writer.add_metadata(
            "run",
            {
                "robot_id": run.robot_id,
                "source": run.source,
                "period_s": repr(run.period_s),
                "pulse_s": repr(run.pulse_s),
                "table_crc": "" if run.table_crc is None else f"{run.table_crc:08x}",
                "notes": run.notes,
                **run.made,
            },
        )
        channels: dict[str, int] = {}
        schemas: dict[str, int] = {}
        for topic, time_ns, message in messages:
            name = str(message.DESCRIPTOR.full_name)
            if name not in schemas:
                schema = build_file_descriptor_set(type(message)).SerializeToString()
                schemas[name] = writer.register_schema(name, "protobuf", schema)
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "protobuf", schemas[name])
            data, number = message.SerializeToString(deterministic=True), counts.get(topic, 0)
            writer.add_message(channels[topic], time_ns, data, publish_time=time_ns, sequence=number)
            counts[topic] = number + 1
        writer.finish()  # type: ignore[no-untyped-call]
    write_text(target.with_suffix(".layout.json"), json.dumps(LAYOUT, indent=2) + "\n")
    return {topic: counts[topic] for topic in CHANNELS if topic in counts}


Message = tuple[str, int, Any]
"""Channel, time (ns) and protobuf message."""


def _messages(run: RunLog) -> Iterator[Message]:
    """All messages, channel by channel; times before the run's start count as its start."""
    began_at = run.made.get("began_at")
    begin_ns = 0
    if began_at is not None:  # a float has too few digits for nanoseconds since 1970
        past = datetime.fromisoformat(began_at) - datetime(1970, 1, 1, tzinfo=UTC)
        begin_ns = (past.days * 86_400 + past.seconds) * 10**9 + past.microseconds * 1000

    def at(time_s: float) -> int:
        return begin_ns + max(0, _ns(time_s))

    fixes, strokes, seen = run.fixes, run.strokes, run.fixes.usable
    track = list(zip(fixes.capture_time_s[seen], fixes.pose_world[seen], strict=True))
    for time_s, (capture_s, pose) in zip(fixes.time_s[seen], track, strict=True):
        # The message has the capture time, its log time is the arrival.
        yield "/fix", at(time_s), _pose_at(at(capture_s), pose)
    for number, time_s in enumerate(run.decisions.time_s):
        yield from _decision(run, number, at(time_s))
    for time_s, mask, pulse_s in zip(strokes.time_s, strokes.limb_mask, strokes.pulse_s, strict=True):
        limbs = [limb for limb in range(8) if int(mask) >> limb & 1]
        yield "/stroke", at(time_s), _STROKE(limb_mask=int(mask), limbs=limbs, pulse_s=float(pulse_s))
    if run.truth is not None:
        track = list(zip(run.truth.time_s, run.truth.pose_world, strict=True))
        for time_s, pose in track:
            yield "/truth", at(time_s), _pose_at(at(time_s), pose)
    for from_s, path in run.paths:
        points = np.column_stack([path.x_m, path.y_m, path.tangent_rad])
        from_ns = at(from_s) if math.isfinite(from_s) else begin_ns
        poses = [_pose(point) for point in points]
        yield "/path", from_ns, PosesInFrame(timestamp=_stamp(from_ns), frame_id=POOL, poses=poses)
    for time_s, (x, y, heading) in track:  # the true poses of a simulated run, else its fixes
        moved = FrameTransform(
            timestamp=_stamp(at(time_s)),
            parent_frame_id=POOL,
            child_frame_id=ROBOT,
            translation=Vector3(x=float(x), y=float(y)),
            rotation=_rotation(float(heading)),
        )
        yield "/tf", at(time_s), moved


def _pose_at(time_ns: int, pose: Iterable[float]) -> PoseInFrame:
    return PoseInFrame(timestamp=_stamp(time_ns), frame_id=POOL, pose=_pose(pose))


def _decision(run: RunLog, row: int, time_ns: int) -> Iterator[Message]:
    decisions = run.decisions
    action = int(decisions.action[row])
    name = run.action_names[action] if action >= 0 else ""
    cost, plan_s = (
        math.nan if values is None else float(values[row]) for values in (decisions.cost, decisions.plan_s)
    )
    yield "/decision", time_ns, _DECISION(action=action, name=name, cost=cost, plan_s=plan_s)
    if decisions.estimate is None or not np.isfinite(decisions.estimate[row]).all():
        return
    estimate = decisions.estimate[row, :3]
    yield "/estimate", time_ns, _pose_at(time_ns, estimate)
    if decisions.predicted is None or not np.isfinite(decisions.predicted[row]).all():
        return
    predicted, period_ns = decisions.predicted[row, :3], _ns(run.period_s)
    yield "/predicted", time_ns, _pose_at(time_ns + period_ns, predicted)
    # The chosen action: a line from the robot's pose to the predicted one, with the action's name.
    line = LinePrimitive(
        type=LinePrimitive.Type.LINE_STRIP,
        pose=_pose((0.0, 0.0, 0.0)),
        thickness=_LINE_M,
        points=[Point3(x=float(pose[0]), y=float(pose[1])) for pose in (estimate, predicted)],
        color=_PREDICTED,
    )
    text = TextPrimitive(
        pose=_pose(predicted), billboard=True, font_size=_LETTER_M, color=_PREDICTED, text=name
    )
    entity = SceneEntity(
        timestamp=_stamp(time_ns),
        frame_id=POOL,
        id="plan",
        lifetime=Duration(seconds=period_ns // 10**9, nanos=period_ns % 10**9),
        lines=[line],
        texts=[text],
    )
    yield "/plan", time_ns, SceneUpdate(entities=[entity])
