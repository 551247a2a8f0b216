"""Weights of the planner, tuned in the table's own model on random paths and judged on others.

The robot moves as its table says, plus a little noise, so a run takes milliseconds. The search is
differential evolution (Storn & Price 1997) of the weights' logarithms. Scored are the runs of a healthy
robot and of one with a worn limb that knows it. A run that begins astray may not end farther from its path
than with the weights before.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.progress import shown
from frogkick.core.weights import WEIGHTS
from frogkick.front.places import plan_config, start_pose
from frogkick.front.tables import robot_of_table, table_image
from frogkick.paths import Path, from_waypoints, shape
from frogkick.planner.plan import Cost, PlanConfig
from frogkick.tables.image import Tables, read_image
from frogkick.tables.layout import LIMBS_MAX, LOST_MAX
from frogkick_codegen.native import NativeLibrary
from frogkick_studies import Found
from frogkick_studies.configs import Weights

TUNED = (
    "distance_weight_per_m", "angle_weight_per_rad", "look_ahead_m", "soft_distance_m", "turn_lead",
    "course_weight_per_m", "glide_weight_per_m", "glide_lead",
)  # fmt: skip
"""The weight of progress stays: it is the unit of the others."""
LENGTH_STROKES = 15.0
BENDS_RAD = (0.18, 0.3, 0.48, 0.72)
"""Largest turn of a random path in one longest stroke."""
CLOSED_STROKES = ((2.7, 1.7), (2.0, 2.0), (3.3, 2.2), (2.3, 1.5))
"""Half axes of the closed paths that are tuned on, in longest strokes."""
JUDGED = ("ellipse", "bends", "eight", "circle")
"""Shapes that nothing is tuned on. The sine is left out, as its ends bend more than the robot can turn."""
ASTRAY = ((1.5, 0.0), (0.0, 1.57), (0.0, -2.2), (-1.5, -1.0), (0.0, 3.1), (1.0, 2.5))
"""Where runs begin that have to find their path: longest strokes to its left, and rad by which they point
further to the left than it does."""
STRAIGHT_STROKES = 8.0
"""Length of the line along which they have to find it, in longest strokes."""
LAST = 3
"""How many of their decisions tell whether they have: those before the end."""
DECISIONS_MOST = 80
NOISE = 0.01
"""Of each decision: of the longest stroke (position), in radians, and twice as much of its mean speed."""
_LOST_PROGRESS = 10.0  # what one part of progress weighs against one part of distance
_UNFINISHED = 5.0
_SHARE = 0.5  # what the score of worn limbs counts beside that of the healthy robot
_FOUND = 0.1  # longest strokes from its path: a run from astray has found it
_WORN = 0.7  # share of its contribution that a worn limb has lost
POPULATION = 2 * len(TUNED)
_SPREAD, _FARTHEST = 0.4, 1.6  # of the weights' logarithms: in the first population, and at most


@dataclass(frozen=True)
class Swum:
    """Runs along one path: mean distance at decisions m, progress m/s, share that came to the end."""

    distance_m: float
    progress_mps: float
    completed: float


def random_path(rng: np.random.Generator, stroke_m: float, bend_rad: float) -> Path:
    """Return a smooth path of random curvature, from the origin along x.

    Args:
        stroke_m: the table's longest stroke.
        bend_rad: largest turn in such a stroke.
    """
    along = np.linspace(0.0, LENGTH_STROKES, 400)
    waves = np.arange(0.0, LENGTH_STROKES / 5.0, 0.5)
    size, phase = rng.normal(size=len(waves)), rng.uniform(0.0, math.tau, len(waves))
    curvature = (size * np.sin(math.tau * along[:, None] * waves / LENGTH_STROKES + phase)).sum(axis=1)
    curvature *= bend_rad * rng.uniform(0.4, 1.0) / np.abs(curvature).max()
    step = along[1] - along[0]
    heading = np.cumsum(curvature) * step
    heading -= heading[0]
    points = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) * (step * stroke_m)
    return from_waypoints((points - points[0])[::8])


def training_paths(rng: np.random.Generator, stroke_m: float, count: int) -> dict[str, Path]:
    """Return random paths, a line, and closed ones to both sides."""
    paths = {
        f"random {k}": random_path(rng, stroke_m, BENDS_RAD[k % len(BENDS_RAD)]) for k in range(count)
    } | {"line": shape("line")}
    for k, (long, wide) in enumerate(CLOSED_STROKES):
        angle = np.linspace(0.0, math.tau, 40) * (1 if k % 2 else -1) + k
        points = stroke_m * np.stack([long * np.cos(angle), wide * np.sin(angle)], axis=1)
        paths[f"closed {k}"] = from_waypoints(points)
    return paths


def swim(
    planner: NativeLibrary,
    tables: Tables,
    path: Path,
    config: PlanConfig,
    runs: int,
    seed: int,
    astray: tuple[float, float] = (0.0, 0.0),
    last: int = DECISIONS_MOST,
) -> Swum:
    """Swim a path several times, moved by the table and a little noise.

    Args:
        planner: in C, which answers with the twin's bits, and sooner.
        astray: where they begin, as in ``ASTRAY``.
        last: only so many of each run's last decisions count for its distance.
    """
    rng, period_s = np.random.default_rng(seed), tables.period_us * 1e-6
    stroke_m, points = float(tables.stroke_max_m), len(path.x_m)
    speed = 2.0 * NOISE * stroke_m / period_s
    noise = np.array([NOISE * stroke_m, NOISE * stroke_m, NOISE, speed, speed, NOISE])
    state = np.zeros((runs, 6))
    x_m, y_m, heading_rad = start_pose(path)
    left_m = astray[0] * stroke_m
    state[:, 0] = x_m - math.sin(heading_rad) * left_m
    state[:, 1] = y_m + math.cos(heading_rad) * left_m
    state[:, 2] = heading_rad + astray[1]
    use, along, lost = np.zeros((runs, LIMBS_MAX)), np.zeros(runs), np.zeros(LIMBS_MAX, dtype=np.int64)
    lost[: len(tables.lost)] = tables.lost
    decisions, live = np.full(runs, DECISIONS_MOST), np.arange(runs)
    distances = np.full((DECISIONS_MOST, runs), np.nan)
    for decision in range(DECISIONS_MOST):
        rows = planner.plan_batch(
            tables.image, path, config, state[live], limb_use=use[live], along_points=along[live], lost=lost
        )
        along[live] = rows["along_points"]
        there = along[live] >= points - 1.001
        decisions[live[there]] = decision
        drawn = noise * rng.normal(size=(runs, 6))
        distances[decision, live[~there]] = rows["distance_m"][~there]
        state[live] = rows["predicted"] + drawn[live]
        use[live] = rows["predicted_limb_use"]
        live = live[~there]
        if not len(live):
            break
    arc_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.points_m, axis=0).T))])
    way_m = np.interp(along, np.arange(points), arc_m)
    counts = np.arange(DECISIONS_MOST)[:, None] >= decisions - last
    return Swum(
        float(np.nanmean(distances[counts])),
        float(np.mean(way_m / (period_s * np.maximum(decisions, 1)))),
        float(np.mean(decisions < DECISIONS_MOST)),
    )


def score(swum: Sequence[Swum], before: Sequence[Swum]) -> float:
    """Return how much worse runs are than those before: 0 where alike, below 0 where they are nearer.

    Distances count by their ratio, half by that of their mean and half path by path. Lost progress on the
    paths that were swum to their end before, and runs that no longer come to the end, count more than any
    distance gains; gained progress counts nothing.
    """
    distance, progress, completed = (
        np.array([[getattr(run, name) for run in runs] for runs in (swum, before)])
        for name in ("distance_m", "progress_mps", "completed")
    )
    near = np.maximum(distance, 1e-6)
    mean_m = near.mean(axis=1)
    ratio = 0.5 * (np.log(mean_m[0] / mean_m[1]) + np.log(near[0] / near[1]).mean())
    lost = np.zeros(1)
    if (whole := completed[1] == 1.0).any():
        lost = -np.log(np.maximum(progress[0, whole], 1e-6) / np.maximum(progress[1, whole], 1e-6))
    unfinished = np.maximum(0.0, completed[1] - completed[0]).mean()
    return float(ratio + _LOST_PROGRESS * max(0.0, lost.mean()) + _UNFINISHED * unfinished)


def strayed(swum: Sequence[Swum], before: Sequence[Swum], near_m: float) -> float:
    """Return how much farther the worst run from astray ends than before: 0 where it is near, or none does.

    Args:
        near_m: a distance at which a run has found its path.
    """
    far, then = (np.array([max(run.distance_m, near_m) for run in runs]) for runs in (swum, before))
    unfinished = max(0.0, max(b.completed - a.completed for a, b in zip(swum, before, strict=True)))
    return float(max(0.0, np.log(far / then).max()) + _UNFINISHED * unfinished)


def tune(
    judge: Callable[[PlanConfig], float],
    config: PlanConfig,
    trials: int,
    rng: np.random.Generator,
    tell: Callable[[int, int], None] = lambda _done, _all: None,
) -> PlanConfig:
    """Return the configuration that scores best in a number of trials; the given one is the first.

    Args:
        judge: what a configuration scores, the less the better.
        trials: in whole populations of ``POPULATION``, at least one.
    """
    scored: list[tuple[float, PlanConfig]] = []
    generations = max(1, trials // POPULATION)

    def tried(logarithms: Float64) -> float:
        weights: dict[str, Any] = {
            name: min(WEIGHTS[name].most, math.exp(at)) for name, at in zip(TUNED, logarithms, strict=True)
        }
        candidate = config if not scored else dataclasses.replace(config, **weights)
        scored.append((judge(candidate), candidate))
        tell(len(scored), generations * POPULATION)
        return scored[-1][0]

    from scipy.optimize import differential_evolution

    first = np.log([max(getattr(config, name), 1e-6) for name in TUNED])
    population = first + _SPREAD * rng.normal(size=(POPULATION, len(TUNED)))
    population[0] = first
    bounds = [(at - _FARTHEST, at + _FARTHEST) for at in first]
    differential_evolution(
        tried, bounds, init=population, maxiter=generations - 1, mutation=(0.4, 0.9), recombination=0.8,
        tol=0.0, polish=False, rng=rng,
    )  # fmt: skip
    return min(scored, key=lambda row: row[0])[1]


@dataclass(frozen=True)
class WeightsTuned(Found):
    """Weights, and runs along paths that they were not tuned on.

    Attributes:
        weights: the tuned ones.
        before, after: path -> runs with the robot's weights, and with these.
    """

    weights: dict[str, float]
    before: dict[str, Swum]
    after: dict[str, Swum]

    def as_json(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    def text(self, values: dict[str, Any]) -> str:
        lines = ["Paths that nothing was tuned on, by the table: distance, progress before and after."]
        for path, before in values["before"].items():
            after = values["after"][path]
            lines.append(
                f"{path:10s} {1e3 * before['distance_m']:6.2f} mm {1e3 * before['progress_mps']:5.1f} mm/s   "
                f"{1e3 * after['distance_m']:6.2f} mm {1e3 * after['progress_mps']:5.1f} mm/s"
            )
        lines.append("For the section [planner] of the robot's file:")
        return "\n".join(lines + [f"{name} = {value:.3g}" for name, value in values["weights"].items()])


def run(config: Weights) -> WeightsTuned:
    image = table_image(config.tables, config.model)
    robot = robot_of_table(image, config.model)
    tables, planner = read_image(image), plan_config(robot, "robot", config.depth)
    if planner.cost != Cost.ROUTE:
        raise InputError(
            f"the planner of {robot.id} has the cost 'paper', which has its own weights: choose 'route'"
        )
    library = NativeLibrary()
    rng, stroke_m = np.random.default_rng(config.seed), float(tables.stroke_max_m)
    training = training_paths(rng, stroke_m, config.paths)
    others = {name: shape(name) for name in JUDGED} | {
        f"random {k}": random_path(rng, stroke_m, bend) for k, bend in enumerate(2 * BENDS_RAD)
    }

    curved = {name: path for name, path in training.items() if not name.startswith("random")}
    worn = [
        tables.worn(np.where(np.arange(tables.limbs) == limb, round(_WORN * LOST_MAX), 0))
        for limb in range(tables.limbs if tables.limb_wear.size else 0)
    ]

    def runs(paths: dict[str, Path], weights: PlanConfig, of: Tables = tables) -> dict[str, Swum]:
        return {
            name: swim(library, of, path, weights, config.runs, config.seed) for name, path in paths.items()
        }

    straight = from_waypoints(np.array([[0.0, 0.0], [STRAIGHT_STROKES * stroke_m, 0.0]]), smooth=False)

    def trial(weights: PlanConfig) -> tuple[list[Swum], list[Swum], list[Swum]]:
        """Runs of the healthy robot, of one after the other limb worn, as it has learned, and from astray."""
        return (
            list(runs(training, weights).values()),
            [swum for limb in worn for swum in runs(curved, weights, limb).values()],
            [
                swim(library, tables, straight, weights, 2 * config.runs, config.seed, astray, LAST)
                for astray in ASTRAY
            ],
        )

    before = trial(planner)
    start = planner
    if planner.glide_weight_per_m == 0.0:
        start = dataclasses.replace(
            start, glide_weight_per_m=0.3 * planner.distance_weight_per_m, glide_lead=0.8
        )
    if planner.course_weight_per_m == 0.0:
        start = dataclasses.replace(start, course_weight_per_m=2.0 / stroke_m)

    def judge(weights: PlanConfig) -> float:
        healthy, limbs, astray = trial(weights)
        whole = score(healthy, before[0]) + strayed(astray, before[2], _FOUND * stroke_m)
        return whole + _SHARE * score(limbs, before[1]) if limbs else whole

    with shown(True, "weights tried") as tell:
        found = tune(judge, start, config.trials, np.random.default_rng(config.seed), tell)
    weights: dict[str, Any] = {name: float(f"{getattr(found, name):.3g}") for name in TUNED}
    found = dataclasses.replace(found, **weights)
    return WeightsTuned(weights, runs(others, planner), runs(others, found))
