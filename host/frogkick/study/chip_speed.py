"""How long the chip plans: cycles of the flashed image over many states and paths."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from frogkick.loop.chip_planner import ChipPlanner
from frogkick.paths import Path as SwimPath
from frogkick.planner.image import Tables, read_image
from frogkick.planner.layout import LIMBS_MAX
from frogkick.planner.plan import PlanConfig, path_rows

CYCLES_PER_MS = 64_000
LIMIT_MS: Mapping[int, float] = {1: 0.45, 2: 4.5, 3: 20.0}
"""What a decision may take at each depth, worst case."""
DEPTHS = (1, 2, 3, 4)
NODE = "fk_lookup_motion"
"""One call of it is one node of the search: a pose that is predicted and costed."""
_CHUNK = 50
_BEYOND = (1.0, 3.0, 30.0, 1000.0)
"""Velocities go to so many times the table's box, in turn; poses to so many times the path's surroundings."""


@dataclass(frozen=True)
class Share:
    """A function's part of one depth's time: name, percent of the cycles, calls a decision."""

    function: str
    percent: float
    calls: float


@dataclass(frozen=True)
class DepthSpeed:
    """What decisions of one depth took.

    Attributes:
        states: how many.
        mean_ms, worst_ms: at 64 MHz.
        worst_path, worst_state, worst_limb_use, worst_along_points: where it was worst.
        nodes: nodes of the search, mean.
        instructions_per_node: mean.
        shares: functions, the most expensive first.
    """

    states: int
    mean_ms: float
    worst_ms: float
    worst_path: str
    worst_state: tuple[float, ...]
    worst_limb_use: tuple[int, ...]
    worst_along_points: float
    nodes: float
    instructions_per_node: float
    shares: tuple[Share, ...]


@dataclass(frozen=True, eq=False)
class TimedStates:
    """States to time: (k, 6) float32, (k, 8) limb use, (k,) where along the path each was last."""

    states: npt.NDArray[np.float32]
    limb_use: npt.NDArray[np.uint16]
    along_points: npt.NDArray[np.float32]

    def part(self, at: int, count: int) -> TimedStates:
        """Return ``count`` of them."""
        end = at + count
        return TimedStates(self.states[at:end], self.limb_use[at:end], self.along_points[at:end])


@dataclass(frozen=True, eq=False)
class _Chunk:
    elf: Path
    config: PlanConfig
    path_name: str
    path: SwimPath
    depth: int
    timed: TimedStates


@dataclass(frozen=True, eq=False)
class _Counted:
    depth: int
    path_name: str
    cycles: npt.NDArray[np.int64]
    timed: TimedStates
    functions: tuple[tuple[str, int, int, float], ...]


def open_ms(elf: Path) -> float:
    """How long the image takes to check and open its table, once after power-on."""
    return planner_of(elf).open_cycles / CYCLES_PER_MS


def states_for_timing(tables: Tables, path: SwimPath, count: int, rng: np.random.Generator) -> TimedStates:
    """Return states about a path, from the table's box and beyond."""
    rows = path_rows(path).astype(np.float64)
    scale = tables.velocity_scale.astype(np.float64)
    low, high = tables.states.min(axis=0) * scale, tables.states.max(axis=0) * scale
    far = np.resize(_BEYOND, count)
    states = np.empty((count, 6))
    near = rng.integers(0, rows.shape[1], count)
    reach = 0.2 * np.minimum(far, 30.0)
    for axis in (0, 1):
        states[:, axis] = rows[axis, near] + reach * rng.uniform(-1.0, 1.0, count)
    states[:, 2] = rng.uniform(-np.pi, np.pi, count)
    states[:, 3:] = rng.uniform(low, high, (count, 3)) * far[:, np.newaxis]
    limb_use = rng.integers(0, 32768, (count, LIMBS_MAX)).astype(np.uint16)
    limb_use[:, tables.limbs :] = 0
    limb_use[rng.random(count) < 0.25] = 0
    along = np.clip(near - rng.exponential(0.03 * rows.shape[1], count), 0, rows.shape[1] - 1)
    return TimedStates(states.astype(np.float32), limb_use, along.astype(np.float32))


