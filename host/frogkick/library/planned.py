"""The states that a planned run visits: velocities met while the planner itself follows random paths.

A first, small table from randomly steered swims is enough for the planner to choose as it will later; the
rods then swim what it chooses, and where its strokes begin is where a better table should have states.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frogkick.der import STEP_S, WIDTH, Rods, prepare, program_of, simulate_many
from frogkick.der.swimmer import batch_of
from frogkick.errors import ConvergenceError
from frogkick.planner.image import Tables, open_image, pack_nearest
from frogkick.planner.plan import PlanConfig, plan_batch
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]
Float32 = NDArray[np.float32]

_FIRST_TABLE_STATES = 64
_STROKES = 16  # of one planned swim: as long as the paper's shorter runs
_POINTS = 100
_ARCS = 3  # a path is this many arcs of random curvature
_TIGHTEST = 3.0  # of their curvature over the tightest turn of a single stroke
# The cost rewards the part of the path that is done. On paths longer than the paper's it would no longer
# pay to move at all, so the reward grows with the length.
_REWARDED_LENGTH_M = 0.45


@dataclass(frozen=True, eq=False)
class _Path:
    """A path as the planner takes it: (n,) float32 each, world frame."""

    x_m: Float32
    y_m: Float32
    tangent_rad: Float32


def planned_swims(robot: Robot, seed: int, first: FloatArray) -> Iterator[FloatArray]:
    """Velocities at the decisions of planned swims, without end.

    Args:
        robot: who swims, with the planner of its TOML.
        seed: of the paths; each swim has a generator of its own.
        first: (k, 3) velocities to make the first table of; 64 of them are enough.

    Yields:
        (n, 3) body velocities of some swims, one swim after another.

    Raises:
        ConvergenceError: a swim could not be simulated.
    """
    rods = prepare(robot)
    tables = _first_table(robot, rods, first[:_FIRST_TABLE_STATES])
    for number in itertools.count(0, WIDTH):
        lanes = [np.random.default_rng([seed, 1, number + lane]) for lane in range(WIDTH)]
        yield _swim(robot, rods, tables, [_random_path(tables, rng) for rng in lanes])


def _first_table(robot: Robot, rods: Rods, velocities: FloatArray) -> Tables:
    programs = [program_of(robot, action) for action in robot.actions]
    count = len(programs)
    motions = simulate_many(
        rods, np.repeat(velocities, count, axis=0), programs * len(velocities), [robot.period_s]
    )
    for failure in motions.failures.values():
        raise ConvergenceError(f"the first table of {robot.id!r} {failure}")
    return open_image(
        pack_nearest(
            robot_id=robot.id,
            provenance=robot.sha256,
            period_us=round(robot.period_s * 1e6),
            pulse_us=round(robot.pulse_s * 1e6),
            second_delay_us=round(robot.second_delay_s * 1e6),
            limbs=len(robot.limbs),
            action_rows=[(a.name, a.first_mask, a.second_mask) for a in robot.actions],
            velocity_scale=robot.velocity_resolution,
            velocities=velocities,
            displacements=motions.pose_world[:, -1].reshape(-1, count, 3),
            velocities_end=motions.velocity_body[:, -1].reshape(-1, count, 3),
        )
    )


def _path_length_m(tables: Tables) -> float:
    """As far as the longest strokes take the robot in one swim: no swim runs out of path."""
    moved = tables.transitions[:, :, :2] * tables.motion_scale[:2].astype(np.float64)
    return float(_STROKES * np.hypot(moved[..., 0], moved[..., 1]).max())


def _random_path(tables: Tables, rng: np.random.Generator) -> _Path:
    """Arcs from the origin, as long as the swim, as tight as the robot can turn."""
    moved = tables.transitions[:, :, :3] * tables.motion_scale.astype(np.float64)
    stride_m = float(np.hypot(moved[..., 0], moved[..., 1]).max())
    turn_rad = float(np.abs(moved[..., 2]).max())
    length_m = _path_length_m(tables)
    curvature = _TIGHTEST * rng.uniform(-1.0, 1.0, _ARCS) * turn_rad / stride_m
    along = np.linspace(0.0, length_m, _POINTS)
    bend = curvature[np.minimum((along / length_m * _ARCS).astype(int), _ARCS - 1)]
    heading = np.concatenate([[0.0], np.cumsum(bend[:-1] * np.diff(along))])
    steps = np.diff(along)
    x = np.concatenate([[0.0], np.cumsum(np.cos(heading[:-1]) * steps)])
    y = np.concatenate([[0.0], np.cumsum(np.sin(heading[:-1]) * steps)])
    wrapped = np.arctan2(np.sin(heading), np.cos(heading))
    return _Path(*(column.astype(np.float32) for column in (x, y, wrapped)))


def _swim(robot: Robot, rods: Rods, tables: Tables, paths: list[_Path]) -> FloatArray:
    """(lanes x strokes, 3) velocities at the decisions of swims side by side."""
    planner = robot.planner
    config = PlanConfig(
        planner.distance_weight_per_m,
        planner.angle_weight_per_rad,
        planner.progress_weight * _path_length_m(tables) / _REWARDED_LENGTH_M,
        planner.level_weight,
        min(planner.depth, 2),  # deeper costs ten times more and chooses much the same strokes
    )
    still = np.zeros((len(paths), 3))
    batch = batch_of([rods] * len(paths), still, still, 0.0, STEP_S, len(paths))
    met = np.empty((len(paths), _STROKES, 3))
    for stroke in range(_STROKES):
        pose, velocity = batch.pose_world(), batch.velocity_body()
        met[:, stroke] = velocity
        for lane, path in enumerate(paths):
            state = np.concatenate([pose[lane], velocity[lane]])
            state[2] = math.remainder(state[2], 2.0 * math.pi)
            chosen = robot.actions[int(plan_batch(tables, path, config, state[None])[0]["action"])]
            for start, mask in program_of(robot, chosen, stroke * robot.period_s):
                for limb in range(len(robot.limbs)):
                    if mask >> limb & 1:
                        batch.fire(lane, limb, start)
        batch.advance((stroke + 1) * robot.period_s)
    for lane, failure in batch.failures.items():
        raise ConvergenceError(f"a planned swim of {robot.id!r} {failure} (lane {lane})")
    return met.reshape(-1, 3)
