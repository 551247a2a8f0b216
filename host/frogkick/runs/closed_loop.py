"""A closed-loop run, in the simulated pool or on the bench: fixes in, strokes out, everything logged."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.core.weights import WEIGHTS
from frogkick.estimator.follow import End
from frogkick.link.frames import Frame
from frogkick.link.layout import link_layout
from frogkick.link.wire import Edge, RobotPort
from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig, config_of
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick.runs.decision import (
    RESTING,
    Decision,
    DecisionTwin,
    RobotEvent,
    decision_of_event,
    events_of_frame,
)
from frogkick.runs.live_check import LiveCheck
from frogkick.runs.session import LinkError, Session
from frogkick.tables.image import Tables

SETTLE_S = 0.6  # fixes before the start, so that the first estimate knows a velocity
START_DELAY_S = 0.1
# A chip boots longer than the core on this computer. From a common time on, both meet the same fixes.
READY_S = 1.0
TIME = "time limit"
STOPPED = "stopped by hand"
DISARMED = "the robot disarmed itself"
DROPPED = "connection lost, and the robot ended the run meanwhile"
ENDED = {
    "OK": End.COMPLETED.value,
    "PASSED": End.PASSED.value,
    "STALLED": End.STALLED.value,
    "STALE": "position fixes lost",
    "SUPPLY": "the robot's supply fell too low: charge it",
}
"""Why a run ended, for people, by the status of ENDED."""


@dataclass
class Recording:
    """What a run leaves behind, before it becomes a log.

    Attributes:
        fixes: fixes in order of sending.
        sent_s: when each was sent.
        capture_us: capture time of each on the robot's clock; None where the robot took none.
        fix_status: what the robot answered to each (``frames.toml``); None where no answer came.
        events: what the robot met, in its order: enough to decide everything again on the host.
        decisions: in order.
        edges: pin edges.
        completed: the path's end was reached.
        ended: why the run ended: a value of ENDED, TIME, DISARMED or DROPPED.
        fixes_refused: the robot's own counter.
        first_decision_s, end_s: session time.
        clock_offset_us: robot time minus session time; 0 in simulated time.
    """

    fixes: list[Fix] = field(default_factory=list)
    sent_s: list[float] = field(default_factory=list)
    capture_us: list[int | None] = field(default_factory=list)
    fix_status: list[int | None] = field(default_factory=list)
    events: list[RobotEvent] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    completed: bool = False
    ended: str = ""
    fixes_refused: int = 0
    first_decision_s: float = 0.0
    end_s: float = 0.0
    clock_offset_us: int = 0


class FixSource(Protocol):
    """Where position fixes come from: a simulated pool, or a camera over a real one. Session time."""

    @property
    def next_event_s(self) -> float:
        """When the next fix may come."""

    def advance(self, until_s: float) -> list[Fix]:
        """Fixes that have come by then, in order."""

    def actuate(self, limb: int, start_s: float) -> None:
        """A limb's pin was seen to switch on."""


@dataclass(frozen=True)
class RunOptions:
    """How to run.

    Attributes:
        config: cost weights and depth of the planner.
        onboard: True = the robot's planner decides, False = the twin on the host does.
        time_limit_s: pool time after which the run is stopped.
        check: compares the robot's decisions with the host's while they are made; None: nobody does.
        stop: whether somebody wants the run to end; asked at each step.
    """

    config: PlanConfig
    onboard: bool = True
    time_limit_s: float = 120.0
    check: LiveCheck | None = None
    stop: Callable[[], bool] = lambda: False


def robot_plan_config(robot: Robot) -> PlanConfig:
    """The planner configuration of a robot's TOML."""
    return config_of(robot.planner)


def parameters(config: PlanConfig) -> dict[str, float]:
    """The robot's PARAM values for a planner configuration."""
    weights = {name.upper(): float(getattr(config, name)) for name in WEIGHTS}
    return {
        **weights,
        "DEPTH": config.depth,
        "COST": int(config.cost),
        "TRANSITIONS_MAX": config.transitions_max,
    }


def require_seed(seed: int) -> None:
    """Refuse a seed that is none.

    Raises:
        InputError: not a whole number from 0 on.
    """
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed is {seed!r}: give 0 or more, a whole number")


def require_time(limit_s: float) -> None:
    """Refuse a time limit that ends no run.

    Raises:
        InputError: not a finite number above 0.
    """
    if not (isinstance(limit_s, int | float | np.number) and math.isfinite(limit_s) and limit_s > 0.0):
        raise InputError(f"simulated time is {limit_s!r} s: give a finite number above 0")


