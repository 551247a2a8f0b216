"""The search of the planner's larger depths: a beam search (Lowerre 1976). The twin of search_beam.c.

Level by level all branches that are carried are expanded by every action, and the ``WIDTH`` best of these
are carried on. A branch is as good as what it would cost if it ended there: its cost so far and the terminal
cost. Gliding beyond a wall has the walls' weight only at the last level, and at the levels before it the
weight of the distance from the route. All branches that are compared have the same length. In the C and here,
these rules decide:

- Of equal values the lower first action is the better, then the branch that was found first: parents from the
  best to the worst, of each parent the actions by their numbers.
- A level that could go beyond the limit of transitions is not begun. The first one always is.
- The answer is the best branch of the last level.

The C drops a branch as soon as its cost so far is not good enough. Here all values are computed and then
sorted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from frogkick.core.arrays import AnyArray
from frogkick.core.compiled import ALLOCATING, INNER
from frogkick.planner import costs
from frogkick.planner.branch import Search, ended_cost, is_candidate, motion_cost, step
from frogkick.planner.lookup import DYNAMICS, action_count, dynamics_after, find_row, motion_of

WIDTH = 12
"""Branches that are carried on."""
DEPTH = 3
"""With the route cost, the least depth at which the search is a beam search."""
BEYOND = 4
"""Levels that a beam search looks ahead beyond its depth."""
_HERE, _NEXT = 1, 2  # rows of the search for the branch under way, and for what becomes of it


@njit(**INNER)
def levels_of(settings: Any, depth: int) -> int:
    """Return how many levels a search looks ahead: more than the depth if it is a beam search."""
    if settings.cost == costs.COST_ROUTE and depth >= DEPTH:
        return depth + BEYOND
    return depth


@njit(**ALLOCATING)
def the_best(values: AnyArray, firsts: AnyArray, number: int) -> AnyArray:
    """Return the places of the best values, the best first; ties: the lower first action, the lower place."""
    left = np.ones(len(values), dtype=np.bool_)
    places = np.zeros(min(number, len(values)), dtype=np.int64)
    for rank in range(len(places)):
        best = -1
        for place in range(len(values)):
            if not left[place]:
                continue
            as_good = best >= 0 and values[place] == values[best] and firsts[place] < firsts[best]
            if best < 0 or values[place] < values[best] or as_good:
                best = place
        places[rank] = best
        left[best] = False
    return places


@njit(**ALLOCATING)
def search_beam(search: Search, levels: int, moves: bool) -> Any:
    """Search from row 0 of ``search``; leave the cost there. Return (action, finished levels)."""
    actions, limit = action_count(search.table), search.settings.transitions_max
    poses, dynamics = search.poses[:1].copy(), search.dynamics[:1].copy()
    knot, place, sums = search.knot[:1].copy(), search.place[:1].copy(), search.sums[:1].copy()
    firsts = np.zeros(1, dtype=np.int64)
    reached: Any = np.int64(0)
    for level in range(levels):
        most = len(firsts) * actions
        if level > 0 and limit > 0 and search.best[1] + most > limit:
            break
        next_poses, next_dynamics = np.zeros((most, 3), np.float32), np.zeros((most, DYNAMICS), np.int64)
        next_knot, next_place = np.zeros(most, np.int64), np.zeros(most, np.float32)
        next_sums, next_firsts = np.zeros(most, np.float32), np.zeros(most, np.int64)
        values = np.zeros(most, np.float32)
        found = 0
        for branch in range(len(firsts)):
            search.poses[_HERE], search.dynamics[_HERE] = poses[branch], dynamics[branch]
            search.knot[_HERE], search.place[_HERE] = knot[branch], place[branch]
            search.rows[_HERE] = find_row(search.table, search.dynamics[_HERE])
            for action in range(actions):
                if level == 0 and not is_candidate(search, moves, action):
                    continue
                row, here = search.rows[_HERE], search.dynamics[_HERE]
                motion_of(search.table, row, here, action, search.motion)
                step(search.poses[_HERE], search.motion, search.poses[_NEXT])
                next_sums[found] = sums[branch] + motion_cost(search, _HERE, levels)
                values[found] = ended_cost(search, _NEXT, next_sums[found], level + 1 == levels)
                next_firsts[found] = firsts[branch] if level > 0 else action
                next_poses[found] = search.poses[_NEXT]
                next_knot[found], next_place[found] = search.knot[_NEXT], search.place[_NEXT]
                dynamics_after(search.table, row, here, action, next_dynamics[found])
                found += 1
        search.best[1] += found
        best = the_best(values[:found], next_firsts[:found], WIDTH)
        poses, dynamics, firsts = next_poses[best], next_dynamics[best], next_firsts[best]
        knot, place, sums = next_knot[best], next_place[best], next_sums[best]
        search.best_cost[0] = values[best[0]]
        reached = np.int64(level + 1)
    return firsts[0], reached
