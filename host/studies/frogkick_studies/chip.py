"""Time that the chip takes to plan: cycles of the flashed image over many states and paths.

Up to ``RUN`` states of a depth, all are run on the virtual chip. Of more states only that number is run: half
of them are random, and the others are the most expensive ones by a model. By the model the cycles of a
decision are, over the blocks of the planner's code, the executions of a block times its cost; the content of
the instruction cache adds a little. The executions are counted for each state by the same C on this computer.
The costs of the blocks are fitted to states that the virtual chip has run, and the fit's error is measured on
other such states. Every reported time was counted on the virtual chip: the model selects states, and bounds
those that were not run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.arrays import Float32, Float64, Int64
from frogkick.core.chunks import Job, run_chunks
from frogkick.core.progress import shown
from frogkick.front.places import built_firmware, plan_config
from frogkick.front.tables import robot_of_table, table_image
from frogkick.paths import SHAPES, shape
from frogkick.paths import Path as SwimPath
from frogkick.planner.plan import PathLike, PlanConfig
from frogkick.pool.chip.cost import LEAST_COST, CostModel
from frogkick.runs.chip_check import CYCLES_PER_MS, ChipPlanner, TimedStates, states_for_timing
from frogkick.tables.image import Tables, read_image
from frogkick_codegen.firmware import require_tools
from frogkick_codegen.native import BlockCounter
from frogkick_studies import StudyResult
from frogkick_studies.configs import Chip

LIMIT_MS: Mapping[int, float] = {1: 0.45, 2: 4.5, 3: 20.0}
"""Longest time of a decision at each depth."""
DEPTHS = (1, 2, 3, 4)
NODE = "fk_lookup_motion"
"""Each of its calls is one node of the search: a predicted pose with its cost."""
RUN: Mapping[int, int] = {1: 3000, 2: 1200, 3: 480, 4: 24}
"""Depth -> largest number of states that are run on the virtual chip."""
HALF_WORN = (16384,)
"""The share of its contribution that each limb has lost, of 32767: decisions with worn limbs take longest."""
_CHUNK = 50
_RIDGE = 1e-3
"""Ridge of the model's fit, relative to a block's largest share: many blocks always run together."""
_BATCH = 2000


@dataclass(frozen=True)
class Share:
    """A function's share of one depth's time: name, percent of the cycles, calls in a decision."""

    function: str
    percent: float
    calls: float


@dataclass(frozen=True)
class DepthSpeed:
    """Times of decisions at one depth.

    Attributes:
        states: number of states, of which ``run`` are run on the virtual chip.
        mean_ms, worst_ms: at 64 MHz; the mean is over random states. With the most cycles that the manuals
            allow for an instruction (``CostModel``), so the worst is the upper end of its band.
        least_ms: the worst decision with the fewest cycles that they allow: the lower end of that band.
        worst_ms_by_reach: the worst by how many times the table's box the velocities come from.
        model_error: if not all were run, the model's largest relative error over those that were and that it
            was not fitted to; else 0.
        unrun_ms: upper bound of the other states by the model and that error; else 0.
        worst_path, worst_state, worst_limb_use, worst_along_points: the worst decision.
        nodes: mean number of nodes of the search.
        instructions_per_node: mean.
        shares: functions, the most expensive first.
    """

    states: int
    run: int
    mean_ms: float
    worst_ms: float
    least_ms: float
    worst_ms_by_reach: Mapping[float, float]
    model_error: float
    unrun_ms: float
    worst_path: str
    worst_state: tuple[float, ...]
    worst_limb_use: tuple[int, ...]
    worst_along_points: float
    nodes: float
    instructions_per_node: float
    shares: tuple[Share, ...]


@dataclass(frozen=True, eq=False)
class _Chunk:
    elf: Path
    config: PlanConfig
    path_name: str
    path: SwimPath
    depth: int
    timed: TimedStates
    at_random: bool


@dataclass(frozen=True, eq=False)
class _Counted:
    chunk: _Chunk
    cycles: Int64
    functions: tuple[tuple[str, int, int, float], ...]


def open_ms(elf: Path) -> float:
    """Return the time in which the image checks and opens its table, once after power-on."""
    return planner_of(elf).open_cycles / CYCLES_PER_MS


@lru_cache(maxsize=1)
def planner_of(elf: Path) -> ChipPlanner:
    """Return a booted chip, one for each process. Its limbs are worn, because such decisions take longest."""
    planner = ChipPlanner(elf)
    planner.wear(HALF_WORN)
    return planner


def _count(_ready: object, chunk: _Chunk) -> _Counted:
    planner = planner_of(chunk.elf)
    planner.configure(chunk.path, chunk.config)
    profile = planner.chip.profile()
    timed = chunk.timed
    depths = np.full(len(timed.states), chunk.depth, dtype=np.int32)
    _, cycles = planner.plan(timed.states, depths, timed.limb_use, timed.along_points)
    functions = tuple((f.name, f.calls, f.instructions, f.cycles) for f in profile.functions())
    return _Counted(chunk, cycles, functions)


def chip_speed(
    elf: Path,
    image: Path,
    paths: Mapping[str, SwimPath],
    config: PlanConfig,
    counts: Mapping[int, int],
    seed: int = 0,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[int, DepthSpeed]:
    """Time decisions of a bench image.

    Args:
        config: configuration of the planner; its depth is not used.
        counts: depth -> number of states, divided among the paths.
        progress: called with (decisions done, all), weighted by the cost of a depth.

    Returns:
        Depth -> times.
    """
    study = _Study(elf, read_image(image), paths, config, counts, seed, workers, progress)
    found = study.run(study.at_random())
    speeds = {}
    for depth in counts:
        mine = [one for one in found if one.chunk.depth == depth]
        error, unrun_ms = 0.0, 0.0
        if counts[depth] > RUN[depth]:
            costs = study.costs(depth, mine)
            others = {name: study.others(depth, name, costs) for name in paths}
            mine += study.run(
                [
                    chunk
                    for name, (timed, _, places) in others.items()
                    for chunk in study.cut(depth, name, timed.chosen(places), at_random=False)
                ]
            )
            error = study.error(depth, mine, costs)
            most = max(float(np.delete(cycles, places).max()) for _, cycles, places in others.values())
            unrun_ms = most * (1.0 + error) / CYCLES_PER_MS
        speed = _summary(mine, study.count(depth) * len(paths), error, unrun_ms)
        speeds[depth] = dataclasses.replace(speed, least_ms=_least_ms(elf, paths, config, depth, speed))
    return speeds


def _least_ms(
    elf: Path, paths: Mapping[str, SwimPath], config: PlanConfig, depth: int, speed: DepthSpeed
) -> float:
    planner = ChipPlanner(elf, LEAST_COST)
    planner.wear(HALF_WORN)
    planner.configure(paths[speed.worst_path], config)
    _, cycles = planner.plan(
        np.array([speed.worst_state], dtype=np.float32),
        np.array([depth], dtype=np.int32),
        np.array([speed.worst_limb_use], dtype=np.uint16),
        np.array([speed.worst_along_points], dtype=np.float32),
    )
    return float(cycles[0]) / CYCLES_PER_MS


@dataclass(eq=False)
class _Study:
    elf: Path
    tables: Tables
    paths: Mapping[str, SwimPath]
    config: PlanConfig
    counts: Mapping[int, int]
    seed: int
    workers: int
    progress: Callable[[int, int], None]
    _done: int = 0

    def run(self, chunks: Sequence[_Chunk]) -> list[_Counted]:
        """Return the counts of all chunks, and report the progress."""
        whole = sum(min(count, RUN[depth]) for depth, count in self.counts.items())
        job = Job(tuple, (), _count, len)  # each process boots a chip of its own, and needs nothing for that
        found = []
        for _, counted in run_chunks(job, chunks, self.workers):
            found.append(counted)
            self._done += len(counted.cycles)
            self.progress(min(self._done, whole), whole)
        return found

    def count(self, depth: int) -> int:
        """Return the number of states of a depth along one path."""
        return -(-self.counts[depth] // len(self.paths))

    def states(self, depth: int, name: str) -> TimedStates:
        """Return all states of a depth along a path."""
        rng = np.random.default_rng([self.seed, depth, list(self.paths).index(name)])
        return states_for_timing(self.tables, self.paths[name], self.count(depth), rng)

    def first(self, depth: int) -> int:
        """Return how many states along one path are run at random: all, or half of those that may be run."""
        if self.counts[depth] <= RUN[depth]:
            return self.count(depth)
        return RUN[depth] // (2 * len(self.paths))

    def at_random(self) -> list[_Chunk]:
        """Return the random chunks, the most expensive depth first, so that the processes end together."""
        chunks = []
        for depth in sorted(self.counts, reverse=True):
            for name in self.paths:
                timed = self.states(depth, name).part(0, self.first(depth))
                chunks += self.cut(depth, name, timed, at_random=True)
        return chunks

    def costs(self, depth: int, ran: Sequence[_Counted]) -> Float64:
        """Return the cycles of blocks, fitted to half of the states that were run at random."""
        halves = [(one, len(one.cycles) // 2) for one in ran]
        runs = [(one.chunk.path, one.chunk.timed.part(0, half), one.cycles[:half]) for one, half in halves]
        return fit_cycles(self.tables.image, self.config, runs, depth)

    def error(self, depth: int, ran: Sequence[_Counted], costs: Float64) -> float:
        """Return the model's largest relative error over states that it was not fitted to."""
        settings, error = dataclasses.replace(self.config, depth=depth), 0.0
        for one in ran:
            fitted = len(one.cycles) // 2 if one.chunk.at_random else 0
            predicted = cycles_of(costs, self.tables.image, one.chunk.path, settings, one.chunk.timed)
            error = max(error, float(np.abs(one.cycles / predicted - 1.0)[fitted:].max()))
        return error

    def others(self, depth: int, name: str, costs: Float64) -> tuple[TimedStates, Float64, Int64]:
        """Return the other states, their cycles by the model, and the indices of the most expensive ones."""
        timed = self.states(depth, name).part(self.first(depth), self.count(depth))
        settings = dataclasses.replace(self.config, depth=depth)
        predicted = cycles_of(costs, self.tables.image, self.paths[name], settings, timed)
        return timed, predicted, most_expensive(predicted, timed.beyond, RUN[depth] // (2 * len(self.paths)))

    def cut(self, depth: int, name: str, timed: TimedStates, at_random: bool) -> list[_Chunk]:
        count = len(timed.states)
        step = max(_CHUNK, count // 64)
        return [
            _Chunk(self.elf, self.config, name, self.paths[name], depth, timed.part(at, step), at_random)
            for at in range(0, count, step)
        ]


def _summary(parts: Sequence[_Counted], states: int, error: float, unrun_ms: float) -> DepthSpeed:
    cycles = np.concatenate([part.cycles for part in parts])
    beyond = np.concatenate([part.chunk.timed.beyond for part in parts])
    some = [part for part in parts if part.chunk.at_random]
    number = sum(len(part.cycles) for part in some)
    worst = max(parts, key=lambda part: int(part.cycles.max()))
    at, timed = int(worst.cycles.argmax()), worst.chunk.timed
    totals: dict[str, list[float]] = {}
    for part in some:
        for name, calls, instructions, spent in part.functions:
            total = totals.setdefault(name, [0.0, 0.0, 0.0])
            for place, value in enumerate((calls, instructions, spent)):
                total[place] += value
    spent_all = sum(total[2] for total in totals.values())
    instructions_all = sum(total[1] for total in totals.values())
    nodes = totals.get(NODE, [0.0])[0]
    ordered = sorted(totals, key=lambda name: -totals[name][2])
    return DepthSpeed(
        states=states,
        run=len(cycles),
        mean_ms=sum(float(part.cycles.sum()) for part in some) / number / CYCLES_PER_MS,
        worst_ms=float(cycles.max()) / CYCLES_PER_MS,
        least_ms=0.0,
        worst_ms_by_reach={
            float(kind): float(cycles[beyond == kind].max()) / CYCLES_PER_MS for kind in np.unique(beyond)
        },
        model_error=error,
        unrun_ms=unrun_ms,
        worst_path=worst.chunk.path_name,
        worst_state=tuple(timed.states[at].tolist()),
        worst_limb_use=tuple(timed.limb_use[at].tolist()),
        worst_along_points=float(timed.along_points[at]),
        nodes=nodes / number,
        instructions_per_node=instructions_all / max(nodes, 1.0),
        shares=tuple(
            Share(name, 100.0 * totals[name][2] / spent_all, totals[name][0] / number) for name in ordered
        ),
    )


def fit_cycles(
    image: bytes, config: PlanConfig, runs: Sequence[tuple[PathLike, TimedStates, Int64]], depth: int
) -> Float64:
    """Return the (blocks,) cost of each block, of least relative squares.

    Args:
        image: table image.
        config: configuration of the planner; its depth is not used.
        runs: path, states and the (k,) cycles on the chip.
        depth: depth of all runs.
    """
    counter, settings = BlockCounter(), dataclasses.replace(config, depth=depth)
    blocks = np.concatenate([_blocks(counter, image, path, settings, timed) for path, timed, _ in runs])
    cycles = np.concatenate([one for _, _, one in runs]).astype(np.float64)
    parts = blocks / cycles[:, np.newaxis]
    size = parts.max(axis=0)
    size[size == 0.0] = 1.0
    parts = parts / size
    matrix = parts.T @ parts + _RIDGE**2 * np.eye(len(size))
    return np.asarray(np.linalg.solve(matrix, parts.sum(axis=0)) / size)


def cycles_of(
    costs: Float64, image: bytes, path: PathLike, config: PlanConfig, timed: TimedStates
) -> Float64:
    """Return the (k,) cycles of decisions by the costs of blocks, at the configuration's depth."""
    counter = BlockCounter()
    parts = [timed.part(at, _BATCH) for at in range(0, len(timed.states), _BATCH)]
    return np.concatenate([_blocks(counter, image, path, config, part) @ costs for part in parts])


def _blocks(
    counter: BlockCounter, image: bytes, path: PathLike, config: PlanConfig, timed: TimedStates
) -> Float64:
    counted = counter.count(image, path, config, timed.states, timed.limb_use, timed.along_points)
    return counted.astype(np.float64)


def most_expensive(predicted: Float64, beyond: Float32, number: int) -> Int64:
    """Return the indices of about ``number`` states: the most expensive of all, and of each reach."""
    kinds = np.unique(beyond)
    order = np.argsort(-predicted, kind="stable")
    each = max(1, number // (2 * len(kinds)))
    found = [order[: number - each * len(kinds)]]
    found += [order[beyond[order] == kind][:each] for kind in kinds]
    return np.unique(np.concatenate(found))


_DEAREST = 12
"""Number of functions whose share of the cycles is listed."""


@dataclass(frozen=True, eq=False)
class ChipStudy(StudyResult):
    """Time that the chip takes to plan, in cycles of the flashed image.

    Attributes:
        speeds: depth -> times over many states.
        open_ms: time to check the table once, ms.
        limit_ms: depth -> the longest time allowed.
        cycle_model: cycles of each kind of instruction on the virtual chip.
    """

    speeds: Mapping[int, DepthSpeed]
    open_ms: float
    limit_ms: Mapping[int, float]
    cycle_model: Mapping[str, Any]
    seed: int

    @property
    def passed(self) -> bool:
        """Whether no plan exceeds its limit, run or not."""
        return not any(
            max(self.speeds[depth].worst_ms, self.speeds[depth].unrun_ms) > limit
            for depth, limit in self.limit_ms.items()
        )

    def as_json(self) -> dict[str, Any]:
        def each(value: Callable[[DepthSpeed], Any]) -> dict[str, Any]:
            return {str(depth): value(speed) for depth, speed in self.speeds.items()}

        return {
            "plan_ms": each(lambda one: {"mean": round(one.mean_ms, 4), "worst": round(one.worst_ms, 4)}),
            "band_ms": each(lambda one: [round(one.least_ms, 4), round(one.worst_ms, 4)]),
            "limit_ms": {str(depth): limit for depth, limit in self.limit_ms.items()},
            "states": each(lambda one: one.states),
            "run": each(lambda one: one.run),
            "model_error": each(lambda one: round(one.model_error, 5)),
            "unrun_ms": each(lambda one: round(one.unrun_ms, 4)),
            "worst_ms_by_reach": each(
                lambda one: {str(reach): round(ms, 4) for reach, ms in one.worst_ms_by_reach.items()}
            ),
            "nodes": each(lambda one: round(one.nodes, 1)),
            "instructions_per_node": each(lambda one: round(one.instructions_per_node, 1)),
            "open_ms": round(self.open_ms, 2),
            "worst": each(
                lambda one: {
                    key: getattr(one, f"worst_{key}") for key in ("path", "state", "limb_use", "along_points")
                }
            ),
            "share_percent": each(
                lambda one: {s.function: round(s.percent, 1) for s in one.shares[:_DEAREST]}
            ),
            "calls": each(lambda one: {s.function: round(s.calls, 1) for s in one.shares[:_DEAREST]}),
            "cycle_model": dict(self.cycle_model),
            "seed": self.seed,
        }


def run(config: Chip) -> ChipStudy:
    require_tools("bench")
    image = table_image(config.tables, config.model)
    robot = robot_of_table(image, config.model)
    counts = {depth: config.states if depth in LIMIT_MS else max(3, config.states // 50) for depth in DEPTHS}
    paths = {name: shape(name) for name in SHAPES}
    settings = plan_config(robot, config.planner, None)
    processes = config.processes
    with built_firmware("bench", image, robot) as built, shown(True, "decisions") as tell:
        opened_ms = open_ms(built.image)
        speeds = chip_speed(built.image, image, paths, settings, counts, config.seed, processes, tell)
    return ChipStudy(speeds, opened_ms, LIMIT_MS, dataclasses.asdict(CostModel()), config.seed)
