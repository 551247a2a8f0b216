"""The settings of a run, and the record that it fills and its log is made of."""

from __future__ import annotations

import hashlib
import pathlib
import shlex
import sys
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from typing import Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix, wrap_angle
from frogkick.core.version import VERSION
from frogkick.core.weights import WEIGHTS
from frogkick.estimator.follow import End
from frogkick.link.wire import Edge
from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig
from frogkick.pool.monitor import pulses_of, violations
from frogkick.pool.pool import Pool
from frogkick.robot import Robot
from frogkick.runs.decision import Decision, LiveCheck, RobotEvent
from frogkick.runs.path_change import NextPath, hold_spans
from frogkick.runs.runlog import (
    DecisionFlag,
    Decisions,
    Fixes,
    PathChange,
    RunLog,
    Strokes,
    Tracking,
    Truth,
)
from frogkick.runs.summary import LEARN, LOST, NO_ANSWER, along_paths
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMB_GONE, LIMBS_MAX, LOST_MAX

TIME = "time limit"
STOPPED = "stopped by hand"
DISARMED = "the robot disarmed itself"
DROPPED = "connection lost, and the robot ended the run meanwhile"
UNHEARD = "the robot ended the run, and its reason was lost"
ENDED = {
    "OK": End.COMPLETED.value,
    "PASSED": End.PASSED.value,
    "STALLED": End.STALLED.value,
    "STALE": "position fixes lost",
    "SUPPLY": "the robot's supply fell too low: charge it",
}
"""Status of an ENDED event -> why the run ended, for people."""

CANNOT_FOLLOW = "cannot follow"
"""The beginning of the reason why a run with a lost limb ended."""

ANEW_S = 60.0
"""Two fixes with one number are one fix that came twice if they are less apart: the 65,536 numbers last
longer, even at 1000 Hz. The clocks of robot and session agree better than this, too."""

FIRED = (-1, -1)
"""Values of ``rested_*`` for a stroke that was fired."""

_REQUIRED = (*list(WEIGHTS)[:4], "depth")
"""Planner settings that every log has; older logs lack the others, which keep their defaults."""

_INTEGERS = {"depth": (1, 4), "cost": (0, 1), "transitions_max": (0, 1e7)}
"""Limits of the planner's integer settings."""


@dataclass(frozen=True)
class RunOptions:
    """Settings of a run."""

    config: PlanConfig  # cost weights and depth of the planner
    onboard: bool = True  # True: the robot's planner decides; False: the twin on the host
    time_limit_s: float = 120.0  # longest time from the first decision on
    check: LiveCheck | None = None  # compares each decision of the robot with the host's; None: no comparison
    stop: Callable[[], bool] = lambda: False  # polled at each step; True ends the run
    learn: bool = False  # the planner, on robot or host, estimates the limbs' wear and plans with it
    then: tuple[NextPath, ...] = ()  # paths that take over during the run, in the order of their times
    # radius of the circle on which the robot holds at its path's end, m; None: the run ends there
    hold_m: float | None = None


@dataclass(slots=True, kw_only=True)
class SentFix(Fix):
    """A fix that was sent to the robot, and what became of it; -1: unknown."""

    sent_s: float  # session time
    robot_capture_us: int = -1  # capture time on the robot's clock; -1 if the robot refused it
    robot_status: int = NO_ANSWER  # the robot's answer (``frames.toml``)
    # heard_us, heard_after: capture time, us, on the planner's clock (robot or host), and the number of
    # decisions before it; -1: the estimator did not receive it
    heard_us: int = -1
    heard_after: int = -1

    @property
    def is_answered(self) -> bool:
        """Whether the robot has answered."""
        return self.robot_status != NO_ANSWER