@lru_cache(maxsize=1)
def planner_of(elf: Path) -> ChipPlanner:
    """One booted chip for each process."""
    return ChipPlanner(elf)


def _count(chunk: _Chunk) -> _Counted:
    planner = planner_of(chunk.elf)
    planner.configure(chunk.path, chunk.config)
    profile = planner.chip.profile()
    timed = chunk.timed
    depths = np.full(len(timed.states), chunk.depth, dtype=np.int32)
    _, cycles = planner.plan(timed.states, depths, timed.limb_use, timed.along_points)
    functions = tuple((f.name, f.calls, f.instructions, f.cycles) for f in profile.functions())
    return _Counted(chunk.depth, chunk.path_name, cycles, timed, functions)


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
        elf: the image.
        image: its table.
        paths: to plan along, by name.
        config: of the planner; its depth is not used.
        counts: depth -> states, shared among the paths.
        seed: makes the states again.
        workers: processes.
        progress: called with decisions done and to do, weighted by what a depth costs.

    Returns:
        Depth -> what was found.
    """
    tables = read_image(image)
    chunks = list(_chunks(elf, tables, paths, config, counts, seed))
    whole = sum(len(chunk.timed.states) for chunk in chunks)
    found: list[_Counted] = []
    done = 0
    if workers > 1:
        with multiprocessing.get_context("spawn").Pool(workers) as pool:
            for counted in pool.imap_unordered(_count, chunks):
                found.append(counted)
                progress(done := done + len(counted.timed.states), whole)
    else:
        for chunk in chunks:
            found.append(_count(chunk))
            progress(done := done + len(chunk.timed.states), whole)
    return {depth: _summary([one for one in found if one.depth == depth]) for depth in counts}


def _chunks(
    elf: Path,
    tables: Tables,
    paths: Mapping[str, SwimPath],
    config: PlanConfig,
    counts: Mapping[int, int],
    seed: int,
) -> Sequence[_Chunk]:
    """The dearest first, so that no process is left with a long one at the end."""
    chunks = []
    for depth in sorted(counts, reverse=True):
        for number, (name, path) in enumerate(paths.items()):
            count = -(-counts[depth] // len(paths))
            rng = np.random.default_rng([seed, depth, number])
            timed = states_for_timing(tables, path, count, rng)
            step = max(_CHUNK, count // 64)
            chunks += [
                _Chunk(elf, config, name, path, depth, timed.part(at, step)) for at in range(0, count, step)
            ]
    return chunks


def _summary(parts: Sequence[_Counted]) -> DepthSpeed:
    cycles = np.concatenate([part.cycles for part in parts])
    worst = max(parts, key=lambda part: int(part.cycles.max()))
    at = int(worst.cycles.argmax())
    totals: dict[str, list[float]] = {}
    for part in parts:
        for name, calls, instructions, spent in part.functions:
            total = totals.setdefault(name, [0.0, 0.0, 0.0])
            for place, value in enumerate((calls, instructions, spent)):
                total[place] += value
    spent_all = sum(total[2] for total in totals.values())
    instructions_all = sum(total[1] for total in totals.values())
    nodes = totals.get(NODE, [0.0])[0]
    ordered = sorted(totals, key=lambda name: -totals[name][2])
    return DepthSpeed(
        states=len(cycles),
        mean_ms=float(cycles.mean()) / CYCLES_PER_MS,
        worst_ms=float(cycles.max()) / CYCLES_PER_MS,
        worst_path=worst.path_name,
        worst_state=tuple(worst.timed.states[at].tolist()),
        worst_limb_use=tuple(worst.timed.limb_use[at].tolist()),
        worst_along_points=float(worst.timed.along_points[at]),
        nodes=nodes / len(cycles),
        instructions_per_node=instructions_all / max(nodes, 1.0),
        shares=tuple(
            Share(name, 100.0 * totals[name][2] / spent_all, totals[name][0] / len(cycles))
            for name in ordered
        ),
    )
