"""The offline bound of a path: the whole run planned at once by a table, without noise or delay.

A planner that looks a few strokes ahead and gets its position from a camera cannot be expected to do better.
So the bound separates what the path demands from what the planner loses. The method is a beam search: breadth
first over decisions; of the plans that have reached one part of the path the cheapest are kept, and of
similar plans only the cheapest. A plan that is found is feasible according to the table. It is not proven
that none is better, but a larger breadth shows whether there is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64, Int64
from frogkick.core.compiled import cached_njit, stamp_of
from frogkick.core.errors import InputError
from frogkick.core.poses import world_from_body
from frogkick.core.progress import shown
from frogkick.front.places import start_pose, swim_path
from frogkick.front.tables import table_image
from frogkick.paths import Path
from frogkick.planner.lookup import DYNAMICS, TableArrays, arrays_of, dynamics_after, find_row, motion_of
from frogkick.report import style
from frogkick.runs.summary import along_paths
from frogkick.tables.image import Tables, read_image
from frogkick_studies import StudyResult
from frogkick_studies.configs import Foresight

DECISIONS_MOST = 150
_LONGER = 2.0  # slower plans than this many times the decisions of the fastest one are not searched
SAMPLES = 4  # samples of each motion, on the straight line between its ends
_FINE_M = 0.002  # spacing of the points along the path
_BEHIND, _AHEAD = 10, 30  # points that a sample may lie behind or ahead of the previous sample
_CELL = (0.003, 0.003, 0.06)  # size of a cell of similar poses: m, m, rad
_OMEGA_RAD_S = 0.2  # and turn rates
_PART = 8  # points of the path that share a breadth


@dataclass(frozen=True, eq=False)
class OfflinePlan:
    """A plan of a whole run.

    Attributes:
        actions: indices into the table's actions.
        mean_distance_m, progress_mps: as for a run in the pool.
        poses_world: (SAMPLES * decisions + 1, 3) x_m, y_m, heading_rad at equal intervals.
    """

    actions: tuple[int, ...]
    mean_distance_m: float
    progress_mps: float
    poses_world: Float64


@dataclass(frozen=True, eq=False)
class _Plans:
    """Plans, (k, ...); ``parent`` is the index in the previous level, ``action`` the last action."""

    pose: Float64
    dynamics: Int64
    place: Int64
    cost_m: Float64  # sum of the decisions' mean distances
    parent: Int64
    action: Int64


def plan_offline(
    tables: Tables,
    path: Path,
    start_world: tuple[float, float, float],
    breadth: int = 300,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[OfflinePlan]:
    """Plan the whole run along a path, from rest, for each number of decisions.

    Args:
        start_world: x_m, y_m, heading_rad of the robot.
        breadth: number of plans that are kept for each part of the path and number of decisions.

    Returns:
        The fastest plan, and each slower one that stays closer to the path than all faster ones.
    """
    places_m, table = _places(path), arrays_of(tables)
    none = np.zeros(1, dtype=np.int64)
    pose, dynamics = np.array([start_world], dtype=np.float64), np.zeros((1, DYNAMICS), dtype=np.int64)
    levels = [_Plans(pose, dynamics, none, np.zeros(1), none, none)]
    found: list[OfflinePlan] = []
    most = DECISIONS_MOST
    while len(levels[-1].cost_m) and len(levels) <= most:
        plans = _expanded(table, levels[-1], places_m)
        is_there = plans.place >= len(places_m) - 2
        at = int(np.where(is_there, plans.cost_m, np.inf).argmin())
        if is_there[at]:
            plan = _offline_plan(tables, path, start_world, _traced(levels, plans, at))
            most = most if found else min(most, int(_LONGER * len(levels)))
            if not found or plan.mean_distance_m < found[-1].mean_distance_m:
                found.append(plan)
        progress(len(levels), most)
        levels.append(_taken(plans, _kept(plans, np.flatnonzero(~is_there), breadth, tables)))
    if not found:
        raise InputError(
            f"no plan comes to the end of path {path.name!r} within {DECISIONS_MOST} decisions: "
            "give a shorter path, or start nearer to it"
        )
    return found


def nearest_at(found: Sequence[OfflinePlan], progress_mps: float) -> float | None:
    """Return the smallest mean distance (m) of the plans with at least this progress; None without any."""
    near = [plan.mean_distance_m for plan in found if plan.progress_mps >= progress_mps]
    return min(near) if near else None


def _offline_plan(
    tables: Tables, path: Path, start_world: tuple[float, float, float], actions: tuple[int, ...]
) -> OfflinePlan:
    poses = swim(tables, actions, start_world)
    times_s = np.arange(len(poses)) * (tables.period_us * 1e-6 / SAMPLES)
    mean_m, _, progress_mps = along_paths([(-np.inf, path)], times_s, poses)
    return OfflinePlan(actions, mean_m, progress_mps, poses)


def swim(tables: Tables, actions: Sequence[int], start_world: tuple[float, float, float]) -> Float64:
    """Return (SAMPLES * actions + 1, 3) poses, world frame, by the table, from rest, linear between
    decisions."""
    table = arrays_of(tables)
    pose, dynamics = np.array(start_world, dtype=np.float64), np.zeros(DYNAMICS, dtype=np.int64)
    motion, after = np.zeros(3, dtype=np.float32), np.zeros(DYNAMICS, dtype=np.int64)
    poses = [pose]
    for action in actions:
        row = find_row(table, dynamics)
        motion_of(table, row, dynamics, action, motion)
        dynamics_after(table, row, dynamics, action, after)
        step = world_from_body(pose[2], motion.astype(np.float64))
        poses += [pose + step * (sample / SAMPLES) for sample in range(1, SAMPLES + 1)]
        pose, dynamics = pose + step, after.copy()
    return np.array(poses)


def _places(path: Path) -> Float64:
    """Return (k, 2) points of the path's polyline at equal steps, m."""
    arc_m = path.along_m
    at_m = np.linspace(0.0, arc_m[-1], max(2, round(float(arc_m[-1]) / _FINE_M) + 1))
    return np.stack([np.interp(at_m, arc_m, path.points_m[:, axis]) for axis in (0, 1)], axis=1)