@dataclass
class Recording:
    """A run: its path and settings, and everything that has happened so far.

    ``log`` returns it in columns.
    """

    robot: Robot
    tables: Tables
    path: Path
    options: RunOptions
    # source, seed, made: as in ``RunLog``; known: further numbers for ``RunLog.measured``
    source: str = ""
    seed: int | None = None
    known: Mapping[str, float] = field(default_factory=dict)
    made: Mapping[str, str] = field(default_factory=dict)
    pool: Pool | None = None  # the simulated pool, which knows the true poses; None: a real run
    fixes: list[SentFix] = field(default_factory=list)  # in the order of sending
    # inputs of the robot's estimator and planner, in its order: they reproduce its decisions
    events: list[RobotEvent] = field(default_factory=list)
    # index of a decision whose stroke the guard refused -> time from which the robot rested instead, us, on
    # the planner's clock, and the number of fixes that it had received before it knew
    rested: dict[int, tuple[int, int]] = field(default_factory=dict)
    # decisions, edges: decisions and pin edges in order
    decisions: list[Decision] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    then: list[PathChange] = field(default_factory=list)  # paths that took over, and from which decision on
    completed: bool = False  # the robot reached the end of the path, or held there until the run was ended
    ended: str = ""  # why the run ended: a value of ENDED, or TIME, STOPPED, DISARMED, DROPPED, UNHEARD
    fixes_refused: int = 0  # the robot's own counter
    # first_decision_s, end_s: session time
    first_decision_s: float = 0.0
    end_s: float = 0.0
    clock_offset_us: int = 0  # robot time minus session time; 0 in simulated time

    def decision_columns(self, first: int = 0) -> Decisions:
        """Decisions as log columns, from row ``first`` on.

        The host decides on its own clock. Its planning times are left out, so that a seed gives the same log.
        """
        decisions, onboard = self.decisions[first:], self.options.onboard
        offset_us = self.clock_offset_us if onboard else 0
        failed = np.array([d.status != 0 for d in decisions], dtype=bool)
        planned = np.where(failed, np.nan, 1.0)
        rows = range(first, first + len(decisions))
        rested = np.array([self.rested.get(row, FIRED) for row in rows], dtype=np.int64).reshape(-1, 2)

        def integers(name: str) -> np.ndarray:
            return np.array([getattr(d, name) for d in decisions], dtype=np.int64)

        def states(name: str) -> np.ndarray:
            return np.array([getattr(d, name) for d in decisions], dtype=np.float64).reshape(-1, 6)

        time_s = (integers("scheduled_us") - offset_us) * 1e-6
        return Decisions(
            time_s=time_s,
            action=integers("action"),
            fix_sequence=np.array(self._newest_fixes(decisions, time_s.tolist())),
            flags=np.where(failed, int(DecisionFlag.NO_PLAN), 0),
            cost=np.array([float(d.cost) for d in decisions]) * planned,
            estimate=states("estimate") * planned[:, None],
            predicted=states("predicted") * planned[:, None],
            plan_s=integers("plan_us") * 1e-6 * planned if onboard else None,
            extra={
                **{name: integers(name) for name in ("status", "path_index", "scheduled_us")},
                "limb_use": integers("limb_use").reshape(-1, LIMBS_MAX),
                "rested_us": rested[:, 0],
                "rested_after": rested[:, 1],
                **({"lost": integers("lost").reshape(-1, LIMBS_MAX)} if self.options.learn else {}),
            },
        )

    def _newest_fixes(self, decisions: Sequence[Decision], time_s: Sequence[float]) -> list[int]:
        """Row of the newest fix in each decision's estimate, the first one of a duplicate; -1 without a fix.

        Numbers of fixes begin anew after 65,536, so one of them stands for the last fix that had it.
        """
        found, rows = [], dict[int, int]()
        row = bisect_left(self.fixes, time_s[0] - ANEW_S, key=lambda fix: fix.sent_s) if time_s else 0
        for decision, at_s in zip(decisions, time_s, strict=True):
            while row < len(self.fixes) and (fix := self.fixes[row]).sent_s <= at_s + ANEW_S:
                before = rows.setdefault(fix.sequence, row)
                if fix.sent_s - self.fixes[before].sent_s > ANEW_S:
                    rows[fix.sequence] = row
                row += 1
            found.append(rows.get(decision.fix_sequence, -1) if decision.fixes else -1)
        return found

    def fix_columns(self, first: int = 0) -> Fixes:
        """Fixes as log columns, from row ``first`` on."""
        fixes = self.fixes[first:]
        poses = np.array([fix.pose_world for fix in fixes], dtype=np.float64).reshape(-1, 3)
        count = len(fixes)
        known = ("sequence", "robot_capture_us", "robot_status", "heard_us", "heard_after")
        return Fixes(
            time_s=np.array([fix.sent_s for fix in fixes]),
            capture_time_s=np.array([fix.capture_s for fix in fixes]),
            x_m=poses[:, 0],
            y_m=poses[:, 1],
            heading_rad=wrap_angle(poses[:, 2]),
            quality=np.ones(count, dtype=np.uint8),
            flags=np.zeros(count, dtype=np.uint16),
            extra={name: np.array([getattr(fix, name) for fix in fixes], dtype=np.int64) for name in known},
        )

    def log(self) -> RunLog:
        """The log of the run so far."""
        robot, tables, options, truth = self.robot, self.tables, self.options, None
        pulses = pulses_of(self.edges, self.end_s)
        fired: dict[tuple[float, float], int] = {}  # begin and end -> mask of the limbs
        for pulse in pulses:
            span_s = pulse.start_s, pulse.end_s
            fired[span_s] = fired.get(span_s, 0) | 1 << pulse.limb
        spans = sorted(fired)
        tracked = self.tracking()
        numbers = tracked.as_json()
        if not options.onboard:
            del numbers["plan_ms_p99"]
        lost, limbs = {}, [limb.name for limb in robot.limbs]
        if options.learn and self.decisions:
            shares = [code / LOST_MAX for code in self.decisions[-1].lost]
            lost = {LOST + limb: share for limb, share in zip(limbs, shares, strict=False)}
        if self.pool is not None:
            seen = self.pool.truth
            truth = Truth(
                np.array(seen.time_s),
                np.array(seen.pose_world).reshape(-1, 3),
                np.array(seen.velocity_body).reshape(-1, 3),
            )
        return RunLog(
            robot_id=robot.id,
            source=self.source,
            period_s=tables.period_us / 1e6,
            pulse_s=tables.pulse_us / 1e6,
            action_names=tuple(action.name for action in robot.actions),
            fixes=self.fix_columns(),
            decisions=self.decision_columns(),
            strokes=Strokes(
                time_s=np.array([start for start, _ in spans]),
                limb_mask=np.array([fired[span_s] for span_s in spans], dtype=np.int64),
                pulse_s=np.array([end - start for start, end in spans]),
            ),
            path=self.path,
            then=tuple(self.then),
            truth=truth,
            table_crc=tables.crc32,
            seed=self.seed,
            notes=_ended(self.ended, lost),
            measured={key: float(n) for key, n in numbers.items() if n is not None and np.isfinite(n)}
            | lost
            | dict(self.known),
            planner={key: float(value) for key, value in asdict(options.config).items()},
            made={**self.made, **({LEARN: ", ".join(limbs)} if options.learn else {})},
            tracked=tracked,
        )

    def tracking(self) -> Tracking:
        """How well the path was followed, by the true poses of a simulated pool or by the fixes."""
        if self.pool is None:
            taken = [fix for fix in self.fixes if fix.robot_status == 0]
            time_s = np.array([fix.capture_s for fix in taken])
            poses = np.array([fix.pose_world for fix in taken], dtype=np.float64).reshape(-1, 3)
        else:
            truth = self.pool.truth
            time_s, poses = np.array(truth.time_s), np.array(truth.pose_world).reshape(-1, 3)
        during = (time_s >= self.first_decision_s) & (time_s <= self.end_s)
        plan_ms = [d.plan_us * 1e-3 for d in self.decisions if d.status == 0]
        pulses = pulses_of(self.edges, self.end_s)
        after_us = [d.scheduled_us - self.decisions[0].scheduled_us for d in self.decisions]
        decided_s = self.first_decision_s + 1e-6 * np.array(after_us, dtype=np.float64)
        paths = [(-np.inf, self.path)] + [(float(decided_s[one.decision]), one.path) for one in self.then]
        held = hold_spans(decided_s, [d.path_index for d in self.decisions], self.then)
        holds_s = held[0][0] if held else np.inf
        mean_m, p95_m, progress_mps = along_paths(paths, time_s[during], poses[during], holds_s)
        return Tracking(
            mean_distance_m=mean_m,
            p95_distance_m=p95_m,
            progress_mps=progress_mps,
            completed=self.completed,
            decisions=len(self.decisions),
            fixes_lost=self.fixes_refused,
            limit_violations=None
            if self.pool is None and not pulses
            else len(violations(self.robot, pulses)),
            plan_ms_p99=float(np.percentile(plan_ms, 99)) if any(plan_ms) else None,
        )


