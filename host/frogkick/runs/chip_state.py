"""A snapshot of the robot's state, as firmware/core/fk_snapshot.c writes it, read for the Python twin.

The guard's state at its end is not read: it does not influence decisions.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from frogkick.core.arrays import Float32
from frogkick.core.errors import FrogkickError
from frogkick.core.weights import WEIGHTS
from frogkick.estimator.estimator import MARKS, Estimator, _Fix
from frogkick.estimator.track import INSTANTS, Track, _Instant
from frogkick.estimator.wear import HELD, OFF
from frogkick.planner.plan import PlanConfig
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMBS_MAX, LOST_MAX


class SnapshotError(FrogkickError):
    """Bytes that are not a snapshot of this robot."""


@dataclass(frozen=True, eq=False)
class Points:
    """A path as the robot holds it: (n,) float32 each, world."""

    x_m: Float32
    y_m: Float32
    tangent_rad: Float32

    def __len__(self) -> int:
        return len(self.x_m)

    def with_part(self, first: int, part: Points) -> Points:
        """The points before an index, and a part from there on."""
        columns = [
            np.concatenate([getattr(self, name)[:first], getattr(part, name)])
            for name in ("x_m", "y_m", "tangent_rad")
        ]
        return Points(*columns)


NO_POINTS = Points(*(np.zeros(0, dtype=np.float32) for _ in range(3)))


@dataclass(frozen=True, eq=False)
class ChipState:
    """The parts of a snapshot that the twin needs.

    Attributes:
        time_us: the robot's clock.
        state: number of the robot's state.
        period_us: between decisions.
        decisions: number of decisions since START.
        next_decision_us: time of the next decision.
        config: cost, weights, depth.
        points, total: path points received so far, and their number in the complete path.
        coming, coming_total: the same of a path that comes during a run.
        along_points, mark, idle: progress along the path, as in ``Follow``.
        estimator: the twin in the robot's state.
    """

    time_us: int
    state: int
    period_us: int
    decisions: int
    next_decision_us: int
    config: PlanConfig
    points: Points
    total: int
    coming: Points
    coming_total: int
    along_points: np.float32
    mark: tuple[np.float32, tuple[np.float32, np.float32], np.float32] | None
    idle: int
    estimator: Estimator


class _Reader:
    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0

    def take(self, form: str) -> tuple[Any, ...]:
        size = struct.calcsize("<" + form)
        if self._at + size > len(self._content):
            raise SnapshotError(f"a snapshot of {len(self._content)} bytes ends too early: fetch it again")
        self._at += size
        return struct.unpack_from("<" + form, self._content, self._at - size)

    def one(self, form: str, most: int | None = None) -> Any:
        (value,) = self.take(form)
        if most is not None and value > most:
            raise SnapshotError(f"a snapshot holds {value}, at most {most} can be: fetch it again")
        return value

    def floats(self, count: int) -> Float32:
        return np.frombuffer(struct.pack(f"<{count}I", *self.take(f"{count}I")), dtype="<f4").copy()


class _Mark(int):
    """A known fix as the robot stores it: FNV-1a hash of its number and its pose's bits."""

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, tuple):
            return int(self) == other
        sequence, pose = other
        mark = ((2166136261 ^ sequence) * 16777619) & 0xFFFFFFFF
        for half in struct.unpack("<6H", pose):
            mark = ((mark ^ half) * 16777619) & 0xFFFFFFFF
        return bool(int(self) == mark | 1)

    def __hash__(self) -> int:
        return hash(int(self))


