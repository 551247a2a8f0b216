"""The Python twin of estimator and planner, which replays the records of a robot's log."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np

from frogkick.estimator.follow import End, Follow
from frogkick.estimator.wear import ON
from frogkick.link.frames import PATH_POINTS_MAX
from frogkick.link.layout import link_layout
from frogkick.link.log import Record
from frogkick.link.supervisor import supervisor
from frogkick.planner.plan import transitions_within
from frogkick.runs.chip_state import NO_POINTS, Points, read_state
from frogkick.runs.decision import RESTING, Decision, DecisionTwin, decision_of_event
from frogkick.tables.image import Tables

_LAYOUT = link_layout()
_STATUS = _LAYOUT.status
_ENDS = {End.COMPLETED: "OK", End.PASSED: "PASSED", End.STALLED: "STALLED"}
PLAN_TIME_WATCHDOG_US = 600_000
"""Limit of the search time in the firmware (fk_robot.h)."""


class ChipTwin(DecisionTwin):
    """The twin in the state of a robot's snapshot, which replays the records after it.

    Attributes:
        decisions: so far.
    """

    def __init__(self, snapshot: bytes, tables: Tables) -> None:
        """Restore a snapshot.

        Raises:
            SnapshotError: not a snapshot of this robot.
        """
        state = read_state(snapshot, tables)
        super().__init__(tables, state.points, state.config, state.estimator)
        self._own = state.estimator
        self._follow.along_points, self._follow._mark = state.along_points, state.mark
        self._follow._idle = state.idle
        self.decisions: list[Decision] = []
        self._points, self._total = state.points, state.total
        self._coming, self._coming_total = state.coming, state.coming_total
        self._has_path = len(state.points) == state.total > 1
        self._offer_coming()
        self._period_us = state.period_us
        self._running = state.state == _LAYOUT.state["RUNNING"]
        self._next_us = state.next_decision_us
        self._number = state.decisions
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
            self._follow = Follow(self._tables, self._points, self._config)
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
        first = int(record.asked["first"])
        rows = np.array(list(struct.iter_unpack(payload.repeat_format, record.rest[payload.bytes :])))
        part, total = Points(*rows.astype(np.float32).T), int(record.asked["total"])
        if not self._running:
            self._points, self._total = self._points.with_part(first, part), total
            return
        self._coming, self._coming_total = self._coming.with_part(first, part), total
        self._offer_coming()

    def _offer_coming(self) -> None:
        """The path that comes during a run is followed once it is whole."""
        whole = len(self._coming) == self._coming_total > 0
        self._follow.coming = self._coming if whole else None

    def _refused_path(self, record: Record) -> None:
        """A part that fits is refused for its points: nothing is left of the path that was coming."""
        first, total, count = (int(record.asked[name]) for name in ("first", "total", "count"))
        goes_on = first == 0 or (first, total) == (len(self._coming), self._coming_total)
        if goes_on and 2 <= total <= PATH_POINTS_MAX and first + count <= total:
            self._coming, self._coming_total = NO_POINTS, 0
            self._offer_coming()

    def _use_coming(self) -> None:
        """The path that came whole during a run takes the followed one's place."""
        if len(self._coming) == self._coming_total > 0:
            self._points, self._total = self._coming, self._coming_total
        self._coming, self._coming_total = NO_POINTS, 0

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
