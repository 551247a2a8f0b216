"""A closed-loop run in the simulated pool: fixes in, strokes out, everything logged."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from frogkick.errors import InputError
from frogkick.link.frames import Frame
from frogkick.link.layout import link_layout
from frogkick.loop.decision import Decision, DecisionTwin, RobotEvent, decision_of_event
from frogkick.loop.session import Session
from frogkick.paths import Path
from frogkick.planner.image import Tables
from frogkick.planner.plan import PlanConfig
from frogkick.pool.camera import Fix
from frogkick.pool.pool import Pool
from frogkick.pool.port import Edge, RobotPort
from frogkick.robot import Robot

SETTLE_S = 0.6  # fixes before the start, so that the first estimate knows a velocity
START_DELAY_S = 0.1
# A chip boots longer than the core on this computer. From a common time on, both meet the same fixes.
READY_S = 1.0


@dataclass
class Recording:
    """What a run leaves behind, before it becomes a log.

    Attributes:
        fixes: fixes in order of sending.
        sent_s: when each was sent.
        capture_us: capture time of each on the robot's clock; None where the robot took none.
        events: what the robot met, in its order: enough to decide everything again on the host.
        decisions: in order.
        edges: pin edges.
        completed: the path's end was reached.
        ended: why the run ended, for people.
        fixes_refused: the robot's own counter.
        first_decision_s, end_s: robot time.
    """

    fixes: list[Fix] = field(default_factory=list)
    sent_s: list[float] = field(default_factory=list)
    capture_us: list[int | None] = field(default_factory=list)
    events: list[RobotEvent] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    completed: bool = False
    ended: str = ""
    fixes_refused: int = 0
    first_decision_s: float = 0.0
    end_s: float = 0.0


@dataclass(frozen=True)
class RunOptions:
    """How to run.

    Attributes:
        config: cost weights and depth of the planner.
        onboard: True = the robot's planner decides, False = the twin on the host does.
        time_limit_s: pool time after which the run is stopped.
    """

    config: PlanConfig
    onboard: bool = True
    time_limit_s: float = 120.0


def robot_plan_config(robot: Robot) -> PlanConfig:
    """The planner configuration of a robot's TOML."""
    planner = robot.planner
    return PlanConfig(
        planner.distance_weight_per_m,
        planner.angle_weight_per_rad,
        planner.progress_weight,
        planner.level_weight,
        planner.depth,
    )


def parameters(config: PlanConfig) -> dict[str, float]:
    """The robot's PARAM values for a planner configuration."""
    return {
        "DEPTH": config.depth,
        "DISTANCE_WEIGHT_PER_M": config.distance_weight_per_m,
        "ANGLE_WEIGHT_PER_RAD": config.angle_weight_per_rad,
        "PROGRESS_WEIGHT": config.progress_weight,
        "LEVEL_WEIGHT": config.level_weight,
    }


def require_time(limit_s: float) -> None:
    """Refuse a time limit that ends no run.

    Raises:
        InputError: not a finite number above 0.
    """
    if not (math.isfinite(limit_s) and limit_s > 0.0):
        raise InputError(f"simulated time is {limit_s} s: give a finite number above 0")


def run_in_pool(
    port: RobotPort,
    pool: Pool,
    tables: Tables,
    path: Path,
    options: RunOptions,
    progress: Callable[[float, int], None] = lambda _time_s, _path_index: None,
) -> Recording:
    """Follow a path in the simulated pool.

    Args:
        port: the robot; its clock and the pool's are the same.
        pool: swimmer and camera.
        tables: the robot's own tables.
        path: where to swim, world frame.
        options: who plans, and how.
        progress: called after each decision with the pool time and the nearest path point.

    Raises:
        InputError: the time limit is not a finite number above 0.
        LinkError: the robot refuses or does not answer.
        ConvergenceError: the pool's physics failed.
    """
    require_time(options.time_limit_s)
    run = _PoolRun(port, pool, tables, path, options, progress)
    return run.go()


