"""How long a decision takes the chip: a bound that holds for every state, path, setting and wear.

The bound is made of three things, each in one place:

- ``search_of``: how many transitions a search evaluates and how many nodes it opens, by its depth, cost,
  actions and limit. To open a node is to look its velocity up.
- ``_loops``: how often each loop of the planner's C runs. A loop that is not there is an error, so code that
  is new cannot be forgotten.
- ``longest`` finds the longest path through the machine code of ``fk_plan`` within these counts.
"""

from __future__ import annotations

import bisect
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Final, NamedTuple

from frogkick.core.errors import InputError
from frogkick.planner import beam
from frogkick.planner.plan import (
    PLAN_TIME_WATCHDOG_US,
    SEARCH_MOST_US,
    Cost,
    look_ups_beside,
    pairs_of_rows,
    transitions_in,
    transitions_within,
)
from frogkick.pool.chip.bus import CYCLES_PER_US, ChipError
from frogkick.pool.chip.flow import FlowGraphs, Line
from frogkick.pool.chip.longest import Times, longest
from frogkick.tables.image import Tables
from frogkick.tables.layout import tree_levels_for

DEPTHS: Final = (1, 2, 3, 4)
_POINTS: Final = 100
_KNOTS, _AHEAD = 80, 12
"""Of a path, and of a route: FK_PATH_POINTS_MAX, FK_ROUTE_KNOTS_MAX, FK_ROUTE_AHEAD."""

_ALIGNED: Final = (
    "cost.c", "math.c", "nearest.c", "path.c", "plan.c", "route.c", "search_beam.c", "tree.c",
)  # fmt: skip
"""Files that read words only where they are aligned: of a table image the tree's splits and states, whose
sections begin on 4 bytes, as two rows of states do. Floats are read from RAM: path, route, state, scales."""

_BEAM_ONLY: Final = ("fk_beam_search",)
_TREE_ONLY: Final = ("fk_tree_search",)
_ROUTE_ONLY: Final = ("fk_route_project", "fk_route_lay_out", "fk_route.h")
_PAPER_ONLY: Final = ("fk_cost", "fk_path_nearest")


class Search(NamedTuple):
    """Counts of a search: transitions that are evaluated, nodes that are opened beside the root."""

    transitions: int
    opened: int


