"""Replay: decisions from recorded fixes, repeated by the robot, the host, or both and compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from frogkick.core.arrays import Float32
from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.link.frames import Frame, pack_frame
from frogkick.link.layout import Value, link_layout
from frogkick.link.wire import BYTE_S, RobotPort
from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import configure
from frogkick.runs.decision import (
    RESTING,
    STALE,
    Decision,
    DecisionTwin,
    RobotEvent,
    decision_of_event,
    events_of_frame,
)
from frogkick.runs.path_change import PathSender
from frogkick.runs.record import SentFix
from frogkick.runs.recorded.importer import clock_problem
from frogkick.runs.runlog import PathChange, RunLog
from frogkick.runs.session import LinkError, Session, fix_values
from frogkick.runs.summary import LEARN, lost_at_start
from frogkick.tables.image import Tables

LEAD_IN_S = 1.0  # robot time before the recorded run's time zero, for path and parameters
START_AHEAD_S = 0.2  # from ARM and START to the first decision
STEP_S = 0.02
_AHEAD_US = 6000  # a fix is sent at least this long before the decision that the recorded robot used it in
_PATH_US = 25_000  # longest time of a part of a path on the line
_COORDINATE_MOST = 1e6  # limit of a fix, m or rad: beyond any pool, and within float32


@dataclass(frozen=True)
class Replay:
    """Result of a replay."""

    actions: list[str]  # name of each decision's action: the robot's if it took part, else the host's
    recorded: list[str | None]  # the same of the recorded run; None if unknown
    # onboard, host: decisions of each; empty without it
    onboard: list[Decision]
    host: list[Decision]
    # (decision, fields that differ) between robot and host, bit by bit
    differences: list[tuple[int, list[str]]]

    @property
    def agreement(self) -> float | None:
        """Share of decisions with the recorded action; None if none is known."""
        known = [a == r for a, r in zip(self.actions, self.recorded, strict=True) if r is not None]
        return float(np.mean(known)) if known else None


@dataclass(frozen=True)
class Schedule:
    """A run on the robot's clock."""

    # in order of arrival, robot time; without ``heard_*``: heard by their times
    fixes: list[SentFix]
    # first_us, period_us, decisions: time of the first decision, period, and number of decisions
    first_us: int
    period_us: int
    decisions: int
    then: tuple[PathChange, ...] = ()  # paths that take over
    # index of the action that was fired after each decision; None: not known
    strokes: tuple[int | None, ...] = ()
    # decision whose stroke the guard refused -> time from which the robot rested, us; number of fixes before
    rested: Mapping[int, tuple[int, int]] = field(default_factory=dict)

    def decided_us(self, index: int) -> int:
        """Time of a decision."""
        return self.first_us + index * self.period_us

    def heard_of(self, fix: SentFix) -> tuple[int, int]:
        """Capture time of a fix, us, and the number of decisions before it."""
        if fix.heard_after >= 0:
            return fix.heard_us, fix.heard_after
        before = -((self.first_us - round(fix.sent_s * 1e6)) // self.period_us)
        return round(fix.capture_s * 1e6), max(0, before)


def require_replayable(run: RunLog) -> None:
    """Raise InputError unless a run has a path, a constant period, decisions and usable fixes in range."""
    if run.path is None:
        raise InputError(f"run {run.source!r} has no path: a replay needs the one that was followed")
    if len(run.decisions) == 0:
        raise InputError(f"run {run.source!r} has no decisions: nothing to replay")
    if clock_problem(run):
        raise InputError(f"run {run.source!r} cannot be replayed: {clock_problem(run)}: give another run")
    if run.measured.get("clock_slips"):
        raise InputError(
            f"run {run.source!r} cannot be replayed: its stroke clock slips ({run.notes}), and a replay "
            "needs a constant one: cut the run there"
        )
    if not run.fixes.usable.any():
        raise InputError(f"run {run.source!r} has no usable fix: nothing to replay")
    for name in ("x_m", "y_m", "heading_rad"):
        most = float(np.abs(getattr(run.fixes, name)[run.fixes.usable]).max())
        if not most <= _COORDINATE_MOST:
            raise InputError(
                f"run {run.source!r} has a fix with {name} of {most:g}, the limit is {_COORDINATE_MOST:g}: "
                "correct it"
            )


def _schedule(run: RunLog, tables: Tables) -> Schedule:
    extra, first_us = run.fixes.extra, round((LEAD_IN_S + float(run.decisions.time_s[0])) * 1e6)
    heard_us = extra.get("heard_us", np.full(len(run.fixes), -1))
    known = run.fixes.usable & (heard_us >= 0)
    is_exact = bool(known.any()) and "heard_after" in extra and "scheduled_us" in run.decisions.extra
    used = known if is_exact else run.fixes.usable
    later_us = first_us - int(run.decisions.extra["scheduled_us"][0]) if is_exact else 0
    fixes: list[SentFix] = []
    # The robot recognises a duplicate by its number and pose.
    numbers = extra.get("sequence", np.arange(len(run.fixes)))
    poses = run.fixes.pose_world
    for row in np.flatnonzero(used):
        pose = poses[row].tolist()
        arrival_s = LEAD_IN_S + float(run.fixes.time_s[row])
        capture_s = LEAD_IN_S + float(run.fixes.capture_time_s[row])
        number = int(numbers[row]) & 0xFFFF
        fixes.append(SentFix(capture_s, arrival_s - capture_s, *pose, sent_s=arrival_s, sequence=number))
        if is_exact:
            fixes[-1].heard_us = int(heard_us[row]) + later_us
            fixes[-1].heard_after = int(extra["heard_after"][row])
    numbered = {action.name: number for number, action in enumerate(tables.actions)}
    strokes = tuple(numbered.get(name) for name in run.decided(unseen=""))
    period_us = round(run.period_s * 1e6)
    rested: dict[int, tuple[int, int]] = {}
    if is_exact and {"rested_us", "rested_after"} <= run.decisions.extra.keys():
        rested_us, after = (run.decisions.extra[name] for name in ("rested_us", "rested_after"))
        for index in np.flatnonzero(rested_us >= 0).tolist():
            rested[index] = int(rested_us[index]) + later_us, int(np.count_nonzero(used[: after[index]]))
    return Schedule(fixes, first_us, period_us, len(run.decisions), run.then, strokes, rested)


def replay(
    run: RunLog,
    tables: Tables,
    config: PlanConfig,
    port: RobotPort | None,
    host: bool,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Replay:
    """Give a run's fixes to the planner at their recorded times, and decide at the recorded times.

    The decided strokes have no effect. On the host alone, the strokes of the recorded run are assumed to have
    been fired, so that a decision that differs does not corrupt later estimates. A robot assumes its own
    strokes. Its limbs are cool, so it also fires the strokes that the recorded robot's guard had refused.

    Args:
        run: recorded run with its path.
        tables, config: for the planner.
        port: a robot with this table and the wear estimate that the recorded one had at the start of the run
            (``lost_at_start``); None: the host alone.
        host: whether the host's twins decide too.
        progress: called with decisions done and to do.

    Raises:
        InputError: see ``require_replayable``.
        LinkError: the robot refuses or does not answer.
    """
    require_replayable(run)
    schedule = _schedule(run, tables)
    assert run.path is not None
    onboard: list[Decision] = []
    learn = LEARN in run.made
    if port is not None:
        onboard, events = replay_onboard(schedule, run.path, tables, config, port, progress, learn)
    else:
        events = _events_of(schedule)
    twin = DecisionTwin(tables, run.path, config, learn=learn, lost=lost_at_start(run))
    decided = replay_on_host(events, twin) if host else []
    names = [row.name for row in tables.actions] + ["-"]
    actions = [names[d.action] for d in (onboard or decided)]
    recorded: list[str | None] = [name or None for name in run.decided(unseen="")[: len(actions)]]
    differences = compare(onboard, decided) if port is not None and host else []
    return Replay(actions, recorded, onboard, decided, differences)


def compare(onboard: Sequence[Decision], host: Sequence[Decision]) -> list[tuple[int, list[str]]]:
    """Decisions that differ in any bit, with the fields; a missing decision counts as different."""
    found = [
        (index, fields)
        for index, (a, b) in enumerate(zip(onboard, host, strict=False))
        if (fields := a.differences(b))
    ]
    shorter = min(len(onboard), len(host))
    return found + [(index, ["missing"]) for index in range(shorter, max(len(onboard), len(host)))]


def replay_on_host(events: Sequence[RobotEvent], twin: DecisionTwin) -> list[Decision]:
    """The twin's decisions for a robot's events."""
    return [decision for event in events if (decision := twin.apply(event)) is not None]


def _events_of(schedule: Schedule) -> list[RobotEvent]:
    """The events of a robot on this schedule; for each decision, first those before it."""
    # Before a decision a path, and fixes by their rows; then the decision, and its stroke.
    ordered: list[tuple[tuple[int, int, float], RobotEvent]] = []
    for change in schedule.then:  # its time of arrival is not known: directly after the previous decision
        ordered.append(((change.decision, 0, 0), RobotEvent(0, path=change.path)))
    for row, fix in enumerate(schedule.fixes):
        capture_us, before = schedule.heard_of(fix)
        ordered.append(((before, 1, row), RobotEvent(capture_us, fix.pose_world, fix.sequence)))
    for index in range(schedule.decisions):
        at_us = schedule.decided_us(index)
        ordered.append(((index, 2, 0), RobotEvent(at_us)))
        if (stroke := schedule.strokes[index]) is not None:
            ordered.append(((index, 3, 0), RobotEvent(at_us, action=stroke)))
        if index in schedule.rested:
            begin_us, after = schedule.rested[index]
            ordered.append(((index + 1, 1, after - 0.5), RobotEvent(begin_us, action=RESTING)))
    return [event for _, event in sorted(ordered, key=lambda row: row[0])]


@dataclass
class _Line:
    """The line to a robot in simulated time, on which each fix shall be read at a given microsecond.

    Attributes:
        late_us: time from a frame's last byte to its reading, for the last fix.
        free_us: time at which the line has sent all posted frames.
    """

    session: Session
    late_us: int = 0
    free_us: int = 0
    # sequence number of a fix -> time at which it shall be read, and its stated age
    sent: dict[int, tuple[int, int]] = field(default_factory=dict)

    def read_us(self, name: str, values: dict[str, Value]) -> int:
        """Time at which a frame that is posted now is read."""
        return self._now_us + self._wire_us(name, values) + self.late_us

    @property
    def _now_us(self) -> int:
        return math.ceil(round(self.session.time_s * 1e6, 3))

    @staticmethod
    def _wire_us(name: str, values: dict[str, Value]) -> int:
        return round(len(pack_frame(name, "command", 0, values)) * BYTE_S * 1e6)

    def post_path(self) -> None:
        """Record that a part of a path was posted."""
        self.free_us = max(self.free_us, self._now_us) + _PATH_US

    def post_fix(self, fix: Fix, capture_us: int) -> int:
        """Send a fix as soon as the line is free; return its sequence number."""
        values = fix_values(fix, 0)
        begin_us = max(self._now_us, self.free_us)
        self.free_us = begin_us + self._wire_us("FIX", values)
        age_us = max(0, self.free_us + self.late_us - capture_us)
        sequence = self.session.post("FIX", values | {"capture_age_us": age_us}, at_s=begin_us * 1e-6)
        self.sent[sequence] = self.free_us, age_us
        return sequence

    def answered(self, frame: Frame) -> None:
        """Measure from the answer to a fix how late it was read."""
        read_us, age_us = self.sent.pop(frame.sequence)
        if frame.values["capture_us"]:
            self.late_us = int(frame.values["capture_us"]) + age_us - read_us


def replay_onboard(
    schedule: Schedule,
    path: Path,
    tables: Tables,
    config: PlanConfig,
    port: RobotPort,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    learn: bool = False,
) -> tuple[list[Decision], list[RobotEvent]]:
    """Let a robot decide on a schedule's fixes, with ``learn`` also estimate the wear of its limbs.

    Returns:
        Its decisions, and its events for ``replay_on_host``.

    Raises:
        LinkError: the robot refuses or does not answer.
    """
    session = Session(port)
    session.handshake(tables)
    configure(session, config, learn)
    session.set_parameters({"PERIOD_US": schedule.period_us})
    session.send_path(path)
    waiting = [(fix, *schedule.heard_of(fix)) for fix in schedule.fixes]
    line = _Line(session) if any(fix.heard_after >= 0 for fix in schedule.fixes) else None
    poses: dict[int, Float32] = {}
    sender, changes = PathSender(session), list(schedule.then)
    events: list[RobotEvent] = []
    decisions: list[Decision] = []
    running = False

    def due_s() -> float:
        """Time at which to send the next fix: at its arrival, and between the right decisions."""
        fix, capture_us, before = waiting[0]
        if line is None:
            return fix.sent_s
        if running and len(decisions) < before:
            return math.inf
        latest_us = schedule.decided_us(before) - _AHEAD_US
        return max(min(fix.sent_s, latest_us * 1e-6), capture_us * 1e-6)

    while len(decisions) < schedule.decisions:
        next_us = schedule.first_us + len(decisions) * schedule.period_us
        if not running and next_us * 1e-6 - session.time_s < START_AHEAD_S:
            # Also after the robot's run has ended at the end of the path: the recorded robot continued.
            running = _start(session, next_us, line)
        if running and changes and len(decisions) >= changes[0].decision:
            sender.begin(changes.pop(0).path)
            if line is not None:
                line.post_path()
        next_s = due_s() if waiting else session.time_s + STEP_S
        session.step(max(min(next_s, session.time_s + STEP_S), session.time_s + 1e-6))
        while waiting and due_s() <= session.time_s:
            fix, capture_us, _ = waiting.pop(0)
            if line is None:
                sequence = session.post_fix(fix, session.time_s)
            else:
                sequence = line.post_fix(fix, capture_us)
            poses[sequence] = fix.pose_world
        for arrival in session.take("FIX", "PATH", "DECISION", "REFUSED", "ENDED"):
            frame = arrival.frame
            events += events_of_frame(frame, poses)
            if frame.name == "PATH" and (changed := sender.answered(frame)) is not None:
                events.append(RobotEvent(0, path=changed))
            elif frame.name == "PATH" and line is not None:
                line.post_path()
            elif frame.name == "FIX":
                if line is not None:
                    line.answered(frame)
                del poses[frame.sequence]
            elif frame.name == "DECISION":
                decisions.append(decision_of_event(frame.values))
                progress(len(decisions), schedule.decisions)
            elif frame.name == "ENDED":
                running = False
        if session.time_s * 1e6 > next_us + 5 * schedule.period_us:
            raise LinkError(
                f"the robot made no decision after {len(decisions)}: see its log ('frogkick log fetch')"
            )
    session.request("DISARM")
    return decisions, events


def _start(session: Session, first_us: int, line: _Line | None) -> bool:
    """ARM, and START with the first decision at a given time; False if the robot has no fix yet.

    On a ``line``, a START that was read at another microsecond than expected is stopped and repeated.
    """
    session.request("ARM")
    late_us = 0
    for tries_left in range(0 if line is None else 2, -1, -1):
        read_us = round(session.time_s * 1e6) if line is None else line.read_us("START", {"delay_us": 0})
        values: dict[str, Value] = {"delay_us": max(0, first_us - read_us - late_us)}
        answer = session.ask("START", values)
        status = int(answer["status"])
        if status not in (0, STALE):
            raise LinkError(f"the robot refuses START {values}: {link_layout().status_name(status)}")
        off_us = int(answer["first_decision_us"]) - first_us
        if status == STALE or tries_left == 0 or off_us == 0:
            break
        session.request("STOP")
        late_us += off_us
    return status == 0