def _ended(ended: str, lost: Mapping[str, float]) -> str:
    """Why a run ended; if it could not follow its path, also which limbs are lost."""
    gone = [key.removeprefix(LOST) for key, share in lost.items() if share * LOST_MAX >= LIMB_GONE]
    if gone and ended in (End.STALLED.value, End.PASSED.value):
        return f"{CANNOT_FOLLOW} without {', '.join(gone)}: {ended}"
    return ended


def made_of(robot: Robot, tables: Tables, began_unix_s: float | None = None) -> dict[str, str]:
    """Provenance of a run for ``RunLog.made``.

    ``began_unix_s`` is the wall clock at the run's time 0; None for a simulated run, which has the same bytes
    whenever it is made.
    """
    program = pathlib.Path(sys.argv[0] if sys.argv else "")
    is_ours = program.stem == "frogkick" or program.parts[-3:] == ("frogkick", "cli", "main.py")
    began = {}
    if began_unix_s is not None:
        began = {"began_at": datetime.fromtimestamp(began_unix_s, UTC).isoformat(timespec="microseconds")}
    return {
        **began,
        "frogkick": VERSION,
        "robot_toml": robot.toml,
        "robot_sha256": robot.sha256.hex(),
        "table_sha256": hashlib.sha256(tables.image).hexdigest(),
        **({"command": shlex.join(["frogkick", *sys.argv[1:]])} if is_ours else {}),
    }


def config_of_log(run: RunLog) -> PlanConfig:
    """The planner configuration in a log.

    Raises:
        InputError: the log has none, or it is incomplete or out of its limits.
    """
    missing = [name for name in _REQUIRED if name not in run.planner]
    if missing:
        raise InputError(
            f"run {run.source!r} does not say the planner's {missing[0]}: choose --planner paper or robot"
        )
    values: dict[str, Any] = {}
    for entry in fields(PlanConfig):
        if (value := run.planner.get(entry.name)) is None:
            continue
        is_integer = entry.name in _INTEGERS
        low, high = _INTEGERS[entry.name] if is_integer else WEIGHTS[entry.name].limits
        if not low <= value <= high or (is_integer and value != int(value)):
            raise InputError(
                f"run {run.source!r}: planner {entry.name} is {value:g}, allowed is {low:g} to {high:g}: "
                "choose --planner paper or robot"
            )
        values[entry.name] = int(value) if is_integer else value
    return PlanConfig(**values)