def read_state(content: bytes, tables: Tables) -> ChipState:
    """Read a snapshot.

    Args:
        content: of all its parts, without the fields before it in each record.
        tables: the tables in use then.

    Raises:
        SnapshotError: too few bytes, or a number out of its limits.
    """
    reader = _Reader(content)
    time_us, state, period_us, decisions, next_decision_us = reader.take("QBIIQ")
    reader.take("BQBQQBB")  # the current stroke, the all-off flag, and the supply
    weights = dict(zip(WEIGHTS, map(float, reader.floats(len(WEIGHTS))), strict=True))
    transitions_max, cost, depth = reader.take("IBB")
    config = PlanConfig(**weights, transitions_max=transitions_max, cost=cost, depth=depth)
    points, total = _read_points(reader)
    coming, coming_total = _read_points(reader)
    along_points, mark_points, x_m, y_m, distance_m = reader.floats(5)
    idle, begun = reader.take("IB")
    return ChipState(
        time_us=time_us,
        state=state,
        period_us=period_us,
        decisions=decisions,
        next_decision_us=next_decision_us,
        config=config,
        points=points,
        total=total,
        coming=coming,
        coming_total=coming_total,
        along_points=along_points,
        mark=(mark_points, (x_m, y_m), distance_m) if begun else None,
        idle=idle,
        estimator=_read_estimator(reader, tables),
    )


def _read_points(reader: _Reader) -> tuple[Points, int]:
    total, count = reader.take("BB")
    return Points(reader.floats(count), reader.floats(count), reader.floats(count)), total


def _read_estimator(reader: _Reader, tables: Tables) -> Estimator:
    estimator = Estimator(tables)
    _read_track(reader, estimator, tables)
    action_us, action, action_waits = reader.take("QBB")
    newest_us, newest_sequence, estimator._fixes = reader.take("QHB")
    estimator._newest = _Fix(newest_us, np.zeros(3, dtype=np.float32), newest_sequence)
    for _ in range(reader.one("B", 2)):
        capture_us = reader.one("Q")
        pose = reader.floats(3)
        estimator._outliers.append(_Fix(capture_us, pose, reader.one("H")))
    following = reader.one("B", MARKS - 1)
    marks = reader.take(f"{MARKS}I")
    oldest_first = marks[following:] + marks[:following]
    known: deque[Any] = deque((_Mark(mark) for mark in oldest_first if mark), maxlen=MARKS)
    estimator._marks = known
    if action_waits:
        estimator.act(action_us, action)
    return estimator


def _read_wear(reader: _Reader, track: Track, tables: Tables) -> None:
    learn = reader.one("B", HELD if tables.limb_wear.size else OFF)
    if learn == OFF:
        return
    unknowns = 3 + tables.limbs
    sums = reader.floats(unknowns * (unknowns + 1) // 2)
    vector, current = reader.floats(unknowns), reader.floats(3)
    lost = [reader.one("H", LOST_MAX) for _ in range(tables.limbs)]
    track.learn(learn)
    assert track.wear is not None
    track.wear.restore(sums, vector, current, lost)
    track._use(track.wear.tables)


def _read_track(reader: _Reader, estimator: Estimator, tables: Tables) -> None:
    track = estimator.track
    track._learned, teaches = reader.take("BB")
    track._teaches = bool(teaches)
    count = reader.one("B", INSTANTS)
    _read_wear(reader, track, tables)
    size = 2 * count
    track._predicted = reader.floats(3)
    process_noise, predicted, covariances = [], [], []
    for _ in range(2):
        process_noise.append(reader.floats(1)[0])
        predicted.append(reader.floats(1)[0])
        covariances.append(reader.floats(size * size).reshape(size, size))
    track.process_noise = np.array(process_noise, dtype=np.float32)
    track._predicted_variance = np.array(predicted, dtype=np.float32)
    track.covariance = np.stack(covariances)
    track.mean = np.stack([reader.floats(size) for _ in range(3)])
    track.instants = []
    for index in range(count):
        time_us = reader.one("Q")
        instant = _Instant(time_us, np.array(reader.take(f"{LIMBS_MAX}H"), dtype=np.int64))
        if index + 1 < count:
            instant.action = reader.one("B", len(tables.actions))
            instant.coasted = bool(reader.one("B", 1))
            instant.fixes = reader.one("B")
        track.instants.append(instant)
