"""Planning on the host with the same bits as on the robot: one decision, or a batch.

Functions raise InputError for arrays whose shapes or values do not fit.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from frogkick.core.arrays import AnyArray, Float32, Float64, Int64, UInt16
from frogkick.core.errors import FrogkickError, InputError
from frogkick.core.weights import COSTS, WEIGHTS, Weights
from frogkick.planner import costs, kernel
from frogkick.planner.kernel import PLAN_ROW
from frogkick.planner.lookup import arrays_of
from frogkick.tables.image import Tables
from frogkick.tables.layout import LIMBS_MAX, STATES_MAX, first_rows, tree_levels_for

PLAN_FIXED_US = 600
TRANSITION_NS = 26000
"""Time of a decision on the chip: a fixed part, and at most so much for each transition (fk_robot.c)."""
PLAN_TIME_WATCHDOG_US = 600_000
"""Limit of the search time in the firmware (fk_robot_state.h)."""
SEARCH_MOST_US = 925_000
"""What any search on the chip ends within, with all other look-ups of its turn (fk_fit.h)."""
_SEARCH_FIXED_US, _TRANSITION_MOST_NS, _NODE_MOST_NS = 2_000, 68_000, 39_500
_LEAF_MOST_NS, _PAIR_MOST_NS = 2_380, 1_380
_LOOK_UPS_BESIDE, _LOOK_UPS_WITHIN_US, _LOOK_UPS_WITHIN_MAX = 25, 500_000, 8
"""What holds on the chip whatever the table: see fk_fit.h."""
_STATES_STEP = 256

STATUS_TEXT = {
    kernel.ERROR_NOT_FINITE: "the state holds NaN or infinity: check the position fixes",
    kernel.ERROR_RANGE: "the state is beyond +-1000 m or rad, the path's ends or a limb use of 32767: "
    "check the position fixes",
    kernel.ERROR_DEPTH: "the depth is not 1 to 4: choose --depth 1 to 4",
    kernel.ERROR_WEIGHT: "a cost weight is not 0 to 1e6 (glide_lead, turn_lead: 2, wall_glide: 100; walls: "
    "+-1000 m): correct the planner section",
    kernel.ERROR_COST: f"the cost is of an unknown kind: choose {' or '.join(COSTS)}",
    kernel.ERROR_PATH_COUNT: "the path does not have 2 to 100 points: resample it",
    kernel.ERROR_PATH_POINT: "a path point is not within +-1000 m, or a tangent not within 1000 rad: correct "
    "it",
}


class PlanError(FrogkickError):
    """No decision is possible; ``status`` is the robot's negative fk_error_t."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class PathLike(Protocol):
    """A path, world frame: three float32 arrays of equal length (``frogkick.paths.Path``)."""

    @property
    def x_m(self) -> Float32: ...
    @property
    def y_m(self) -> Float32: ...
    @property
    def tangent_rad(self) -> Float32: ...


class Cost(enum.IntEnum):
    """Which cost the planner minimises, by its number on the link."""

    PAPER = costs.COST_PAPER  # Huang et al. 2022, Eq. 19
    ROUTE = costs.COST_ROUTE  # frogkick.planner.costs


@dataclass(frozen=True)
class PlanConfig(Weights):
    """Cost, weights and depth; the defaults are the paper's. Weights of the other cost are only checked.

    Attributes:
        depth: of the search, 1 to 4; with the route cost 3 and 4 are a beam search (``beam``).
        cost: a ``Cost``.
        transitions_max: limit of the evaluated transitions; 0: none. The first level is always finished.
    """

    depth: int = 1
    cost: int = Cost.PAPER
    transitions_max: int = 0

    def weights(self) -> Float32:
        """All weights as (w,) float32, in the order of ``WEIGHTS`` and ``fk_plan_config_t``."""
        return _float32([getattr(self, name) for name in WEIGHTS])

    @property
    def area_m(self) -> Float64:
        """(2, 2) least and largest x and y of the robot's centre, world, m; infinite without walls."""
        if not self.wall_weight_per_m:
            return np.array([[-math.inf] * 2, [math.inf] * 2])
        low = (self.wall_x_min_m, self.wall_y_min_m)
        return np.array([low, (self.wall_x_max_m, self.wall_y_max_m)])

    def settings(self) -> Any:
        return kernel.Settings(int(self.cost), int(self.transitions_max), *self.weights())


class PlannerSettings(Protocol):
    """A planner's settings in a robot's file (``frogkick.robot.PlannerDefaults``), beside the weights."""

    @property
    def cost(self) -> str: ...
    @property
    def depth(self) -> int: ...
    @property
    def plan_time_s(self) -> float: ...