class _PoolRun:
    def __init__(
        self,
        port: RobotPort,
        pool: Pool,
        tables: Tables,
        path: Path,
        options: RunOptions,
        progress: Callable[[float, int], None],
    ) -> None:
        self.pool = pool
        self.tables = tables
        self.path = path
        self.options = options
        self.progress = progress
        self.recording = Recording()
        self.session = Session(port, self._pool_step)
        self.twin = DecisionTwin(tables, path, options.config)
        self._awaited: dict[int, int] = {}

    def go(self) -> Recording:
        session, options = self.session, self.options
        session.greet(self.tables)
        session.set_parameters(parameters(options.config))
        session.send_path(self.path)
        session.request("ARM")
        self._live_until(max(session.time_s + SETTLE_S, READY_S))
        if options.onboard:
            self._run_onboard()
        else:
            self._run_on_host()
        self.recording.end_s = session.time_s
        session.request("DISARM")
        self.recording.fixes_refused = int(session.request("STATUS")["fixes_refused"])
        self.recording.edges = session.edges
        return self.recording

    def _run_onboard(self) -> None:
        session, recording = self.session, self.recording
        delay_us = round(START_DELAY_S * 1e6)
        recording.first_decision_s = (
            int(session.request("START", {"delay_us": delay_us})["first_decision_us"]) * 1e-6
        )
        limit_s = recording.first_decision_s + self.options.time_limit_s
        while session.time_s < limit_s:
            self._live_until(min(session.time_s + 0.05, limit_s))
            if recording.ended:
                return
        session.request("STOP")
        recording.ended = "time limit"

    def _run_on_host(self) -> None:
        session, recording = self.session, self.recording
        start_us = round((session.time_s + START_DELAY_S) * 1e6)
        recording.first_decision_s = start_us * 1e-6
        limit_s = recording.first_decision_s + self.options.time_limit_s
        while True:
            at_us = start_us + len(recording.decisions) * self.tables.period_us
            self._live_until(min(at_us * 1e-6, limit_s))
            if session.time_s >= limit_s:
                recording.ended = "time limit"
                return
            if self.twin.is_lost(at_us):
                recording.ended = "robot ended: STALE"
                return
            began = time.perf_counter()
            decision = self.twin.decide(at_us)
            elapsed_us = round((time.perf_counter() - began) * 1e6)
            decision = Decision(**{**decision.__dict__, "plan_us": elapsed_us})
            recording.decisions.append(decision)
            self.progress(session.time_s, decision.path_index)
            if self.twin.is_completed(decision):
                recording.completed = True
                recording.ended = "path completed"
                return
            if decision.action < len(self.tables.actions):
                session.post("STROKE", {"action": decision.action})

    def _live_until(self, until_s: float) -> None:
        while self.session.time_s < until_s:
            self.session.step(min(max(self.pool.next_event_s, self.session.time_s + 1e-6), until_s))
            for arrival in self.session.take("FIX", "STROKE", "DECISION", "ENDED"):
                self._note(arrival.frame)

    def _note(self, frame: Frame) -> None:
        recording, values = self.recording, frame.values
        if frame.name == "FIX":
            row = self._awaited.pop(frame.sequence)
            if values["status"] == 0:
                capture_us = int(values["capture_us"])
                recording.capture_us[row] = capture_us
                fix = recording.fixes[row]
                recording.events.append(RobotEvent(capture_us, fix.pose_world, fix.sequence))
        elif frame.name == "DECISION":
            decision = decision_of_event(values)
            recording.decisions.append(decision)
            recording.events.append(RobotEvent(decision.scheduled_us))
            self.progress(self.session.time_s, decision.path_index)
        elif frame.name == "ENDED":
            recording.completed = values["status"] == 0
            name = link_layout().status_name(int(values["status"]))
            recording.ended = "path completed" if recording.completed else f"robot ended: {name}"

    def _pool_step(self, until_s: float, edges: Sequence[Edge]) -> None:
        """The pool lives through a step of the robot; fixes that arrive go straight to the robot."""
        for edge in edges:
            if edge.level:
                self.pool.heat(edge.limb, edge.time_s)
        for fix in self.pool.advance(until_s):
            at_s = max(until_s, fix.arrival_s)
            sequence = self.session.post_fix(fix, at_s)
            recording = self.recording
            self._awaited[sequence] = len(recording.fixes)
            recording.fixes.append(fix)
            recording.sent_s.append(at_s)
            recording.capture_us.append(None)
            if not self.options.onboard:
                self.twin.add_fix(round(fix.capture_s * 1e6), fix.pose_world, fix.sequence)