def _expanded(table: TableArrays, plans: _Plans, places_m: Float64) -> _Plans:
    actions = table.transitions.shape[1]
    count = len(plans.cost_m) * actions
    pose, place = np.empty((count, 3)), np.empty(count, dtype=np.int64)
    dynamics, distance_m = np.empty((count, DYNAMICS), dtype=np.int64), np.empty(count)
    _expand(table, plans.pose, plans.dynamics, plans.place, places_m, pose, dynamics, place, distance_m)
    parent = np.repeat(np.arange(len(plans.cost_m)), actions)
    cost_m = plans.cost_m[parent] + distance_m
    return _Plans(pose, dynamics, place, cost_m, parent, np.tile(np.arange(actions), len(plans.cost_m)))


def _kept(plans: _Plans, under_way: Int64, breadth: int, tables: Tables) -> Int64:
    """Return the cheapest plan of each cell of similar ones, and of these the cheapest of each part of the
    path."""
    order = under_way[np.argsort(plans.cost_m[under_way], kind="stable")]
    turning = plans.dynamics[order, 2] * float(tables.velocity_scale[2]) / _OMEGA_RAD_S
    cells = np.column_stack([np.round(plans.pose[order] / _CELL), np.round(turning), plans.place[order]])
    order = order[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
    parts = plans.place[order] // _PART
    return np.concatenate([order[:0], *(order[parts == part][:breadth] for part in np.unique(parts))])


def _taken(plans: _Plans, which: Int64) -> _Plans:
    return _Plans(*(getattr(plans, name)[which] for name in _Plans.__dataclass_fields__))


def _traced(levels: Sequence[_Plans], plans: _Plans, at: int) -> tuple[int, ...]:
    """Return the actions that lead to a plan, from the previous levels."""
    actions = [int(plans.action[at])]
    at = int(plans.parent[at])
    for level in reversed(levels[1:]):
        actions.append(int(level.action[at]))
        at = int(level.parent[at])
    return tuple(reversed(actions))


def _compiled(stamp: int) -> Any:
    @cached_njit()
    def expand(table, poses, states, at, places_m, pose, dynamics, place, distance_m):  # type: ignore[no-untyped-def]
        motion = np.zeros(3, dtype=np.float32)
        actions = table.transitions.shape[1]
        for i in range(len(poses)):
            row = find_row(table, states[i])
            cosine, sine = np.cos(poses[i, 2]), np.sin(poses[i, 2])
            for action in range(actions):
                k = i * actions + action
                motion_of(table, row, states[i], action, motion)
                dynamics_after(table, row, states[i], action, dynamics[k])
                dx_m = cosine * motion[0] - sine * motion[1]
                dy_m = sine * motion[0] + cosine * motion[1]
                now, total_m = at[i], 0.0
                for sample in range(1, SAMPLES + 1):
                    x_m = poses[i, 0] + dx_m * sample / SAMPLES
                    y_m = poses[i, 1] + dy_m * sample / SAMPLES
                    least, found = np.inf, now
                    for j in range(max(0, now - _BEHIND), min(len(places_m), now + _AHEAD)):
                        square = (places_m[j, 0] - x_m) ** 2 + (places_m[j, 1] - y_m) ** 2
                        if square < least:
                            least, found = square, j
                    now = found
                    total_m += np.sqrt(least)
                pose[k, 0], pose[k, 1] = poses[i, 0] + dx_m, poses[i, 1] + dy_m
                pose[k, 2] = poses[i, 2] + motion[2]
                place[k], distance_m[k] = now, total_m / SAMPLES
        return stamp

    return expand


_expand = _compiled(stamp_of("frogkick.planner"))


@dataclass(frozen=True, eq=False)
class ForesightStudy(StudyResult):
    """The offline bound of a path: smallest distance, and progress.

    Attributes:
        plans: the best plans, from fast to close.
        at_least_mps: requested progress; None: none.
    """

    path: Path
    name: str
    tables: Tables
    plans: Sequence[OfflinePlan]
    at_least_mps: float | None = None

    def plot(self) -> Figure:
        """Draw the tracks of the fastest and the nearest plan, and distance against progress of all."""
        with style.new_figure(10.0, 4.2) as figure:
            way, trade = figure.subplots(1, 2, width_ratios=(3, 2))
            way.plot(*(1e3 * self.path.points_m.T), color=style.DESIRED, lw=2.5, label="path")
            for plan, colour, name in (
                (self.plans[0], style.ALARM, "fastest"),
                (self.plans[-1], style.PREDICTED, "nearest"),
            ):
                label = f"{name}: {1e3 * plan.mean_distance_m:.1f} mm off, {1e3 * plan.progress_mps:.1f} mm/s"
                way.plot(*(1e3 * plan.poses_world[:, :2].T), ".-", ms=3, color=colour, label=label)
            way.set_aspect("equal", adjustable="datalim")
            way.set_xlabel("x (mm), pool")
            way.set_ylabel("y (mm), pool")
            way.set_title("Tracks of two plans, by the table")
            way.legend(loc="best")
            trade.plot(
                [1e3 * plan.progress_mps for plan in self.plans],
                [1e3 * plan.mean_distance_m for plan in self.plans],
                "o-",
                color=style.PREDICTED,
            )
            trade.set_ylim(bottom=0.0)
            trade.set_xlabel("progress along the path (mm/s)")
            trade.set_ylabel("mean distance to the path (mm)")
            trade.set_title("No plan found is below the line")
        return figure

    def as_json(self) -> dict[str, Any]:
        rows = [
            {
                "decisions": len(plan.actions),
                "mean_distance_m": plan.mean_distance_m,
                "progress_mps": plan.progress_mps,
                "actions": [self.tables.actions[action].name for action in plan.actions],
            }
            for plan in self.plans
        ]
        values: dict[str, Any] = {"path": self.name, "plans": rows}
        if self.at_least_mps is not None:
            nearest_m = nearest_at(self.plans, self.at_least_mps)
            values |= {"at_least_mps": self.at_least_mps, "nearest_m": nearest_m}
        return values

    def text(self, values: dict[str, Any]) -> str:
        lines = [
            f"{row['decisions']:3d} decisions: {1e3 * row['mean_distance_m']:6.2f} mm, "
            f"{1e3 * row['progress_mps']:5.1f} mm/s, {' '.join(row['actions'])}"
            for row in values["plans"]
        ]
        if "nearest_m" in values:
            nearest_m, speed = values["nearest_m"], 1e3 * values["at_least_mps"]
            nearest = f"{1e3 * nearest_m:.2f} mm" if nearest_m is not None else "no plan is so fast"
            lines.append(f"at {speed:.1f} mm/s or more: {nearest}")
        return "\n".join(lines)


def run(config: Foresight) -> ForesightStudy:
    least = config.at_least
    if least is not None and not (math.isfinite(least) and least >= 0.0):
        raise InputError(f"--at-least {least} m/s: give a speed from 0 on")
    path = swim_path(config.path)
    tables = read_image(table_image(config.tables, None))
    with shown(True, "decisions ahead") as tell:
        plans = plan_offline(tables, path, start_pose(path), config.breadth, tell)
    return ForesightStudy(path, config.path, tables, plans, least)