def config_of(planner: PlannerSettings) -> PlanConfig:
    """The planner configuration of a robot's file, which the robot has after booting."""
    weights = {name: getattr(planner, name) for name in WEIGHTS}
    return PlanConfig(
        **weights,
        depth=planner.depth,
        cost=Cost[planner.cost.upper()],
        transitions_max=transitions_within(round(planner.plan_time_s * 1e6)),
    )


def transitions_within(plan_us: int) -> int:
    """Transitions that the robot's planner may evaluate in a time; 0 for 0: no limit."""
    if plan_us == 0:
        return 0
    return max(1, max(0, plan_us - PLAN_FIXED_US) * 1000 // TRANSITION_NS)


def pairs_of_rows(states: int, tree_levels: int) -> int:
    """Pairs of rows that a look-up reads where it visits every leaf of the search tree: nearest.c."""
    first = first_rows(states, tree_levels)
    return int(((first[1:] - (first[:-1] & ~1) + 1) // 2).sum())


def look_up_most_ns(states: int, tree_levels: int) -> int:
    """The longest time to open a node on the chip: its look-up visits every leaf and state."""
    return _NODE_MOST_NS + (_LEAF_MOST_NS << tree_levels) + _PAIR_MOST_NS * pairs_of_rows(states, tree_levels)


def look_ups_beside(period_us: int) -> int:
    """Look-ups in a turn of the robot's loop beside those that a search's transitions pay for (fk_fit.h)."""
    return _LOOK_UPS_BESIDE + min(1 + _LOOK_UPS_WITHIN_US // period_us, _LOOK_UPS_WITHIN_MAX)


def transitions_in(states: int, tree_levels: int, actions: int, period_us: int) -> int:
    """Transitions after which any search in such a table ends on the robot before its watchdog resets it.

    The twin of fk_fit_transitions(). Below the number of actions the robot refuses the table.
    """
    look_up_ns = look_up_most_ns(states, tree_levels)
    taken_us = _SEARCH_FIXED_US + look_up_ns * look_ups_beside(period_us) // 1000
    return max(0, SEARCH_MOST_US - taken_us) * 1000 // (_TRANSITION_MOST_NS + look_up_ns // actions)


def transitions_of(tables: Tables) -> int:
    """The same of a table."""
    return transitions_in(len(tables.states), tables.tree_levels, len(tables.actions), tables.period_us)


def states_most(actions: int, period_us: int) -> int:
    """States of the largest table that a packer makes and a robot takes."""
    fits = [
        transitions_in(states, tree_levels_for(states), actions, period_us) >= actions
        for states in range(_STATES_STEP, STATES_MAX + 1, _STATES_STEP)
    ]
    return _STATES_STEP * (fits.index(False) if False in fits else len(fits))


def on_robot(config: PlanConfig, tables: Tables) -> PlanConfig:
    """The configuration with the limit of transitions that a robot with this table decides by."""
    most = max(1, min(transitions_within(PLAN_TIME_WATCHDOG_US), transitions_of(tables)))
    return replace(config, transitions_max=min(config.transitions_max or most, most))


@dataclass(frozen=True)
class BestBranch:
    """The best branch of a search: its first action, and what the search found on the way."""

    action: int  # index into the table's actions
    nearest_state: int  # row of the table nearest to the state's velocity
    path_index: int  # path point nearest to the state (paper), last one that it has reached (route)
    depth_reached: int  # finished levels
    transitions: int  # that were evaluated
    cost: np.float32  # sum over the best branch
    distance_m: np.float32  # of the state from that point (paper), or from the path (route)
    along_points: np.float32  # place of the state along the path, in points; the next search starts there
    predicted: Float32  # (6,) state after the first action: pose world, velocity body
    predicted_limb_use: UInt16  # (8,) recent use of each limb after the first action


def plan(
    tables: Tables,
    path: PathLike,
    config: PlanConfig,
    state: npt.ArrayLike,
    limb_use: npt.ArrayLike | None = None,
    along_points: float = 0.0,
) -> BestBranch:
    """Choose the next action.

    Args:
        tables: an opened table image.
        path: 2 to 100 points, world frame.
        config: weights and depth.
        state: (6,) x m, y m, heading rad (world), vx m/s, vy m/s, omega rad/s (body); used as float32.
        limb_use: (8,) recent use of each limb, 0 (rested) to 32767; None: all rested.
        along_points: last place of the robot along the path, in points; 0 at the start.

    Raises:
        PlanError: the state, path or configuration allows no decision.

    Source: Huang et al. 2022, Algorithm 1 and Eq. 19; the nearest state is that in velocity codes.
    """
    query = _float32(state).reshape(-1)
    row = plan_batch(tables, path, config, query[np.newaxis, :], None, limb_use, along_points)[0]
    status = int(row["status"])
    if status != kernel.OK:
        raise PlanError(
            status, f"no plan from state {query.tolist()} (status {status}): {STATUS_TEXT[status]}"
        )
    numbers = ("action", "nearest_state", "path_index", "depth_reached", "transitions")
    values: dict[str, Any] = {name: int(row[name]) for name in numbers}
    values |= {name: row[name] for name in ("cost", "distance_m", "along_points")}
    used = row["predicted_limb_use"].astype(np.uint16)
    return BestBranch(**values, predicted=row["predicted"].copy(), predicted_limb_use=used)


def plan_batch(
    tables: Tables,
    path: PathLike,
    config: PlanConfig,
    states: npt.ArrayLike,
    depths: npt.ArrayLike | None = None,
    limb_use: npt.ArrayLike | None = None,
    along_points: npt.ArrayLike = 0.0,
) -> AnyArray:
    """Plan from many states.

    Args:
        tables, path, config: as for ``plan``.
        states: (k, 6) states.
        depths: (k,) depth of each; None: ``config.depth``.
        limb_use: (k, 8), or (8,) for all: recent use of each limb, 0 to 32767; None: rested.
        along_points: (k,) or one for all: last place along the path, in points.

    Returns:
        (k,) ``PLAN_ROW``; a state without a decision has a status.

    Raises:
        InputError: the arrays' shapes do not fit each other.
    """
    queries = query_rows(config, states, depths, limb_use, along_points)
    rows = np.zeros(len(queries[0]), dtype=PLAN_ROW)
    kernel.plan_many(arrays_of(tables), path_rows(path), config.settings(), *queries, rows)
    return rows


def query_rows(
    config: PlanConfig,
    states: npt.ArrayLike,
    depths: npt.ArrayLike | None,
    limb_use: npt.ArrayLike | None,
    along_points: npt.ArrayLike,
) -> tuple[Int64, Float32, UInt16, Float32]:
    """The arguments of ``plan_batch`` as a kernel takes them: depths, states, limb uses, places.

    Raises:
        InputError: an array has another shape, or a limb use is not a whole number of 0 to 65535.
    """
    queries = _float32(states)
    if queries.ndim != 2 or queries.shape[1] != 6:
        raise InputError(f"states have shape {queries.shape}, needed is (k, 6): pass one row for each state")
    count = len(queries)
    many = np.full(count, config.depth) if depths is None else np.asarray(depths)
    if many.shape != (count,):
        raise InputError(f"depths have shape {many.shape}, needed is ({count},): pass one for each state")
    given = np.zeros(LIMBS_MAX) if limb_use is None else np.asarray(limb_use)
    if given.shape not in ((LIMBS_MAX,), (count, LIMBS_MAX)):
        raise InputError(
            f"limb use has shape {given.shape}, needed is ({count}, {LIMBS_MAX}): one row a state"
        )
    given = np.ascontiguousarray(np.broadcast_to(given, (count, LIMBS_MAX)))
    used = given.astype(np.uint16)
    if not np.array_equal(used, given):
        raise InputError("limb use holds a value that is not a whole number of 0 to 65535: correct it")
    along = _float32(along_points)
    if along.shape not in ((), (1,), (count,)):
        raise InputError(f"along_points has shape {along.shape}, needed is ({count},): one for each state")
    # A copy: numba would compile again for a read-only array.
    return many.astype(np.int64), queries, used, np.array(np.broadcast_to(along.reshape(-1), (count,)))


def path_rows(path: PathLike) -> Float32:
    """A path as a (3, n) float32 array: x m, y m, tangent rad.

    Raises:
        InputError: x, y and tangent differ in length.
    """
    columns = [_float32(column).reshape(-1) for column in (path.x_m, path.y_m, path.tangent_rad)]
    if len({len(column) for column in columns}) != 1:
        lengths = [len(column) for column in columns]
        raise InputError(f"path has {lengths} x, y and tangent values: give one of each for every point")
    return np.ascontiguousarray(np.stack(columns))


def _float32(values: npt.ArrayLike) -> Float32:
    try:
        with np.errstate(over="ignore"):  # a value beyond float32 becomes infinite, which has a status
            return np.ascontiguousarray(values, dtype=np.float32)
    except (TypeError, ValueError):
        raise InputError(
            f"{str(values)[:60]!r} is not an array of numbers: give a state as x, y, heading and velocities"
        ) from None
