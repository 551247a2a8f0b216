"""Three estimators with faulty fixes: errors at decisions, and closed-loop distance to the path."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path as Folder

import numpy as np

from frogkick.core.arrays import Float32, Float64
from frogkick.core.chunks import Job, run_chunks
from frogkick.core.poses import body_from_world, wrap_angle
from frogkick.effects import World, make_effects
from frogkick.estimator.estimator import (
    FIELD_M,
    FUTURE_US,
    OK,
    OLD,
    RANGE,
    STALE_US,
    Estimate,
    Estimates,
    Estimator,
)
from frogkick.front.places import start_pose
from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig
from frogkick.pool.pool import Camera, Pool
from frogkick.robot import Robot
from frogkick.runs.decision import DecisionTwin
from frogkick.runs.summary import along_paths
from frogkick.tables.image import Tables, open_image

LINE_FIXES_MAX = 8
LINE_WINDOW_S = 0.25


class FromLastFixes:
    """An estimator that keeps the last fixes in order of capture, and ignores strokes."""

    def __init__(self, state: Callable[[Float64, Float64, Float64, float], tuple[Float64, Float64]]) -> None:
        """``state`` returns pose and velocity (3,), world frame, such as ``line_through``."""
        self._state = state
        self._fixes: list[tuple[int, Float64, int]] = []

    @property
    def newest_capture_us(self) -> int | None:
        """Capture time of the newest fix, None before the first."""
        return self._fixes[-1][0] if self._fixes else None

    def add(self, capture_us: int, pose_world: Float32, sequence: int) -> int:
        """Add a fix that is newer than the newest."""
        if not (np.abs(pose_world) <= FIELD_M).all():
            return RANGE
        if self._fixes and capture_us <= self._fixes[-1][0]:
            return OLD
        self._fixes = [*self._fixes[1 - LINE_FIXES_MAX :], (capture_us, pose_world.astype(float), sequence)]
        return OK

    def act(self, at_us: int, action: int) -> None:
        """Ignore a stroke."""
        del at_us, action

    def at(self, at_us: int) -> Estimate | None:
        """Return the state at a time; None if no fix is near enough to it."""
        if not self._fixes or not -FUTURE_US <= at_us - self._fixes[-1][0] <= STALE_US:
            return None
        newest_us, newest, _ = self._fixes[-1]
        time_s = np.array([(time_us - newest_us) * 1e-6 for time_us, _, _ in self._fixes])
        poses = np.array([pose - newest for _, pose, _ in self._fixes])
        poses[:, 2] = np.angle(np.exp(1j * poses[:, 2]))
        pose, speed = self._state(newest, time_s, poses, (at_us - newest_us) * 1e-6)
        heading = wrap_angle(pose[2])
        state = [*pose[:2], heading, *body_from_world(heading, np.asarray(speed))]
        use = np.zeros(8, dtype=np.uint16)
        return Estimate(np.array(state, dtype=np.float32), use, self._fixes[-1][2], len(self._fixes))


def last_difference(
    newest: Float64, time_s: Float64, poses: Float64, _lead_s: float
) -> tuple[Float64, Float64]:
    """The paper's estimator: the pose is the newest fix, the velocity the difference of the last two.

    Source: Huang et al. 2022, section on closed-loop control; their logger's xdot, ydot, thetadot.
    """
    return newest, -poses[-2] / -time_s[-2] if len(time_s) > 1 else np.zeros(3)


def line_through(newest: Float64, time_s: Float64, poses: Float64, lead_s: float) -> tuple[Float64, Float64]:
    """A straight line by least squares through the fixes of the last quarter second, to the requested time.

    Args:
        newest: (3,) pose of the newest fix.
        time_s, poses: (n,) times and (n, 3) poses of the fixes relative to the newest, headings wrapped.
        lead_s: from the newest fix to the requested time.
    """
    recent = time_s >= -LINE_WINDOW_S
    time_s, poses = time_s[recent], poses[recent]
    off_s = time_s - time_s.mean()
    spread = (off_s**2).sum()
    speed = (off_s[:, None] * poses).sum(axis=0) / spread if spread > 0.0 else np.zeros(3)
    return newest + poses.mean(axis=0) + speed * (lead_s - time_s.mean()), speed


METHODS: Mapping[str, Callable[[Tables], Estimates]] = {
    "difference": lambda _tables: FromLastFixes(last_difference),
    "line": lambda _tables: FromLastFixes(line_through),
    "track": Estimator,
}
"""The paper's estimator, a line through the last fixes, and the robot's own."""
RATES_HZ = (2.0, 5.0, 10.0, 15.0, 30.0, 60.0)
EACH_RATE_HZ = 15.0
"""Rate at which each fault is tested alone."""
FAULTS: Mapping[str, Mapping[str, float]] = {
    "none": {},
    "late": {"delay_s": 0.3},
    "jitter": {"jitter_s": 0.3},
    "lost": {"lost": 0.2},
    "doubled": {"doubled": 0.2},
    "held": {"held": 0.2},
    "outliers": {"outliers": 0.05},
    "world": {},
    "all": {"jitter_s": 0.2, "lost": 0.2, "doubled": 0.1, "held": 0.1, "outliers": 0.05},
}
"""Faults in addition to those of the recorded runs' camera; "world": the robot differs from the model."""
OTHER_WORLD: tuple[dict[str, object], ...] = (
    {"name": "drag_scale", "frame": 2.5},
    {"name": "limb_wear", "limb": "rear_left", "gain": 0.7},
    {"name": "steady_current", "x_mps": 0.004, "y_mps": -0.003},
)
SETTLE_US = 2_000_000  # fixes before the first decision, enough at each rate
_FIRST = 2  # decisions that are not counted, because the robot has just begun to move
_SECOND_GAP_S = 0.001  # FK_STROKE_GAP_US


