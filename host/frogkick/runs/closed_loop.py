"""A closed-loop run in the simulated pool or with a real robot: position fixes in, strokes out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Protocol

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.core.weights import WEIGHTS
from frogkick.effects import World
from frogkick.estimator.follow import End
from frogkick.estimator.wear import HELD, OFF, ON
from frogkick.link.frames import Frame
from frogkick.link.layout import Value, link_layout
from frogkick.link.wire import Edge, RobotPort
from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig
from frogkick.pool.pool import Camera, Pool
from frogkick.robot import Robot
from frogkick.runs.decision import (
    LOST_FIELDS,
    NOTHING_LOST,
    RESTING,
    DecisionTwin,
    RobotEvent,
    decision_of_event,
    events_of_frame,
)
from frogkick.runs.lost_frames import LATE_S, EventGaps, is_answer_to, why_disarmed, why_ended
from frogkick.runs.path_change import Holding, PathChanges, PathSender
from frogkick.runs.record import ENDED, STOPPED, TIME, Recording, RunOptions, SentFix
from frogkick.runs.session import LinkError, Session
from frogkick.runs.summary import no_fresh_fix
from frogkick.tables.image import Tables

SETTLE_S = 0.6  # time of fixes before the start, so that the first estimate has a velocity
START_DELAY_S = 0.1
READY_S = 1.0
"""Earliest start of a run: a chip boots later than the core on this computer, and both get the same fixes."""


class FixSource(Protocol):
    """A source of position fixes: a simulated pool, or a tracker over a real one. Times: session time."""

    @property
    def next_event_s(self) -> float:
        """Earliest time of the next fix."""

    def advance(self, until_s: float) -> list[Fix]:
        """Return the fixes that arrived since the last call, in order."""

    def actuate(self, limb: int, start_s: float) -> None:
        """Record that a limb's pin was switched on."""


def parameters(config: PlanConfig) -> dict[str, float]:
    """The robot's PARAM values for a planner configuration; with them it forgets its wear estimate."""
    weights = {name.upper(): float(getattr(config, name)) for name in WEIGHTS}
    return {
        **weights,
        "DEPTH": config.depth,
        "COST": int(config.cost),
        "TRANSITIONS_MAX": config.transitions_max,
        "LEARN": OFF,
    }


def configure(session: Session, config: PlanConfig, learn: bool) -> tuple[int, ...]:
    """Send a robot a planner configuration, and whether it estimates the wear of its limbs.

    A robot that estimates it goes on from the shares that it remembers. HELD first drops all but these, so
    that a twin can start from the same state.

    Returns:
        (8,) the shares that it remembers, 0 to 32767, as in ``Decision``.

    Raises:
        LinkError: a value is out of its limits, or the table has no wear curves, which learning needs.
    """
    session.set_parameters({**parameters(config), "LEARN": HELD if learn else OFF})
    if not learn:
        return NOTHING_LOST
    status = session.request("STATUS")
    session.set_parameters({"LEARN": ON})
    return tuple(int(status[name]) for name in LOST_FIELDS)


def require_seed(seed: int) -> None:
    """Raise InputError unless a seed is a whole number of 0 or more."""
    if not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise InputError(f"seed is {seed!r}: give 0 or more, a whole number below 2^63, as files hold it")


def require_time(limit_s: float) -> None:
    """Raise InputError unless a time limit is a finite number above 0."""
    if not (isinstance(limit_s, int | float | np.number) and math.isfinite(limit_s) and limit_s > 0.0):
        raise InputError(f"simulated time is {limit_s!r} s: give a finite number above 0")


def run_session(
    session: Session,
    source: FixSource,
    recording: Recording,
    progress: Callable[[float, int], None] = lambda _time_s, _path_index: None,
    keep: Callable[[Recording], None] = lambda _recording: None,
) -> Recording:
    """Follow a path with a robot. The robot is disarmed however the run ends.

    Args:
        session: with the robot; the run sets its ``on_step``.
        source: position fixes on the session's clock: a simulated pool, or a tracker.
        recording: says which path is followed, by which planner. The run is recorded in it, and it is
            returned.
        progress: called after each decision with the session time and the nearest path point.
        keep: called after each step with the recording so far.

    Raises:
        InputError: the time limit is not a finite number above 0.
        LinkError: the robot refuses or does not answer.
        CheckError: ``options.check`` found a decision that differs from the host's.
        ConvergenceError: the pool's physics failed.
    """
    require_time(recording.options.time_limit_s)
    run = _Run(session, source, recording, progress, keep)
    try:
        with session.real_time_guard():
            return run.go()
    except BaseException as error:
        while run.may_be_armed:
            try:
                run.may_be_armed = not session.make_safe()
            except KeyboardInterrupt:  # again, before it is ignored
                continue
            if run.may_be_armed:
                cause = str(error) or "interrupted"
                raise LinkError(f"{cause}; the robot did not confirm DISARM: switch it off") from error
        raise


