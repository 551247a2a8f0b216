"""The Python twin of estimator and planner in the state of a robot's snapshot, which replays its log.

The snapshot is as firmware/core/fk_snapshot.c writes it. The guard's state at its end is not read: it does
not influence decisions.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from frogkick.core.arrays import Float32
from frogkick.core.errors import FrogkickError
from frogkick.core.weights import WEIGHTS
from frogkick.estimator.estimator import MARKS, Estimator, _Fix
from frogkick.estimator.follow import End, Follow
from frogkick.estimator.track import INSTANTS, Track, _Instant
from frogkick.estimator.wear import HELD, OFF, ON
from frogkick.link.frames import PATH_POINTS_MAX
from frogkick.link.layout import link_layout, supervisor
from frogkick.link.log import Record
from frogkick.planner.plan import PLAN_TIME_WATCHDOG_US, PlanConfig, transitions_within
from frogkick.runs.decision import RESTING, Decision, DecisionTwin, decision_of_event
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMBS_MAX, LOST_MAX

_LAYOUT = link_layout()
_STATUS = _LAYOUT.status
_ENDS = {End.COMPLETED: "OK", End.PASSED: "PASSED", End.STALLED: "STALLED"}


class SnapshotError(FrogkickError):
    """Bytes that are not a snapshot of this robot."""


@dataclass(frozen=True, eq=False)
class Points:
    """The points of a path that the robot has received so far, of ``total``: (n,) float32 each, world."""

    x_m: Float32
    y_m: Float32
    tangent_rad: Float32
    total: int

    def __len__(self) -> int:
        return len(self.x_m)

    @property
    def whole(self) -> bool:
        """Whether they are a complete path."""
        return len(self) == self.total > 0

    def with_part(self, first: int, rows: Float32, total: int) -> Points:
        """The points before an index, and (k, 3) from there on."""
        before = np.column_stack([self.x_m, self.y_m, self.tangent_rad])[:first]
        x_m, y_m, tangent_rad = np.concatenate([before, rows]).T
        return Points(x_m, y_m, tangent_rad, total)


_NONE = np.zeros(0, dtype=np.float32)
NO_POINTS = Points(_NONE, _NONE, _NONE, 0)


class ChipTwin(DecisionTwin):
    """The twin in the state of a robot's snapshot, which replays the records after it.

    Attributes:
        decisions: so far.
    """

    def __init__(self, snapshot: bytes, tables: Tables) -> None:
        """Restore a snapshot: the content of all its parts, without the fields before it in each record.

        Raises:
            SnapshotError: not a snapshot of this robot: too few bytes, or a number out of its limits.
        """
        reader = _Reader(snapshot)
        _now_us, state, self._period_us, self._number, self._next_us = reader.take("QBIIQ")
        reader.take("BQBQQBB")  # the current stroke, the all-off flag, and the supply
        weights = dict(zip(WEIGHTS, map(float, reader.floats(len(WEIGHTS))), strict=True))
        transitions_max, cost, depth = reader.take("IBB")
        self._points, self._coming = reader.points(), reader.points()
        along_points, mark_points, x_m, y_m, distance_m = reader.floats(5)
        idle, begun = reader.take("IB")
        self._own = _read_estimator(reader, tables)
        config = PlanConfig(**weights, transitions_max=transitions_max, cost=cost, depth=depth)
        super().__init__(tables, self._points, config, self._own)
        self._follow.along_points, self._follow._idle = along_points, idle
        self._follow._mark = (mark_points, (x_m, y_m), distance_m) if begun else None
        self.decisions: list[Decision] = []
        self._has_path = len(self._points) == self._points.total > 1
        self._offer_coming()
        self._running = state == _LAYOUT.state["RUNNING"]
        self._decided: tuple[int, int] | None = None
        self._supply_low = False

    def replay(self, record: Record) -> list[str]:
        """Replay a record; return what the twin finds different, one text each."""
        if record.name == "COMMAND":
            return self._command(record)
        if record.name == "DECISION":
            return self._decide(record)
        if record.name in ("REFUSED", "DROPPED"):
            self.act(int(record.values["begin_us"]), RESTING)
        elif record.name == "STROKE":
            return self._stroke(record)
        elif record.name == "ENDED":
            return self._ended(record)
        elif record.name == "STATE":
            was_running, self._running = self._running, record.values["state"] == _LAYOUT.state["RUNNING"]
            if was_running and not self._running:
                self._use_coming()
            self._supply_low = record.values["event"] == supervisor().number("SUPPLY_LOW")
        return []

    def _command(self, record: Record) -> list[str]:
        status, asked = int(record.values["status"]), record.asked
        if record.command == "FIX":
            return self._fix(record, status)
        if record.command == "PATH" and status == _STATUS["VALUE"] and self._running:
            self._refused_path(record)
        if status != _STATUS["OK"]:
            return []
        if record.command == "PATH":
            self._add_points(record)
        elif record.command == "PARAM":
            self._set(int(asked["parameter"]), float(asked["value"]))
        elif record.command == "START":
            self._has_path, self.ended = True, None
            self._follow = Follow(self.tables, self._points, self._config)
            self._next_us = record.time_us + int(asked["delay_us"])
            self._number = 0
        elif record.command == "STROKE":
            self._decided = None
        return []

    def _fix(self, record: Record, status: int) -> list[str]:
        asked = record.asked
        if status == _STATUS["VALUE"] or not asked:
            return []
        capture_us = record.time_us - int(asked["capture_age_us"])
        pose = np.array([asked["x_m"], asked["y_m"], asked["heading_rad"]], dtype=np.float32)
        ours = self.add_fix(capture_us, pose, int(asked["fix_sequence"]))
        if ours == status:
            return []
        return [f"FIX is {_LAYOUT.status_name(ours)}, not {_LAYOUT.status_name(status)}"]

    def _add_points(self, record: Record) -> None:
        payload = _LAYOUT.messages["PATH"].command
        assert payload is not None
        first, total = int(record.asked["first"]), int(record.asked["total"])
        rows = np.array(list(struct.iter_unpack(payload.repeat_format, record.rest[payload.bytes :])))
        received = self._coming if self._running else self._points
        received = received.with_part(first, rows.astype(np.float32), total)
        if self._running:
            self._coming = received
            self._offer_coming()
        else:
            self._points = received

    def _offer_coming(self) -> None:
        """The path that comes during a run is followed once it is whole."""
        self._follow.coming = self._coming if self._coming.whole else None

    def _refused_path(self, record: Record) -> None:
        """A part that fits is refused for its points: nothing is left of the path that was coming."""
        first, total, count = (int(record.asked[name]) for name in ("first", "total", "count"))
        goes_on = first == 0 or (first, total) == (len(self._coming), self._coming.total)
        if goes_on and 2 <= total <= PATH_POINTS_MAX and first + count <= total:
            self._coming = NO_POINTS
            self._offer_coming()

    def _use_coming(self) -> None:
        """The path that came whole during a run takes the followed one's place."""
        if self._coming.whole:
            self._points = self._coming
        self._coming = NO_POINTS

    def _set(self, parameter: int, value: float) -> None:
        name = next(name for name, number in _LAYOUT.parameter.items() if number == parameter)
        if name == "LEARN":
            self._track.learn(int(value))
            if value != ON:
                self._own.restart()
        elif name == "PERIOD_US":
            self._period_us = int(value)
        elif name in ("PLAN_TIME_US", "TRANSITIONS_MAX"):
            limit = transitions_within(PLAN_TIME_WATCHDOG_US)
            wanted = transitions_within(int(value)) if name == "PLAN_TIME_US" else int(value)
            self._config = replace(self._config, transitions_max=min(wanted or limit, limit))
        else:
            changes = {name.lower(): int(value) if name in ("DEPTH", "COST") else value}
            self._config = replace(self._config, **changes)  # type: ignore[arg-type]

    def _decide(self, record: Record) -> list[str]:
        if not self._has_path:
            return ["a decision without a path"]
        over = self.ended is not None
        ours = self.decide(self._next_us)
        if self._follow.path is self._coming:
            self._use_coming()
        differing = ours.differences(decision_of_event(record.values))
        if over:
            differing.append("the end of the run before")
        if int(record.values["decision"]) != self._number:
            differing.append("decision")
        if self.ended is None:
            self._decided = (ours.action, self._next_us)
            self._next_us += self._period_us
        self._number += 1
        self.decisions.append(ours)
        return [f"DECISION differs in {', '.join(differing)}"] if differing else []

    def _stroke(self, record: Record) -> list[str]:
        action, begin_us = int(record.values["action"]), int(record.values["begin_us"])
        decided, self._decided = self._decided, None
        self.act(begin_us, action)
        if self._running and decided != (action, begin_us):
            return [f"STROKE {(action, begin_us)} was not decided: {decided} was"]
        return []

    def _ended(self, record: Record) -> list[str]:
        status = _LAYOUT.status_name(int(record.values["status"]))
        wanted = "STALE" if self.ended is None else _ENDS[self.ended]
        wanted = "SUPPLY" if self._supply_low else wanted
        return [] if status == wanted else [f"the run ends with {status}, not {wanted}"]


class _Reader:
    """Takes the numbers of a snapshot one after the other."""

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

    def points(self) -> Points:
        total = self.one("B", PATH_POINTS_MAX)
        count = self.one("B", total)
        return Points(self.floats(count), self.floats(count), self.floats(count), total)


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
    track._learned, prediction_valid = reader.take("BB")
    track._prediction_valid = bool(prediction_valid)
    count = reader.one("B", INSTANTS)
    if count == 1:
        raise SnapshotError("a snapshot holds one instant of the track, a period has two: fetch it again")
    _read_wear(reader, track, tables)
    size = 2 * count
    track._predicted = reader.floats(3)
    process_noise, predicted, covariances = [], [], []
    for _ in range(2):
        process_noise.append(reader.floats(1)[0])
        predicted.append(reader.floats(1)[0])
        half = np.zeros((size, size), dtype=np.float32)
        half[np.tril_indices(size)] = reader.floats(size * (size + 1) // 2)
        covariances.append(np.where(np.tri(size, dtype=bool), half, half.T))
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
