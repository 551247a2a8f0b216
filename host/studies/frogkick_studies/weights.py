"""Weights of the planner, tuned in the table's own model on random paths and judged on others.

The simulated robot moves as its table says, plus a little noise, so a run takes milliseconds. The search is
differential evolution (Storn & Price 1997) of the weights' logarithms. The score counts runs of a healthy
robot and of one with a worn limb whose wear is known to the planner. A run that begins off its path may not
end farther from it than with the weights before.
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
from frogkick_studies import StudyResult
from frogkick_studies.configs import Weights

TUNED = (
    "distance_weight_per_m", "angle_weight_per_rad", "look_ahead_m", "soft_distance_m", "turn_lead",
    "course_weight_per_m", "glide_weight_per_m", "glide_lead",
)  # fmt: skip
"""The weight of progress stays: it is the unit of the others."""
LENGTH_STROKES = 15.0
"""Length of a random path, in longest strokes of the table."""
BENDS_RAD = (0.18, 0.3, 0.48, 0.72)
"""Largest turn of a random path in one longest stroke."""
CLOSED_STROKES = ((2.7, 1.7), (2.0, 2.0), (3.3, 2.2), (2.3, 1.5))
"""Half axes of the closed paths that are tuned on, in longest strokes."""
JUDGED = ("ellipse", "bends", "eight", "circle")
"""Shapes that are not used for tuning.

The sine is left out, as its ends bend more than the robot can turn.
"""
OFFSETS = ((1.5, 0.0), (0.0, 1.57), (0.0, -2.2), (-1.5, -1.0), (0.0, 3.1), (1.0, 2.5))
"""Initial poses off the path: longest strokes to its left, and rad from its direction to the left."""
STRAIGHT_STROKES = 8.0
"""Length of the line for the runs that begin off their path, in longest strokes."""
LAST = 3
"""Number of last decisions whose distance shows whether these runs have reached their path."""
DECISIONS_MOST = 80
NOISE = 0.01
"""Noise of each decision: of position in longest strokes, of heading in rad; for the speed twice as much."""
_LOST_PROGRESS = 10.0  # weight of a relative loss of progress against a relative change of distance
_UNFINISHED = 5.0  # the same of a share of runs that are no longer completed
_SHARE = 0.5  # weight of the worn limbs' score relative to the healthy robot's
_REACHED = 0.1  # a run that began off its path has reached it within this many longest strokes
_WORN = 0.7  # share of its contribution that a worn limb has lost
POPULATION = 2 * len(TUNED)
_SPREAD, _FARTHEST = 0.4, 1.6  # of the weights' logarithms: in the first population, and at most


@dataclass(frozen=True)
class PathRuns:
    """Runs along one path: mean distance at decisions (m), progress (m/s), share that was completed."""

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
    offset: tuple[float, float] = (0.0, 0.0),
    last: int = DECISIONS_MOST,
) -> PathRuns:
    """Simulate runs along a path, moved by the table and a little noise.

    Args:
        planner: the planner in C, which chooses bit for bit as the one in Python and is faster.
        offset: initial pose, as in ``OFFSETS``.
        last: number of each run's last decisions whose distance counts.
    """
    rng, period_s = np.random.default_rng(seed), tables.period_us * 1e-6
    stroke_m, points = float(tables.stroke_max_m), len(path.x_m)
    speed = 2.0 * NOISE * stroke_m / period_s
    noise = np.array([NOISE * stroke_m, NOISE * stroke_m, NOISE, speed, speed, NOISE])
    state = np.zeros((runs, 6))
    x_m, y_m, heading_rad = start_pose(path)
    left_m = offset[0] * stroke_m
    state[:, 0] = x_m - math.sin(heading_rad) * left_m
    state[:, 1] = y_m + math.cos(heading_rad) * left_m
    state[:, 2] = heading_rad + offset[1]
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
    way_m = np.interp(along, np.arange(points), path.along_m)
    counts = np.arange(DECISIONS_MOST)[:, None] >= decisions - last
    return PathRuns(
        float(np.nanmean(distances[counts])),
        float(np.mean(way_m / (period_s * np.maximum(decisions, 1)))),
        float(np.mean(decisions < DECISIONS_MOST)),
    )


def score(tested: Sequence[PathRuns], before: Sequence[PathRuns]) -> float:
    """Return how much worse runs are than those before: 0 if equal, negative if closer to their paths.

    Distances count by their ratio, half by that of their mean and half path by path. A loss of progress on
    paths that were completed before, and runs that are no longer completed, count more than any smaller
    distance. A gain of progress does not count.
    """
    distance, progress, completed = (
        np.array([[getattr(run, name) for run in runs] for runs in (tested, before)])
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


def off_path_loss(tested: Sequence[PathRuns], before: Sequence[PathRuns], near_m: float) -> float:
    """Return how much worse runs that began off their path end than those before; 0 if none is worse.

    It is the largest logarithm of the ratio of final distances; runs that are no longer completed add to it.

    Args:
        near_m: distance at which a run has reached its path.
    """
    far, then = (np.array([max(run.distance_m, near_m) for run in runs]) for runs in (tested, before))
    unfinished = max(0.0, max(b.completed - a.completed for a, b in zip(tested, before, strict=True)))
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
        judge: returns the score of a configuration; a lower one is better.
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
class WeightsTuned(StudyResult):
    """Weights, and runs along paths that they were not tuned on.

    Attributes:
        weights: the tuned ones.
        before, after: path -> runs with the robot's weights, and with these.
    """

    weights: dict[str, float]
    before: dict[str, PathRuns]
    after: dict[str, PathRuns]

    def as_json(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    def text(self, values: dict[str, Any]) -> str:
        lines = [
            "Paths that were not tuned on, in the table's model: distance and progress, before and after."
        ]
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

    def runs(paths: dict[str, Path], weights: PlanConfig, of: Tables = tables) -> dict[str, PathRuns]:
        return {
            name: swim(library, of, path, weights, config.runs, config.seed) for name, path in paths.items()
        }

    straight = from_waypoints(np.array([[0.0, 0.0], [STRAIGHT_STROKES * stroke_m, 0.0]]), smooth=False)

    def trial(weights: PlanConfig) -> tuple[list[PathRuns], list[PathRuns], list[PathRuns]]:
        """Runs of the healthy robot, with each limb worn and its wear known, and from poses off the path."""
        return (
            list(runs(training, weights).values()),
            [run for limb in worn for run in runs(curved, weights, limb).values()],
            [
                swim(library, tables, straight, weights, 2 * config.runs, config.seed, offset, LAST)
                for offset in OFFSETS
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
        healthy, limbs, off_path = trial(weights)
        whole = score(healthy, before[0]) + off_path_loss(off_path, before[2], _REACHED * stroke_m)
        return whole + _SHARE * score(limbs, before[1]) if limbs else whole

    with shown(True, "weights tried") as tell:
        found = tune(judge, start, config.trials, np.random.default_rng(config.seed), tell)
    weights: dict[str, Any] = {name: float(f"{getattr(found, name):.3g}") for name in TUNED}
    found = dataclasses.replace(found, **weights)
    return WeightsTuned(weights, runs(others, planner), runs(others, found))
