"""Export of a run as MCAP for Foxglove: poses, path and plan in its own schemas, decisions and strokes in
ours.

All messages are protobuf, and the file contains their schemas. Times are of the wall clock where the log has
it, else they count from 1970. Poses are in the pool's frame; the robot's frame has x forward and y left.
"""

from __future__ import annotations

import json
import math
import pathlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from frogkick.core.extras import EXTRAS, require
from frogkick.core.files import atomic_path, write_text
from frogkick.runs.runlog import RunLog

if TYPE_CHECKING:
    from frogkick.runs.foxglove import Schema

POOL, ROBOT = "pool", "robot"
"""Names of frames."""

CHANNELS = ("/fix", "/estimate", "/predicted", "/truth", "/path", "/plan", "/tf", "/decision", "/stroke")
"""Channels without a message are left out."""

ENCODING = "protobuf"

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


def export_mcap(run: RunLog, target: pathlib.Path) -> dict[str, int]:
    """Write an MCAP, and beside it a layout for Foxglove (*Import from file...* among its layouts).

    Returns:
        Number of messages of each channel.

    Raises:
        InputError: the packages for it are not installed, or the file cannot be written.
    """
    require("MCAP", *EXTRAS["mcap"])
    from mcap.writer import CompressionType, Writer

    from frogkick.runs.foxglove import Foxglove

    messages = sorted(_messages(run, Foxglove()), key=lambda message: message.time_ns)
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
        for message in messages:
            schema = message.schema
            if schema.name not in schemas:
                schemas[schema.name] = writer.register_schema(schema.name, ENCODING, schema.data)
            if message.topic not in channels:
                channels[message.topic] = writer.register_channel(
                    message.topic, ENCODING, schemas[schema.name]
                )
            writer.add_message(
                channels[message.topic],
                log_time=message.time_ns,
                publish_time=message.time_ns,
                sequence=counts.get(message.topic, 0),
                data=message.data,
            )
            counts[message.topic] = counts.get(message.topic, 0) + 1
        writer.finish()  # type: ignore[no-untyped-call]
    write_text(target.with_suffix(".layout.json"), json.dumps(LAYOUT, indent=2) + "\n")
    return {topic: counts[topic] for topic in CHANNELS if topic in counts}


@dataclass(frozen=True)
class Message:
    """One message of a channel."""

    topic: str
    time_ns: int
    schema: Schema
    data: bytes


def _ns(time_s: float) -> int:
    return round(float(time_s) * 1e9)


def _since_1970_ns(moment: datetime) -> int:
    past = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (past.days * 86_400 + past.seconds) * 10**9 + past.microseconds * 1000


def _messages(run: RunLog, foxglove: Any) -> Iterator[Message]:
    """All messages, channel by channel; times before the run's start count as its start."""
    began_at = run.made.get("began_at")
    # A float has too few digits for nanoseconds since 1970.
    begin_ns = 0 if began_at is None else _since_1970_ns(datetime.fromisoformat(began_at))

    def at(time_s: float) -> int:
        return begin_ns + max(0, _ns(time_s))

    fixes = run.fixes
    seen = fixes.pose_world
    for row in np.flatnonzero(fixes.usable):
        # The message has the capture time, its log time is the arrival.
        taken_ns = at(fixes.capture_time_s[row])
        yield Message("/fix", at(fixes.time_s[row]), *foxglove.pose(taken_ns, POOL, seen[row]))
    decisions = run.decisions
    for number, time_s in enumerate(decisions.time_s):
        yield from _decision(run, number, at(time_s), foxglove)
    for time_s, mask, pulse_s in zip(
        run.strokes.time_s, run.strokes.limb_mask, run.strokes.pulse_s, strict=True
    ):
        limbs = [limb for limb in range(8) if int(mask) >> limb & 1]
        stroke = foxglove.stroke(limb_mask=int(mask), limbs=limbs, pulse_s=float(pulse_s))
        yield Message("/stroke", at(time_s), *stroke)
    if run.truth is not None:
        for time_s, pose in zip(run.truth.time_s, run.truth.pose_world, strict=True):
            yield Message("/truth", at(time_s), *foxglove.pose(at(time_s), POOL, pose))
    for from_s, path in run.paths:
        poses = np.column_stack([path.x_m, path.y_m, path.tangent_rad])
        from_ns = at(from_s) if math.isfinite(from_s) else begin_ns
        yield Message("/path", from_ns, *foxglove.poses(from_ns, POOL, poses))
    for time_s, pose in _best_poses(run):
        yield Message("/tf", at(time_s), *foxglove.transform(at(time_s), POOL, ROBOT, pose))


def _decision(run: RunLog, row: int, time_ns: int, foxglove: Any) -> Iterator[Message]:
    decisions = run.decisions
    action = int(decisions.action[row])
    name = run.action_names[action] if action >= 0 else ""
    cost, plan_s = (
        math.nan if values is None else float(values[row]) for values in (decisions.cost, decisions.plan_s)
    )
    yield Message(
        "/decision", time_ns, *foxglove.decision(action=action, name=name, cost=cost, plan_s=plan_s)
    )
    if decisions.estimate is None or not np.isfinite(decisions.estimate[row]).all():
        return
    estimate = decisions.estimate[row]
    yield Message("/estimate", time_ns, *foxglove.pose(time_ns, POOL, estimate[:3]))
    if decisions.predicted is None or not np.isfinite(decisions.predicted[row]).all():
        return
    predicted = decisions.predicted[row]
    yield Message("/predicted", time_ns, *foxglove.pose(time_ns + _ns(run.period_s), POOL, predicted[:3]))
    step = (estimate[:3], predicted[:3])
    yield Message("/plan", time_ns, *foxglove.step(time_ns, POOL, step, name, _ns(run.period_s)))


def _best_poses(run: RunLog) -> Iterator[tuple[float, NDArray[np.float64]]]:
    """Times and poses of the robot: the true ones of a simulated run, else its fixes."""
    if run.truth is not None:
        yield from zip(run.truth.time_s, run.truth.pose_world, strict=True)
        return
    usable = run.fixes.usable
    yield from zip(run.fixes.capture_time_s[usable], run.fixes.pose_world[usable], strict=True)