@dataclass(frozen=True)
class Condition:
    """Fixes of one kind: their rate and one of FAULTS."""

    rate_hz: float
    fault: str

    def camera(self) -> Camera:
        """Return the camera that gives them."""
        return Camera(rate_hz=self.rate_hz, **FAULTS[self.fault])

    def world(self) -> World:
        """Return the world of the pool."""
        return World(make_effects(OTHER_WORLD, Folder())) if self.fault == "world" else World()


@dataclass(frozen=True)
class Outcome:
    """The result of a method under a condition.

    Attributes:
        position_m, heading_rad, velocity_mps, omega_rad_s: root-mean-square errors at decision time while the
            robot's own estimator steered; the same fixes and decisions for all methods.
        median_position_m: median of the position error, which a few wrong fixes do not affect.
        decisions, unknown: number of decisions, and of those without an estimate.
        distance_m: path -> mean distance to it, m, while this method steered, from the first decision on; NaN
            if there was never an estimate for one.
    """

    position_m: float
    heading_rad: float
    velocity_mps: float
    omega_rad_s: float
    median_position_m: float
    decisions: int
    unknown: int
    distance_m: Mapping[str, float]


@dataclass
class Swim:
    """A run: errors (n, 6) of each method at each decision, NaN without an estimate; and its mean
    distance."""

    errors: dict[str, list[Float64]] = field(default_factory=dict)
    distance_m: float = np.nan


@dataclass(frozen=True)
class _Setting:
    robot: Robot
    tables: Tables
    paths: Sequence[Path]
    config: PlanConfig
    limit_s: float


@dataclass(frozen=True)
class _Task:
    condition: Condition
    steered_by: str
    path: int
    seed: int


def conditions(rates_hz: Sequence[float] = RATES_HZ) -> list[Condition]:
    """Return each rate without faults and with all of them, and each fault alone at one rate."""
    each = EACH_RATE_HZ if EACH_RATE_HZ in rates_hz else rates_hz[0]
    found = [Condition(rate, fault) for fault in ("none", "all") for rate in rates_hz]
    return found + [Condition(each, fault) for fault in FAULTS if fault not in ("none", "all")]