def run_in_pool(
    port: RobotPort,
    pool: Pool,
    tables: Tables,
    path: Path,
    options: RunOptions,
    progress: Callable[[float, int], None] = lambda _time_s, _path_index: None,
    keep: Callable[[Recording], None] = lambda _recording: None,
) -> Recording:
    """Follow a path in the simulated pool.

    Args:
        port: the robot; its clock and the pool's are the same.
        pool: swimmer and camera.
        tables: the robot's own tables.
        path: where to swim, world frame.
        options: who plans, and how.
        progress: called after each decision with the pool time and the nearest path point.
        keep: called over and over with what is recorded so far.

    Raises:
        InputError: the time limit is not a finite number above 0.
        LinkError: the robot refuses or does not answer.
        ConvergenceError: the pool's physics failed.
    """
    return run_session(Session(port), pool, tables, path, options, progress, keep)


def run_session(
    session: Session,
    source: FixSource,
    tables: Tables,
    path: Path,
    options: RunOptions,
    progress: Callable[[float, int], None] = lambda _time_s, _path_index: None,
    keep: Callable[[Recording], None] = lambda _recording: None,
) -> Recording:
    """The same with any robot and any source of fixes. However it ends, the robot is disarmed first.

    Args:
        session: with the robot; its ``on_step`` is taken.
        source: of the fixes, on the session's clock.
        tables, path, options, progress: as in ``run_in_pool``.
        keep: called over and over with what is recorded so far.

    Raises:
        InputError: the time limit is not a finite number above 0.
        LinkError: the robot refuses or does not answer.
        CheckError: ``options.check`` found a decision that the host makes otherwise.
    """
    require_time(options.time_limit_s)
    run = _Run(session, source, tables, path, options, progress, keep)
    try:
        with session.real_time_guard():
            return run.go()
    except BaseException as error:
        if run.may_be_armed and not session.make_safe():
            said = str(error) or "interrupted"
            raise LinkError(f"{said}; the robot did not say that it is disarmed: switch it off") from error
        raise


class _StopError(Exception):
    """Somebody wants the run to end."""


