"""Replay: recorded fixes decided again by the robot, the host, or both, which are then compared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float32
from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.link.layout import Value, link_layout
from frogkick.link.wire import RobotPort
from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import configure
from frogkick.runs.decision import (
    STALE,
    Decision,
    DecisionTwin,
    RobotEvent,
    decision_of_event,
    events_of_frame,
)
from frogkick.runs.path_change import PathSender
from frogkick.runs.record import LEARN, lost_at_start
from frogkick.runs.recorded.importer import clock_problem
from frogkick.runs.runlog import PathChange, RunLog
from frogkick.runs.session import LinkError, Session
from frogkick.tables.image import Tables

LEAD_IN_S = 1.0  # robot time before the recorded run's time zero, for path and parameters
START_AHEAD_S = 0.2  # from ARM and START to the first decision
STEP_S = 0.02
_COORDINATE_MOST = 1e6  # of a fix, m or rad: beyond any pool, and within float32


@dataclass(frozen=True)
class Replay:
    """Result of a replay."""

    actions: list[str]  # name of each decision's action, of the robot where it took part, else of the host
    recorded: list[str | None]  # the same of the recorded run; None where unknown
    # onboard, host: decisions of each; empty without it
    onboard: list[Decision]
    host: list[Decision]
    # (decision, fields that differ) between robot and host, bit by bit
    differences: list[tuple[int, list[str]]]

    @property
    def agreement(self) -> float | None:
        """Share of decisions with the recorded action; None where none is known."""
        known = [a == r for a, r in zip(self.actions, self.recorded, strict=True) if r is not None]
        return float(np.mean(known)) if known else None


@dataclass(frozen=True)
class Schedule:
    """A run on the robot's clock."""

    fixes: list[tuple[float, Fix]]  # (arrival, fix), robot time in s, in order of arrival
    # first_us, period_us, decisions: time of the first decision, period, and number of decisions
    first_us: int
    period_us: int
    decisions: int
    then: tuple[PathChange, ...] = ()  # paths that take over
    # index of the action that was swum after each decision; None: not known
    strokes: tuple[int | None, ...] = ()


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
    fixes = []
    # The robot recognises a duplicate by its number and pose.
    numbers = run.fixes.extra.get("sequence", np.arange(len(run.fixes)))
    for row in np.flatnonzero(run.fixes.usable):
        pose = run.fixes.pose_world[row].tolist()
        arrival_s = LEAD_IN_S + float(run.fixes.time_s[row])
        capture_s = LEAD_IN_S + float(run.fixes.capture_time_s[row])
        fixes.append(
            (arrival_s, Fix(capture_s, arrival_s - capture_s, *pose, sequence=int(numbers[row]) & 0xFFFF))
        )
    first_us = round((LEAD_IN_S + float(run.decisions.time_s[0])) * 1e6)
    index = {row.name: number for number, row in enumerate(tables.actions)}
    strokes = tuple(index.get(name) for name in run.decided(unseen=""))
    return Schedule(fixes, first_us, round(run.period_s * 1e6), len(run.decisions), run.then, strokes)


def replay(
    run: RunLog,
    tables: Tables,
    config: PlanConfig,
    port: RobotPort | None,
    host: bool,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Replay:
    """Give a run's fixes to the planner at their recorded times, and decide at the recorded times.

    The strokes that it decides have no effect. On the host alone they are taken to be those that were swum,
    so that a decision which differs does not spoil the estimates after it; a robot takes its own for granted.

    Args:
        run: recorded run with its path.
        tables, config: for the planner.
        port: a robot with these tables that knows of its limbs what the recorded one knew at the run's start
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
    """The events of a robot on this schedule: a decision uses the fixes that arrived before it."""
    timed = [
        (round(arrival_s * 1e6), 0, RobotEvent(round(fix.capture_s * 1e6), fix.pose_world, fix.sequence))
        for arrival_s, fix in schedule.fixes
    ]
    for change in schedule.then:  # when it came is not known: at once after the decision before
        before_us = schedule.first_us + (change.decision - 1) * schedule.period_us
        timed.append((before_us, 3, RobotEvent(0, path=change.path)))
    for index in range(schedule.decisions):
        at_us = schedule.first_us + index * schedule.period_us
        timed.append((at_us, 1, RobotEvent(at_us)))
        if (stroke := schedule.strokes[index]) is not None:
            timed.append((at_us, 2, RobotEvent(at_us, action=stroke)))
    return [event for _, _, event in sorted(timed, key=lambda row: row[:2])]


def replay_onboard(
    schedule: Schedule,
    path: Path,
    tables: Tables,
    config: PlanConfig,
    port: RobotPort,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    learn: bool = False,
) -> tuple[list[Decision], list[RobotEvent]]:
    """Let a robot decide on a schedule's fixes; ``learn``: and learn what its limbs have lost.

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
    waiting = list(schedule.fixes)
    poses: dict[int, Float32] = {}
    sender, changes = PathSender(session), list(schedule.then)
    events: list[RobotEvent] = []
    decisions: list[Decision] = []
    running = False
    while len(decisions) < schedule.decisions:
        next_us = schedule.first_us + len(decisions) * schedule.period_us
        if not running and next_us * 1e-6 - session.time_s < START_AHEAD_S:
            # Also after the robot ended its run at the path's end: the recorded robot swam on.
            running = _start(session, next_us)
        if running and changes and len(decisions) >= changes[0].decision:
            sender.begin(changes.pop(0).path)
        next_s = waiting[0][0] if waiting else session.time_s + STEP_S
        session.step(max(min(next_s, session.time_s + STEP_S), session.time_s + 1e-6))
        while waiting and waiting[0][0] <= session.time_s:
            _, fix = waiting.pop(0)
            poses[session.post_fix(fix, session.time_s)] = fix.pose_world
        for arrival in session.take("FIX", "PATH", "DECISION", "REFUSED", "ENDED"):
            frame = arrival.frame
            events += events_of_frame(frame, poses)
            if frame.name == "PATH" and (changed := sender.answered(frame)) is not None:
                events.append(RobotEvent(0, path=changed))
            elif frame.name == "FIX":
                del poses[frame.sequence]
            elif frame.name == "DECISION":
                decisions.append(decision_of_event(frame.values))
                progress(len(decisions), schedule.decisions)
            elif frame.name == "ENDED":
                running = False
        if session.time_s * 1e6 > next_us + 5 * schedule.period_us:
            raise LinkError(f"the robot made no decision after {len(decisions)}: is it disarmed?")
    session.request("DISARM")
    return decisions, events


def _start(session: Session, first_us: int) -> bool:
    """ARM, and START with its first decision at a time; False where the robot has no fix yet."""
    session.request("ARM")
    delay_us = first_us - round(session.time_s * 1e6)
    values: dict[str, Value] = {"delay_us": max(0, delay_us)}
    status = int(session.ask("START", values)["status"])
    if status not in (0, STALE):
        raise LinkError(f"the robot refuses START {values}: {link_layout().status_name(status)}")
    return status == 0