def compare_estimators(
    robot: Robot,
    image: bytes,
    paths: Sequence[Path],
    config: PlanConfig,
    seeds: int,
    limit_s: float,
    rates_hz: Sequence[float] = RATES_HZ,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[Condition, dict[str, Outcome]]:
    """Follow paths in the pool with each method under each condition.

    Args:
        limit_s: time limit of a run in pool time, s.
        rates_hz: fixes per second.
    """
    wanted = conditions(rates_hz)
    runs = [(path, seed) for path in range(len(paths)) for seed in range(seeds)]
    tasks = [_Task(c, method, *run) for c in wanted for method in METHODS for run in runs]
    job = Job(_start, (robot, image, tuple(paths), config, limit_s), _run, _warm)
    swims: dict[_Task, Swim] = {}
    for done, (index, swim) in enumerate(run_chunks(job, tasks, workers), start=1):
        swims[tasks[index]] = swim
        progress(done, len(tasks))
    return {
        condition: {
            method: _outcome(
                [swims[_Task(condition, "track", *run)].errors[method] for run in runs],
                {
                    path.name: [swims[_Task(condition, method, index, seed)] for seed in range(seeds)]
                    for index, path in enumerate(paths)
                },
            )
            for method in METHODS
        }
        for condition in wanted
    }


def _outcome(errors: list[list[Float64]], steered: Mapping[str, list[Swim]]) -> Outcome:
    every = np.concatenate([np.array(rows[_FIRST:]).reshape(-1, 6) for rows in errors])
    known = every[np.isfinite(every[:, 0])]
    position_m = np.hypot(known[:, 0], known[:, 1])

    def rms(values: Float64) -> float:
        return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")

    return Outcome(
        position_m=rms(position_m),
        heading_rad=rms(known[:, 2]),
        velocity_mps=rms(np.hypot(known[:, 3], known[:, 4])),
        omega_rad_s=rms(known[:, 5]),
        median_position_m=float(np.median(position_m)) if len(known) else float("nan"),
        decisions=len(every),
        unknown=len(every) - len(known),
        distance_m={
            name: _mean_of_begun([swim.distance_m for swim in swims]) for name, swims in steered.items()
        },
    )


def _mean_of_begun(distances_m: Sequence[float]) -> float:
    """Return the mean over the runs that began; NaN without any."""
    known = [one for one in distances_m if np.isfinite(one)]
    return float(np.mean(known)) if known else float("nan")


def _start(
    robot: Robot, image: bytes, paths: tuple[Path, ...], config: PlanConfig, limit_s: float
) -> _Setting:
    return _Setting(robot, open_image(image), paths, config, limit_s)


def _warm(setting: _Setting) -> None:
    """Make two decisions, which compiles all that a run calls."""
    short = dataclasses.replace(setting, limit_s=SETTLE_US * 1e-6 + 2.0)
    _run(short, _Task(Condition(10.0, "none"), "track", 0, 0))


def _run(setting: _Setting, task: _Task) -> Swim:
    """Simulate one run: one method steers, and the errors of all methods are recorded."""
    tables, path = setting.tables, setting.paths[task.path]
    camera, world = task.condition.camera(), task.condition.world()
    pool = Pool(setting.robot, start_pose(path), camera, np.random.default_rng(task.seed), world)
    methods = {name: make(tables) for name, make in METHODS.items()}
    twin = DecisionTwin(tables, path, setting.config, methods[task.steered_by])
    swim = Swim({name: [] for name in METHODS})
    at_us = SETTLE_US
    begun_s = np.inf
    while at_us * 1e-6 < setting.limit_s and twin.ended is None:
        for fix in pool.advance(at_us * 1e-6):
            capture_us = round(fix.capture_s * 1e6)
            for name, method in methods.items():
                add = twin.add_fix if name == task.steered_by else method.add
                add(capture_us, fix.pose_world, fix.sequence)
        if twin.ended is not None:
            break
        if twin.is_lost(at_us):
            if np.isfinite(begun_s):
                break
            at_us += tables.period_us  # without an estimate the robot does not start
            continue
        begun_s = min(begun_s, at_us * 1e-6)
        truth = np.concatenate(pool.state())
        for name, method in methods.items():
            swim.errors[name].append(_error(method, at_us, truth))
        action = twin.decide(at_us).action
        for name, method in methods.items():
            if name != task.steered_by:
                method.act(at_us, action)
        if twin.ended is None and action < len(tables.actions):
            _heat(pool, tables, action, at_us * 1e-6)
        at_us += tables.period_us
    time_s = np.array(pool.truth.time_s)
    during = time_s >= begun_s
    if during.any():
        poses = np.array(pool.truth.pose_world).reshape(-1, 3)[during]
        swim.distance_m = along_paths([(-np.inf, path)], time_s[during], poses)[0]
    return swim


def _error(method: Estimates, at_us: int, truth: Float64) -> Float64:
    estimate = method.at(at_us)
    if estimate is None:
        return np.full(6, np.nan)
    error = estimate.state.astype(np.float64) - truth
    error[2] = np.angle(np.exp(1j * error[2]))
    return np.asarray(error)


def _heat(pool: Pool, tables: Tables, action: int, at_s: float) -> None:
    row = tables.actions[action]
    second_s = at_s + tables.second_delay_us * 1e-6 + _SECOND_GAP_S
    for mask, start_s in ((row.first_mask, at_s), (row.second_mask, second_s)):
        for limb in range(tables.limbs):
            if mask >> limb & 1:
                pool.actuate(limb, start_s)
