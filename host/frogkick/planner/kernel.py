"""The onboard planner's twin, bit for bit (numba): its decision, and its depth-limited branch and bound.

It is receding-horizon control: each decision searches sequences of actions on the table's model and takes the
first action of the cheapest one (Huang et al. 2022, Algorithm 1). The bound is the cost so far (Land & Doig
1960); where the transitions are limited, the depth grows level by level (iterative deepening, Korf 1985).
With the route cost the larger depths are searched by ``beam``.

It is written from the format and the rules, not from the C: neighbours are found by brute force instead of a
tree, and the search counts through sequences of actions. The two share the order of float32 operations, the
order in which branches are expanded and pruned, and these rules:

- Only + - * / sqrt in float32, each rounded once. numba would turn ``int * float32`` into float64, so every
  integer is made a float32 first and every constant is one. There is no fastmath, so nothing is fused.
- Integers where a comparison decides. Ties take the lowest action of the first level.
- Level 1 is searched first, then the full depth, or level after level where the limit might cut that. There
  the best first action so far comes first, then the others by their cost at level 1 (ties: the lowest);
  further actions of a branch follow the same order, those that may not be first at its end.
- Costs are not negative, so a branch whose cost has reached the best one cannot beat it and is pruned.
  Rounding keeps this exact: adding what is not negative never lowers a float32 sum.
- A search with a limit of transitions ends before the one that would exceed it. The first level is always
  finished. An unfinished level counts if its first action is finished: what was found there is a branch of
  that depth, no worse than the one before it.

numba keeps only ``plan_many`` on disk, which encloses a stamp of this folder's text: it would not notice that
a helper changed in another file.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from numba import njit

from frogkick.core.arrays import AnyArray
from frogkick.core.compiled import ALLOCATING, BARE, INNER, cached_njit, stamp_of
from frogkick.core.weights import COSTS, WEIGHTS
from frogkick.planner import costs
from frogkick.planner.beam import levels_of, search_beam
from frogkick.planner.branch import PER_STEP, Search, ended_cost, is_candidate, motion_cost, step
from frogkick.planner.floats import wrap_angle
from frogkick.planner.lookup import (
    DYNAMICS,
    TableArrays,
    action_count,
    dynamics_after,
    find_row,
    motion_of,
    velocity_code,
)
from frogkick.tables.layout import LIMBS_MAX

OK = 0
ERROR_NOT_FINITE = -2
ERROR_RANGE = -3
ERROR_DEPTH = -4
ERROR_WEIGHT = -5
ERROR_PATH_COUNT = -6
ERROR_PATH_POINT = -7
ERROR_COST = -11

_COSTS = len(COSTS)
DEPTH_MAX = 4
PATH_POINTS_MAX = 100
POSITION_MAX_M = np.float32(1000)
HEADING_MAX_RAD = np.float32(1000)
LIMB_USE_MAX = 32767

PLAN_ROW = np.dtype(
    [
        ("status", "<i4"),
        ("action", "<i4"),
        ("nearest_state", "<i4"),
        ("path_index", "<i4"),
        ("depth_reached", "<i4"),
        ("transitions", "<i4"),
        ("cost", "<f4"),
        ("distance_m", "<f4"),
        ("along_points", "<f4"),
        ("predicted", "<f4", (6,)),
        ("predicted_limb_use", "<i4", (LIMBS_MAX,)),
    ]
)
"""One decision: status (0 or a negative fk_error_t), then fk_plan_t; all zero where the status is not 0."""

_F0 = np.float32(0)
_F1 = np.float32(1)

_typed_by_name: Any = namedtuple
Settings = _typed_by_name("Settings", ("cost", "transitions_max", *WEIGHTS))
"""The configuration of a search, integers and float32; the fields are those of plan.PlanConfig."""
_WEIGHTS_FROM = 2
_LEAST = tuple(np.float32(weight.least) for weight in WEIGHTS.values())
_MOST = tuple(np.float32(weight.most) for weight in WEIGHTS.values())


@njit(**BARE)
def check_settings(settings: Any, depth: int) -> int:
    """Return OK or the code of the first thing that is wrong, in the C's order."""
    if not 1 <= depth <= DEPTH_MAX:
        return ERROR_DEPTH
    if not 0 <= settings.cost < _COSTS:
        return ERROR_COST
    weights = settings[_WEIGHTS_FROM:]
    for index in range(len(weights)):
        value = weights[index]
        # -0.0 is none: in C its bits are beyond the largest one's.
        is_minus_0 = value == _F0 and np.signbit(value) and _LEAST[index] == _F0
        if is_minus_0 or not _LEAST[index] <= value <= _MOST[index]:
            return ERROR_WEIGHT
    return OK