class _Run:
    def __init__(
        self,
        session: Session,
        source: FixSource,
        tables: Tables,
        path: Path,
        options: RunOptions,
        progress: Callable[[float, int], None],
        keep: Callable[[Recording], None],
    ) -> None:
        self.source = source
        self.keep = keep
        self.tables = tables
        self.path = path
        self.options = options
        self.progress = progress
        self.recording = Recording()
        self.may_be_armed = False
        self.session = session
        self.recording.edges = session.edges  # which grow
        session.on_step = self._source_step
        self.twin = DecisionTwin(tables, path, options.config)
        self._awaited: dict[int, int] = {}
        self._too_late = 0
        self._stopped = False

    def go(self) -> Recording:
        session, options = self.session, self.options
        session.handshake(self.tables)
        self.recording.clock_offset_us = session.robot_clock_offset_us()
        session.set_parameters(parameters(options.config))
        if options.check is not None:
            options.check.begin(self.tables, self.path, options.config)
        session.send_path(self.path)
        self.may_be_armed = True
        try:
            session.request("ARM")
            self._live_until(max(session.time_s + SETTLE_S, READY_S))
            if options.onboard:
                self._run_onboard()
            else:
                self._run_on_host()
        except _StopError:
            session.request("STOP")
            self.recording.ended = STOPPED
        self.recording.end_s = session.time_s
        session.request("DISARM")
        self.recording.fixes_refused = int(session.request("STATUS")["fixes_refused"])
        return self.recording

    def _run_onboard(self) -> None:
        session, recording = self.session, self.recording
        delay_us = round(START_DELAY_S * 1e6)
        first_us = int(session.request("START", {"delay_us": delay_us})["first_decision_us"])
        recording.first_decision_s = (first_us - recording.clock_offset_us) * 1e-6
        limit_s = recording.first_decision_s + self.options.time_limit_s
        while session.time_s < limit_s:
            self._live_until(min(session.time_s + 0.05, limit_s))
            if session.reconnected() and not recording.ended:
                self._look_again()
            if recording.ended:
                return
        session.request("STOP")
        recording.ended = TIME

    def _look_again(self) -> None:
        """Whether the robot is still at it, where its word that it is not may have been lost."""
        if int(self.session.request("STATUS")["state"]) != link_layout().state["RUNNING"]:
            for arrival in self.session.take("ENDED"):
                self._note(arrival.frame)
            self.recording.ended = self.recording.ended or DROPPED

    def _run_on_host(self) -> None:
        session, recording = self.session, self.recording
        start_us = round((session.time_s + START_DELAY_S) * 1e6)
        recording.first_decision_s = start_us * 1e-6
        limit_s = recording.first_decision_s + self.options.time_limit_s
        while True:
            at_us = start_us + len(recording.decisions) * self.tables.period_us
            self._live_until(min(at_us * 1e-6, limit_s))
            if self._ended_on_host():
                return
            if session.time_s >= limit_s:
                recording.ended = TIME
                return
            if self.twin.is_lost(at_us):
                recording.ended = ENDED["STALE"]
                return
            began = time.perf_counter()
            decision = self.twin.decide(at_us)
            elapsed_us = round((time.perf_counter() - began) * 1e6)
            decision = Decision(**{**decision.__dict__, "plan_us": elapsed_us})
            recording.decisions.append(decision)
            self.progress(session.time_s, decision.path_index)
            if self._ended_on_host():
                return
            if decision.action < len(self.tables.actions):
                session.post("STROKE", {"action": decision.action})

    def _ended_on_host(self) -> bool:
        end = self.twin.ended
        if end is not None:
            self.recording.completed = end is End.COMPLETED
            self.recording.ended = end.value
        return bool(self.recording.ended)

    def _live_until(self, until_s: float) -> None:
        while self.session.time_s < until_s and (self.options.onboard or self.twin.ended is None):
            self.session.step(min(max(self.source.next_event_s, self.session.time_s + 1e-6), until_s))
            for arrival in self.session.take("FIX", "STROKE", "DECISION", "REFUSED", "ENDED"):
                self._note(arrival.frame)
            self.recording.end_s = self.session.time_s
            self.keep(self.recording)

    def _note(self, frame: Frame) -> None:
        recording, values = self.recording, frame.values
        if frame.name == "FIX" and frame.sequence not in self._awaited:
            self._too_late += 1  # its number has been given again meanwhile: nobody knows which fix it was
            return
        poses = {key: recording.fixes[row].pose_world for key, row in self._awaited.items()}
        events = events_of_frame(frame, poses)
        recording.events += events
        decision = decision_of_event(values) if frame.name == "DECISION" else None
        if self.options.check is not None:
            self.options.check.compare(events, decision, self.session.gaps + self._too_late)
        if frame.name == "FIX":
            row = self._awaited.pop(frame.sequence)
            recording.fix_status[row] = int(values["status"])
            if values["status"] == 0:
                recording.capture_us[row] = int(values["capture_us"])
                self.session.check_clock_sync(recording.fixes[row].capture_s, int(values["capture_us"]))
            elif values["status"] == link_layout().status["FAULT"]:
                self._fail()
        elif frame.name == "STROKE" and values["status"] == link_layout().status["STATE"]:
            self._look_whether_disarmed()
        elif frame.name == "REFUSED":
            if not self.options.onboard:
                self.twin.act(int(values["begin_us"]) - recording.clock_offset_us, RESTING)
        elif decision is not None:
            recording.decisions.append(decision)
            self.progress(self.session.time_s, decision.path_index)
        elif frame.name == "ENDED":
            recording.completed = values["status"] == 0
            name = link_layout().status_name(int(values["status"]))
            recording.ended = ENDED.get(name, name)

    def _look_whether_disarmed(self) -> None:
        """A stroke was refused: of a robot that has disarmed itself none begins any more."""
        told = self.session.request("STATUS")
        if told["state"] == link_layout().state["DISARMED"] and not self.recording.ended:
            fell = told["supply"] != link_layout().supply["OK"]
            self.recording.ended = ENDED["SUPPLY"] if fell else DISARMED

    def _fail(self) -> None:
        """The robot is in FAULT: nothing goes on, whatever is sent."""
        told = self.session.request("STATUS")
        name = link_layout().fault_name(int(told["fault"]))
        raise LinkError(
            f"the robot met the internal error {name} ({told['fault_detail']}) and has switched its outputs "
            "off: 'frogkick log fetch' tells what led to it, then switch it off and on"
        )

    def _source_step(self, until_s: float, edges: Sequence[Edge]) -> None:
        """The source lives through a step of the robot; fixes that arrive go straight to the robot."""
        if self.may_be_armed and not self._stopped and self.options.stop():
            self._stopped = True
            raise _StopError
        for edge in edges:
            if edge.level:
                self.source.actuate(edge.limb, edge.time_s)
        for fix in self.source.advance(until_s):
            at_s = max(until_s, fix.arrival_s)
            sequence = self.session.post_fix(fix, at_s)
            recording = self.recording
            self._awaited[sequence] = len(recording.fixes)
            recording.fixes.append(fix)
            recording.sent_s.append(at_s)
            recording.capture_us.append(None)
            recording.fix_status.append(None)
            if not self.options.onboard:
                self.twin.add_fix(round(fix.capture_s * 1e6), fix.pose_world, fix.sequence)