def search_of(actions: int, depth: int, cost: Cost, limit: int = 0) -> Search:
    """The most that a search can count.

    Args:
        actions: of the table.
        depth: 1 to 4.
        cost: decides with the depth which search it is.
        limit: ``transitions_max``; 0: none.
    """
    if cost == Cost.ROUTE and depth >= beam.DEPTH:
        transitions, opened, parents = actions, 0, min(actions, beam.WIDTH)
        for _ in range(1, depth + beam.BEYOND):  # a level that could pass the limit is not begun
            if limit and transitions + parents * actions > limit:
                break
            transitions += parents * actions
            opened += parents
            parents = min(parents * actions, beam.WIDTH)
        return Search(transitions, opened)
    if depth == 1:
        return Search(actions, 0)
    # The first level, and then the whole tree; or level after level until the limit.
    whole = actions + sum(actions**level for level in range(1, depth + 1))
    if not limit or limit >= whole:
        return Search(whole, sum(actions**level for level in range(1, depth)))
    transitions = max(actions, limit)
    # Of each node that is opened all actions are evaluated, but where the limit ends it of one node a level.
    return Search(transitions, transitions // actions + depth - 1)


class Shape(NamedTuple):
    """What of a table decides on the time."""

    actions: int
    states: int
    tree_levels: int


def shape_of(tables: Tables) -> Shape:
    return Shape(len(tables.actions), len(tables.states), tables.tree_levels)


def _loops(shape: Shape, search: Search) -> Mapping[tuple[str, str], Times]:
    """(file, line that the loop's jump back belongs to) -> how often the loop's body runs."""
    actions, leaves, levels = shape.actions, 1 << shape.tree_levels, max(DEPTHS)
    files: Mapping[str, Mapping[str, Times]] = {
        "lookup.c": {"for (value = 0U; value < 3U; value++) {": Times(3)},
        # The search tree of the states: each leaf and each node above them is visited once at the most.
        "nearest.c": {
            "while (waiting > 0U) {": Times(leaves),
            "while (node < leaves) {": Times(leaves - 1, per_call=True),
            "for (; row < end; row += 2U) {": Times(
                pairs_of_rows(shape.states, shape.tree_levels), per_call=True
            ),
        },
        "path.c": {
            "for (index = 0U; index < path->count; index++) {": Times(_POINTS),
            "for (index = 0U; index < count; index++) {": Times(_POINTS, mark="vcmp"),
        },
        # The path's segments, and knots that are laid out along them.
        "route.c": {
            "for (segment = home; (segment > 0U) && (behind_m < stroke_max_m); segment--) {": Times(
                _POINTS - 2
            ),
            "for (segment = home; (segment < last) && (ahead_m < ahead_limit_m); segment++) {": Times(
                _POINTS - 2
            ),
            "while ((along_m < 0.0f) && (index > 0U)) {": Times(_POINTS - 2),
            "while ((along_m > here.length_m) && (index < last)) {": Times(_POINTS - 2, per_call=True),
            "for (; knot <= end; knot++) {": Times(_KNOTS),
        },
        # Every third of the knots from one behind to _AHEAD ahead.
        "fk_route.h": {
            "for (candidate = first + 3; candidate <= last; candidate += 3) {": Times((_AHEAD + 1) // 3)
        },
        "plan.c": {"for (action = 0U; action < problem->tables->actions; action++) {": Times(actions)},
        "search_beam.c": {
            "for (level = 0U; level < levels; level++) {": Times(levels + beam.BEYOND),
            "for (parent = 0U; parent < parents; parent++) {": Times(search.opened + 1, per_call=True),
            # On the first level it passes over the actions that are no candidates.
            "for (action = 0U; action < actions; action++) {": Times(
                search.transitions + actions, per_call=True
            ),
            "for (place = beam->count - 1U; place > 0U; place--) {": Times(beam.WIDTH - 1),
        },
        "tree.c": {
            # The loop without a condition jumps back from two. Each turn but a search's last evaluates one.
            "if ((limit != 0U) && (search->transitions >= limit)) {": Times(
                search.transitions + levels, per_call=True
            ),
            "if (index == firsts) {": Times(actions),
            "while ((level > 0U) && (search->nodes[level - 1U].next_action == actions)) {": Times(levels - 1),
            "for (index = 0U; index < levels; index++) {": Times(levels),
            "for (index = 0U; index < actions; index++) {": Times(actions),
            "for (count = 0U; count < search->tables->actions; count++) {": Times(actions),
            # Sorting by insertion, once for each search of the tree.
            "while ((place > 0U) && (order[place - 1U] != best_action)": Times(
                levels * actions * (actions - 1) // 2, per_call=True
            ),
            "for (level = 0U; level < config->depth; level++) {": Times(levels),
            "for (levels = fk_second_level(config, actions); (levels <= config->depth) && (is_cut == 0); "
            "levels++) {": Times(levels - 1),
        },
    }
    return {(file, text): times for file, loops in files.items() for text, times in loops.items()}


class PlanBound:
    """Bounds of an image's planner."""

    def __init__(self, elf: Path, sources: Path) -> None:
        """``sources``: the folder with the C files that it was built from."""
        self.elf, self.sources = elf, sources
        self._graphs = FlowGraphs(elf, _ALIGNED)
        self._text = {file.name: file.read_text().splitlines() for file in sources.glob("*.[ch]")}

    def plan_us(self, shape: Shape, depth: int, cost: Cost, limit: int = 0) -> float:
        """The longest time of ``fk_plan``."""
        search = search_of(shape.actions, depth, cost, limit)
        is_beam = cost == Cost.ROUTE and depth >= beam.DEPTH
        never = (
            *(_TREE_ONLY if is_beam else _BEAM_ONLY),
            *(_PAPER_ONLY if cost == Cost.ROUTE else _ROUTE_ONLY),
        )
        # The root is looked up as well, and its best action once more for what is predicted.
        calls = {"fk_lookup": search.opened + 1, "fk_lookup_motion": search.transitions + 1}
        return self._us("fk_plan", shape, search, calls, never)

    def look_up_us(self, shape: Shape) -> float:
        """The longest time of a look-up: it visits every leaf and every state of the search tree."""
        return self._us("fk_lookup", shape, Search(0, 0), {}, ())

    def turn_us(self, shape: Shape, period_us: int) -> tuple[float, int]:
        """The longest time of a search with all other look-ups of a turn of the robot's loop, and its depth.

        It holds for whatever cost, depth and limit a command asks for.
        """
        limit = transitions_in(shape.states, shape.tree_levels, shape.actions, period_us)
        limit = max(1, min(transitions_within(PLAN_TIME_WATCHDOG_US), limit))
        # The plan's own bound has the root and the nodes that are not finished.
        beside_us = (look_ups_beside(period_us) - max(DEPTHS)) * self.look_up_us(shape)
        longest_us, depth = max(
            (self.plan_us(shape, each, cost, limit), -each) for cost in Cost for each in DEPTHS
        )
        return beside_us + longest_us, -depth

    def require_in_time(self, tables: Tables, most_us: float = SEARCH_MOST_US) -> float:
        """Return the time of ``turn_us``; raise InputError where it is longer than the watchdog allows."""
        shape, period_us = shape_of(tables), tables.period_us
        taken_us, depth = self.turn_us(shape, period_us)
        if taken_us <= most_us:
            return taken_us

        def us_of(bits: int) -> float:
            return self.turn_us(Shape(shape.actions, 1 << bits, tree_levels_for(1 << bits)), period_us)[0]

        fits = bisect.bisect_right(range(16), most_us, key=us_of)
        advice = f"build one of at most {1 << fits - 1} states" if fits else "build one of fewer actions"
        raise InputError(
            f"a decision of depth {depth} in this table of {shape.states} states and {shape.actions} actions "
            f"may take the chip {1e-3 * taken_us:.0f} ms, its watchdog allows {1e-3 * most_us:.0f}: {advice}"
        )

    def _us(
        self, function: str, shape: Shape, search: Search, calls: Mapping[str, int], never: Collection[str]
    ) -> float:
        loops = _loops(shape, search)

        def bound(line: Line) -> Times:
            lines = self._text.get(line.file, [])
            text = lines[line.number - 1].strip() if 0 < line.number <= len(lines) else ""
            if (line.file, text) not in loops:
                raise ChipError(f"a loop has no bound: {line.file}:{line.number}: {text}")
            return loops[line.file, text]

        return longest(self._graphs, function, bound, calls, never).cycles / CYCLES_PER_US