@njit(**INNER)
def check(path: AnyArray, settings: Any, depth: int, state: AnyArray, limb_use: AnyArray, along: Any) -> int:
    """Return OK or the code of the first thing that is wrong, in the C's order."""
    status: int = check_settings(settings, depth)
    if status != OK:
        return status
    if not 2 <= path.shape[1] <= PATH_POINTS_MAX:
        return ERROR_PATH_COUNT
    for point in range(path.shape[1]):
        if not (abs(path[0, point]) <= POSITION_MAX_M and abs(path[1, point]) <= POSITION_MAX_M):
            return ERROR_PATH_POINT
        if not abs(path[2, point]) <= HEADING_MAX_RAD:
            return ERROR_PATH_POINT
    for value in state:
        if not np.isfinite(value):
            return ERROR_NOT_FINITE
    if not np.isfinite(along):
        return ERROR_NOT_FINITE
    if abs(state[0]) > POSITION_MAX_M or abs(state[1]) > POSITION_MAX_M or abs(state[2]) > HEADING_MAX_RAD:
        return ERROR_RANGE
    for use in limb_use:
        if use > LIMB_USE_MAX:
            return ERROR_RANGE
    if not _F0 <= along <= np.float32(path.shape[1] - 1):
        return ERROR_RANGE
    return OK


@njit(**INNER)
def is_pruned(search: Search, first: int, cost: Any) -> bool:
    """Whether a branch with this first action and at least this cost can no longer be the best."""
    if cost == search.best_cost[0]:
        return bool(first >= search.best[0])
    return bool(cost > search.best_cost[0])


@njit(**INNER)
def expand(search: Search, level: int, depth: int, first: int, action: int) -> bool:
    """Expand a node by one action; True where that gives a node at the next level, which is not pruned."""
    search.best[1] += 1
    motion_of(search.table, search.rows[level], search.dynamics[level], action, search.motion)
    step(search.poses[level], search.motion, search.poses[level + 1])
    cost = search.sums[level] + motion_cost(search, level, depth)
    if is_pruned(search, first, cost):
        return False
    if level + 1 < depth:
        search.sums[level + 1] = cost
        after = search.dynamics[level + 1]
        dynamics_after(search.table, search.rows[level], search.dynamics[level], action, after)
        search.rows[level + 1] = find_row(search.table, after)
        return True
    cost = ended_cost(search, depth, cost, True)
    if not is_pruned(search, first, cost):
        search.best_cost[0] = cost
        search.best[0] = first
    return False


@njit(**ALLOCATING)
def search_branch(search: Search, depth: int, first: int, order: AnyArray) -> bool:
    """Search the sequences of ``depth`` actions that begin with one; True where the limit stops it.

    ``order`` (actions,) is that of the further actions.
    """
    limit = search.settings.transitions_max
    sequence = np.zeros(DEPTH_MAX, dtype=np.int64)  # places in the order; the first one is given
    level: Any = np.int64(0)
    while True:
        if depth > 1 and limit > 0 and search.best[1] >= limit:
            return True
        if expand(search, level, depth, first, order[sequence[level]] if level > 0 else first):
            level += 1
            sequence[level] = 0
            continue
        while level > 0:
            sequence[level] += 1
            if sequence[level] < action_count(search.table):
                break
            level -= 1
        if level == 0:
            return False


@njit(**ALLOCATING)
def root_order(root_cost: AnyArray, best: int) -> AnyArray:
    """Return the order in which deeper levels try actions: ``best``, then by cost at level 1."""
    keys = root_cost.copy()
    keys[best] = -_F1
    order = np.zeros(len(keys), dtype=np.int64)
    for action in range(len(keys)):
        place = action
        while place > 0 and keys[order[place - 1]] > keys[action]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = action
    return order


@njit(**INNER)
def second_level(limit: int, depth: int, actions: int) -> int:
    """Return the level that is searched after the first: the last one where ``limit`` cannot cut that."""
    most = actions
    for level in range(depth):
        most += actions ** (level + 1)
    return max(2, depth) if limit == 0 or limit >= most else 2


@njit(**ALLOCATING)
def search_levels(search: Search, depth: int, moves: bool) -> Any:
    """Search level after level; leave cost and first action in ``search``. Return (action, depth reached)."""
    actions = action_count(search.table)
    root_cost = np.full(actions, np.inf, dtype=np.float32)
    order = np.zeros(0, dtype=np.int64)
    candidates = 0
    best_action: Any = np.int64(0)  # a plain 0 is a type of its own: all below would be compiled for it too
    best_cost = np.float32(np.inf)
    for action in range(actions):
        if not is_candidate(search, moves, action):
            continue
        candidates += 1
        search.best[0] = actions
        search.best_cost[0] = np.float32(np.inf)
        search_branch(search, np.int64(1), action, order)
        root_cost[action] = search.best_cost[0]
        if root_cost[action] < best_cost:
            best_cost = root_cost[action]
            best_action = action
    reached = 1
    for levels in range(second_level(search.settings.transitions_max, depth, actions), depth + 1):
        search.best[0] = actions
        search.best_cost[0] = np.float32(np.inf)
        stopped = False
        finished = 0
        order = root_order(root_cost, best_action)
        for action in order[:candidates]:
            stopped = search_branch(search, levels, action, order)
            if stopped:
                break
            finished += 1
        if finished > 0:
            best_action = search.best[0]
            best_cost = search.best_cost[0]
        if stopped:
            break
        reached = levels
    search.best_cost[0] = best_cost
    return best_action, reached