def run_in_pool(
    port: RobotPort,
    tables: Tables,
    robot: Robot,
    path: Path,
    options: RunOptions,
    seed: int | Sequence[int],
    source: str,
    world: World = World(),  # noqa: B008 - frozen
    start_world: tuple[float, float, float] | None = None,
    progress: Callable[[int, int], None] = lambda _done, _whole: None,
) -> Recording:
    """Follow a path in a pool.

    Args:
        port, tables: the robot, and its own tables.
        robot: the swimmer in the pool.
        options, source: of the run.
        seed: of the camera's noise; the log keeps the first of several.
        world: effects in the pool; a new object for each run.
        start_world: pose of the robot at rest; None: at the path's first point, along it.
        progress: called with the path points passed and all path points.
    """
    start = start_world or (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]))
    pool = Pool(robot, start, Camera(), np.random.default_rng(seed), world)
    first = seed if isinstance(seed, int) else int(seed[0])
    recording = Recording(robot, tables, path, options, source, first, pool=pool)
    return run_session(Session(port), pool, recording, lambda _time_s, index: progress(index + 1, len(path)))


class _StopError(Exception):
    """``RunOptions.stop`` ends the run."""


@dataclass
class _Run:
    """One run; arguments as of ``run_session``."""

    session: Session
    source: FixSource
    recording: Recording
    progress: Callable[[float, int], None]
    keep: Callable[[Recording], None]
    may_be_armed: bool = False
    _is_configured: bool = False
    _unanswered: dict[int, int] = field(default_factory=dict)  # sequence of a FIX -> row in recording.fixes
    _late_answers: int = 0
    _events: EventGaps = field(default_factory=EventGaps)
    _sign_s: float = 0.0  # ``link_s`` when the robot last gave a sign of what the run is about
    _stopped: bool = False

    def __post_init__(self) -> None:
        recording = self.recording
        self.tables, path, self.options = recording.tables, recording.path, recording.options
        recording.edges = self.session.edges  # grows with the session
        self.session.on_step = self._advance_source
        radius_m, area_m = self.options.hold_m, self.options.config.area_m
        holding = None if radius_m is None else Holding(path, radius_m, area_m)
        self.changes = PathChanges(self.options.then, recording.then, holding)
        self.sender = PathSender(self.session)
        self.twin = DecisionTwin(self.tables, path, self.options.config, learn=self.options.learn)

    def go(self) -> Recording:
        session, options = self.session, self.options
        session.handshake(self.tables)
        self.recording.clock_offset_us = session.robot_clock_offset_us()
        lost = configure(session, options.config, options.learn and options.onboard)
        if options.check is not None:
            path, config, learn = self.recording.path, options.config, options.learn
            options.check.begin(DecisionTwin(self.tables, path, config, learn=learn, lost=lost))
        self._is_configured = True
        session.send_path(self.recording.path)
        self.may_be_armed = True
        try:
            session.request("ARM")
            self._run_until(max(session.time_s + SETTLE_S, READY_S))
            if options.onboard:
                self._run_onboard()
            else:
                self._run_on_host()
        except _StopError:
            session.request("STOP")
            self._end(STOPPED)
        self._stopped = True  # nothing is left to stop
        self.recording.end_s = session.time_s
        session.request("DISARM")
        self.may_be_armed = False
        self.recording.fixes_refused = int(session.request("STATUS")["fixes_refused"])
        return self.recording

    def _run_onboard(self) -> None:
        session, recording = self.session, self.recording
        delay_us = round(START_DELAY_S * 1e6)
        answer = session.ask("START", {"delay_us": delay_us})
        if answer["status"] == link_layout().status["STALE"]:
            why = no_fresh_fix(recording.log(), session.time_s, recording.robot.guard.fix_lost_s)
            raise LinkError(f"the robot refuses START: {why}")
        session.require_done("START", {"delay_us": delay_us}, answer)
        first_us = int(answer["first_decision_us"])
        recording.first_decision_s = (first_us - recording.clock_offset_us) * 1e-6
        # Whatever the robot says, it is not later than this.
        latest_s = session.time_s + START_DELAY_S
        limit_s = min(recording.first_decision_s, latest_s) + self.options.time_limit_s
        self._sign_s = session.link_s
        while session.time_s < limit_s:
            self._run_until(min(session.time_s + 0.05, limit_s))
            path = self._path_due()
            if path is not None and not recording.ended:
                self.sender.begin(path)
            is_back = session.reconnected()
            if (is_back or self._is_overdue()) and not recording.ended:
                self._check_still_running(session.request("STATUS"), is_back)
            if recording.ended:
                return
            self.sender.send_again()
        asked = session.post("STATUS")
        session.request("STOP")
        for arrival in session.take("STATUS"):
            if arrival.frame.sequence == asked:  # its state before STOP
                self._check_still_running(arrival.frame.values, False)
        if not recording.ended:
            self._end(TIME)

    def _is_overdue(self) -> bool:
        """Whether more than a period has passed without a sign: an event, or on the host an answer."""
        return self.session.link_s - self._sign_s > self.tables.period_us * 1e-6 + LATE_S

    def _end(self, why: str) -> None:
        """Record that the run was ended from outside, which completes a run that holds."""
        self.recording.ended = why
        self.recording.completed = self.changes.holds

    def _path_due(self) -> Path | None:
        """The path to send now, or None."""
        recording = self.recording
        since_s = self.session.time_s - recording.first_decision_s
        return self.changes.due(since_s, recording.fixes, recording.decisions)

    def _check_still_running(self, status: Mapping[str, Value], is_back: bool) -> None:
        """End the run if the robot's state says so, because its ENDED may have been lost.

        ``is_back``: the connection was lost since the last check.
        """
        self._sign_s = self.session.link_s
        self._handle_all()
        state = link_layout().state
        if self.recording.ended or status["state"] == state["RUNNING"]:
            return
        if status["state"] == state["FAULT"]:
            self._raise_fault()
        self.session.request("DISARM")
        self.recording.ended, self.recording.completed = why_ended(self.session, status, is_back)

    def _run_on_host(self) -> None:
        session, recording = self.session, self.recording
        start_us = round((session.time_s + START_DELAY_S) * 1e6)
        recording.first_decision_s = start_us * 1e-6
        self._sign_s = session.link_s
        limit_s = recording.first_decision_s + self.options.time_limit_s
        while True:
            at_us = start_us + len(recording.decisions) * self.tables.period_us
            self._run_until(min(at_us * 1e-6, limit_s))
            if self._ended_on_host():
                return
            if session.time_s >= limit_s:
                self._end(TIME)
                return
            if self.twin.is_lost(at_us):
                recording.ended = ENDED["STALE"]
                return
            path = self._path_due()
            if path is not None:
                self.twin.change_path(path)
                self.changes.arrived(path)
            if self._is_overdue():
                self._sign_s = session.link_s
                self._check_disarmed()
            began_s = time.perf_counter()
            decision = self.twin.decide(at_us)
            decision = replace(decision, plan_us=round((time.perf_counter() - began_s) * 1e6))
            recording.decisions.append(decision)
            self.changes.decided(recording.decisions)
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

    def _run_until(self, until_s: float) -> None:
        while self.session.time_s < until_s and (self.options.onboard or self.twin.ended is None):
            self.session.step(min(max(self.source.next_event_s, self.session.time_s + 1e-6), until_s))
            self._handle_all()
            self.recording.end_s = self.session.time_s
            self.keep(self.recording)

    def _handle_all(self) -> None:
        for arrival in self.session.take("FIX", "STROKE", "PATH", "DECISION", "REFUSED", "ENDED"):
            if arrival.frame.kind == "event":
                self._events.note(arrival.frame)
            if arrival.frame.kind == "event" or not self.options.onboard:
                self._sign_s = self.session.link_s
            self._handle(arrival.frame)

    def _handle(self, frame: Frame) -> None:
        recording, values = self.recording, frame.values
        if frame.name == "FIX":
            row = self._unanswered.get(frame.sequence)
            if row is None or not is_answer_to(frame, recording.fixes[row]):
                self._late_answers += 1  # its sequence number has been reused, so the fix is unknown
                return
        poses = {key: recording.fixes[row].pose_world for key, row in self._unanswered.items()}
        events = events_of_frame(frame, poses)
        if frame.name == "PATH" and (path := self.sender.answered(frame)) is not None:
            self.changes.arrived(path)
            events = [RobotEvent(0, path=path)]
        recording.events += events
        decision = decision_of_event(values) if frame.name == "DECISION" else None
        if self.options.check is not None:
            gaps = self.session.gaps + self._late_answers + self._events.lost
            self.options.check.compare(events, decision, gaps)
        if frame.name == "FIX":
            fix = recording.fixes[self._unanswered.pop(frame.sequence)]
            fix.robot_status = int(values["status"])
            if self.options.onboard and events:
                fix.heard_us, fix.heard_after = events[0].time_us, len(recording.decisions)
            if fix.robot_status == 0:
                fix.robot_capture_us = int(values["capture_us"])
                self.session.check_clock_sync(fix.capture_s, fix.robot_capture_us)
            elif values["status"] == link_layout().status["FAULT"]:
                self._raise_fault()
        elif frame.name == "STROKE" and values["status"] == link_layout().status["STATE"]:
            self._check_disarmed()
        elif frame.name == "REFUSED":
            begin_us = int(values["begin_us"])
            known = min(self._unanswered.values(), default=len(recording.fixes))
            if not self.options.onboard:
                begin_us, known = begin_us - recording.clock_offset_us, len(recording.fixes)
                self.twin.act(begin_us, RESTING)
            if recording.decisions and not self._events.just_lost:  # its own decision may be lost
                recording.rested[len(recording.decisions) - 1] = begin_us, known
        elif decision is not None:
            recording.decisions.append(decision)
            self.changes.decided(recording.decisions)
            self.progress(self.session.time_s, decision.path_index)
        elif frame.name == "ENDED":
            recording.completed = values["status"] == 0
            name = link_layout().status_name(int(values["status"]))
            recording.ended = ENDED.get(name, name)
        refusals = (link_layout().status["AUTH"], link_layout().status["MAC"])
        if frame.kind == "answer" and values["status"] in refusals and not recording.ended:
            self._check_conversation()

    def _check_disarmed(self) -> None:
        """End the run if the robot refused a command because it has disarmed itself."""
        status = self.session.request("STATUS")
        if status["state"] == link_layout().state["DISARMED"] and not self.recording.ended:
            self.recording.ended = why_disarmed(status)

    def _check_conversation(self) -> None:
        """End the run, as the robot takes its owner's commands no longer from this host, and say why."""
        self.session.check_clock_sync(self.session.time_s, 0)
        self._check_disarmed()
        if not self.recording.ended:
            raise LinkError("another host that has the robot's key commands it: run when that one is done")

    def _raise_fault(self) -> None:
        status = self.session.request("STATUS")
        name = link_layout().fault_name(int(status["fault"]))
        raise LinkError(
            f"the robot met the internal error {name} ({status['fault_detail']}) and switched its outputs "
            "off: fetch its log ('frogkick log fetch') to see the cause, then switch it off and on"
        )

    def _advance_source(self, until_s: float, edges: Sequence[Edge]) -> None:
        """Advance the source through a step of the robot, and send the fixes that arrive."""
        if self.may_be_armed and not self._stopped and self.options.stop():
            self._stopped = True
            raise _StopError
        for edge in edges:
            if edge.level:
                self.source.actuate(edge.limb, edge.time_s)
        fixes = self.source.advance(until_s)
        # The robot discards fixes before it is configured, so the twin does not get them.
        for fix in fixes if self._is_configured else ():
            recording = self.recording
            # An arrival is a sum of floats, which may be a rounding error before the previous one.
            at_s = max(until_s, fix.arrival_s, *(before.sent_s for before in recording.fixes[-1:]))
            sequence = self.session.post_fix(fix, at_s)
            self._unanswered[sequence] = len(recording.fixes)
            sent = SentFix(**asdict(fix), sent_s=at_s)
            recording.fixes.append(sent)
            if not self.options.onboard:
                sent.heard_us, sent.heard_after = round(fix.capture_s * 1e6), len(recording.decisions)
                self.twin.add_fix(sent.heard_us, fix.pose_world, fix.sequence)