@njit(**ALLOCATING)
def plan_one(
    table: TableArrays,
    path: AnyArray,
    settings: Any,
    depth: int,
    state: AnyArray,
    limb_use: AnyArray,
    along: Any,
    row: Any,
) -> None:
    """Plan from one state (6,) float32 whose limbs were used (LIMBS_MAX,) uint16, ``along`` the path.

    Writes a ``PLAN_ROW`` that is all zero.
    """
    row.status = check(path, settings, depth, state, limb_use, along)
    if row.status != OK:
        return
    stroke_max = costs.stroke_scale(table.stroke_max_m[0])
    spacing = stroke_max * PER_STEP
    is_route = settings.cost == costs.COST_ROUTE
    levels = levels_of(settings, depth)
    knots = np.zeros(
        (costs.knot_count(levels, settings.look_ahead_m, spacing) if is_route else 1, 4), np.float32
    )
    held = False
    if is_route:
        segment, part, distance2, held = costs.project(path, stroke_max, along, state[0], state[1])
        row.path_index = segment + int(part)
        row.distance_m = np.sqrt(distance2)
        row.along_points = np.float32(segment) + part
        costs.lay_out(path, segment, part, spacing, knots)
    else:
        row.path_index, distance2 = costs.nearest_point(path[0], path[1], state[0], state[1])
        row.distance_m = np.sqrt(distance2)
        row.along_points = np.float32(row.path_index)
    search = Search(
        table,
        path,
        settings,
        knots,
        spacing,
        held,
        np.zeros((DEPTH_MAX + 1, 3), dtype=np.float32),
        np.zeros((DEPTH_MAX + 1, DYNAMICS), dtype=np.int64),
        np.zeros(DEPTH_MAX + 1, dtype=np.int64),
        np.full(DEPTH_MAX + 1, costs.BEHIND, dtype=np.int64),
        np.zeros(DEPTH_MAX + 1, dtype=np.float32),
        np.zeros(DEPTH_MAX + 1, dtype=np.float32),
        np.zeros(2, dtype=np.int64),
        np.zeros(1, dtype=np.float32),
        np.zeros(3, dtype=np.float32),
    )
    search.poses[0, 0] = state[0]
    search.poses[0, 1] = state[1]
    search.poses[0, 2] = wrap_angle(state[2])
    search.place[0] = np.float32(costs.BEHIND) * spacing
    for axis in range(3):
        search.dynamics[0, axis] = velocity_code(state[3 + axis], _F1 / table.velocity_scale[axis])
    for limb in range(len(limb_use)):
        search.dynamics[0, 3 + limb] = limb_use[limb]
    search.rows[0] = find_row(table, search.dynamics[0])
    moves = costs.may_rest(settings, state, spacing, table.period_s[0])
    if levels > depth:
        action, row.depth_reached = search_beam(search, levels, moves)
    else:
        action, row.depth_reached = search_levels(search, depth, moves)
    row.action = action
    row.nearest_state = search.rows[0]
    row.transitions = search.best[1]
    row.cost = search.best_cost[0]
    motion_of(table, search.rows[0], search.dynamics[0], action, search.motion)
    step(search.poses[0], search.motion, search.poses[1])
    dynamics_after(table, search.rows[0], search.dynamics[0], action, search.dynamics[1])
    for axis in range(3):
        row.predicted[axis] = search.poses[1, axis]
        row.predicted[3 + axis] = np.float32(search.dynamics[1, axis]) * table.velocity_scale[axis]
    for limb in range(len(limb_use)):
        row.predicted_limb_use[limb] = search.dynamics[1, 3 + limb]


def _compiled(stamp: int) -> Any:
    @cached_njit()
    def plan_many(table, path, settings, depths, states, limb_use, along, rows):  # type: ignore[no-untyped-def]
        for k in range(len(states)):
            plan_one(table, path, settings, depths[k], states[k], limb_use[k], along[k], rows[k])
        return stamp

    return plan_many


plan_many = _compiled(stamp_of("frogkick.planner", repr(WEIGHTS)))
"""Plan from each row of ``states`` (k, 6) float32 with its own depth (k,), limb use (k, 8) uint16 and place
along the path (k,) float32 into ``rows`` (k,) ``PLAN_ROW``, all zero; see ``plan_one`` for the rest."""
