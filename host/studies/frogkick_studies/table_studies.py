"""Studies of the model and its tables: the rods' time step, a table's bytes and inputs, the chip's cycles."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frogkick.core.progress import Progress, shown
from frogkick.der import STEP_S
from frogkick.front.places import built_firmware, plan_config, robot_of_table, table_image
from frogkick.library import read_library
from frogkick.paths import SHAPES, shape
from frogkick.robot import Robot, load_robot
from frogkick_codegen.firmware import require_tools
from frogkick_studies.convergence import ERROR_LIMIT, Curve, convergence
from frogkick_studies.history import HistoryResult, history_worth
from frogkick_studies.table_size import TableSizes, least_bytes_as_good, over_full_nearest, slope, table_sizes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from frogkick_studies.chip_speed import DepthSpeed

__all__ = [
    "ChipStudy",
    "ConvergenceStudy",
    "HistoryStudy",
    "TableStudy",
    "study_chip",
    "study_convergence",
    "study_history",
    "study_tables",
]

_DEAREST = 12
"""Functions that are listed with their share of the cycles."""


@dataclass(frozen=True, eq=False, repr=False)
class ConvergenceStudy:
    """Error of the rod simulation against its time step.

    Attributes:
        curves: of strokes and of gaits.
    """

    curves: Sequence[Curve]

    @property
    def passed(self) -> bool:
        """Whether the default step errs little enough."""
        return not any(curve.worst[curve.step_s == STEP_S].max() > ERROR_LIMIT for curve in self.curves)

    def plot(self) -> Figure:
        """A matplotlib figure: error over the time step."""
        from frogkick_studies.convergence_figure import convergence_figure

        return convergence_figure(self.curves, STEP_S)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study convergence``."""
        return {
            "default_step_s": STEP_S,
            "limit": ERROR_LIMIT,
            "order": {curve.name: round(curve.order, 3) for curve in self.curves},
            "error_at_default": {curve.name: curve.at_default for curve in self.curves},
            "worst": {
                curve.name: dict(zip(curve.step_s.tolist(), curve.worst.tolist(), strict=True))
                for curve in self.curves
            },
            "rms": {
                curve.name: dict(zip(curve.step_s.tolist(), curve.error.tolist(), strict=True))
                for curve in self.curves
            },
        }

    def __repr__(self) -> str:
        told = ", ".join(f"{curve.name} of order {curve.order:.2f}" for curve in self.curves)
        return f"ConvergenceStudy({told}; {'passed' if self.passed else 'missed'})"


def study_convergence(
    robot: Robot | str = "frog2022", *, every: int = 1, progress: Progress = False
) -> ConvergenceStudy:
    """Simulate strokes and gaits at several time steps, and compare them with a fine one.

    Args:
        robot: it, or its name or TOML file.
        every: takes every so many-th of the gaits.
        progress: of the simulations: True for a bar, or a function of (done, all).

    Raises:
        InputError: no such robot.
        ConvergenceError: a simulation failed.
    """
    described = load_robot(robot)
    with shown(progress, "convergence") as tell:
        return ConvergenceStudy(convergence(described, tell, every))


@dataclass(frozen=True, eq=False, repr=False)
class ChipStudy:
    """How long the chip plans, in cycles of the flashed image.

    Attributes:
        speeds: depth -> times over many states.
        open_ms: checking the table once, ms.
        limit_ms: depth -> the longest that is allowed.
        cycle_model: cycles of an instruction of each kind on the virtual chip.
        seed: of the states.
    """

    speeds: Mapping[int, DepthSpeed]
    open_ms: float
    limit_ms: Mapping[int, float]
    cycle_model: Mapping[str, Any]
    seed: int

    @property
    def passed(self) -> bool:
        """Whether no plan takes longer than its limit, run or not."""
        return not any(
            max(self.speeds[depth].worst_ms, self.speeds[depth].unrun_ms) > limit
            for depth, limit in self.limit_ms.items()
        )

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study chip``."""
        speeds = {str(depth): speed for depth, speed in self.speeds.items()}
        return {
            "plan_ms": {
                depth: {"mean": round(speed.mean_ms, 4), "worst": round(speed.worst_ms, 4)}
                for depth, speed in speeds.items()
            },
            "band_ms": {
                depth: [round(speed.least_ms, 4), round(speed.worst_ms, 4)] for depth, speed in speeds.items()
            },
            "limit_ms": {str(depth): limit for depth, limit in self.limit_ms.items()},
            "states": {depth: speed.states for depth, speed in speeds.items()},
            "run": {depth: speed.run for depth, speed in speeds.items()},
            "model_error": {depth: round(speed.model_error, 5) for depth, speed in speeds.items()},
            "unrun_ms": {depth: round(speed.unrun_ms, 4) for depth, speed in speeds.items()},
            "worst_ms_by_reach": {
                depth: {str(reach): round(one, 4) for reach, one in speed.worst_ms_by_reach.items()}
                for depth, speed in speeds.items()
            },
            "nodes": {depth: round(speed.nodes, 1) for depth, speed in speeds.items()},
            "instructions_per_node": {
                depth: round(speed.instructions_per_node, 1) for depth, speed in speeds.items()
            },
            "open_ms": round(self.open_ms, 2),
            "worst": {
                depth: {
                    "path": speed.worst_path,
                    "state": speed.worst_state,
                    "limb_use": speed.worst_limb_use,
                    "along_points": speed.worst_along_points,
                }
                for depth, speed in speeds.items()
            },
            "share_percent": {
                depth: {share.function: round(share.percent, 1) for share in speed.shares[:_DEAREST]}
                for depth, speed in speeds.items()
            },
            "calls": {
                depth: {share.function: round(share.calls, 1) for share in speed.shares[:_DEAREST]}
                for depth, speed in speeds.items()
            },
            "cycle_model": dict(self.cycle_model),
            "seed": self.seed,
        }

    def __repr__(self) -> str:
        told = ", ".join(f"depth {depth} {speed.worst_ms:.2f} ms" for depth, speed in self.speeds.items())
        return f"ChipStudy({told}; {'passed' if self.passed else 'over a limit'})"


def study_chip(
    tables: Path | None = None,
    *,
    robot: str | None = None,
    states: int = 300,
    planner: str = "robot",
    workers: int | None = 1,
    seed: int = 0,
    progress: Progress = False,
) -> ChipStudy:
    """Time the planner of the bench image on the virtual chip over many states.

    Of very many states the dearest are run, which a model of the planner's blocks finds among all of them.

    Args:
        tables: image; None: the robot's default one.
        robot: name or TOML file; None: the table's own.
        states: decisions at each depth that has a limit, 12 or more.
        planner: whose weights: "robot" or "paper".
        workers: processes; None: one for each core.
        seed: of the states.
        progress: of the decisions: True for a bar, or a function of (done, all).

    Raises:
        InputError: a table of another robot, or an extra that is not installed.
        ToolchainError: no compiler for the chip.
    """
    require_tools("bench")
    from frogkick.pool.chip import CostModel  # these cannot be loaded without the extra
    from frogkick_studies.chip_speed import DEPTHS, LIMIT_MS, chip_speed, open_ms

    image = table_image(tables, robot)
    described = robot_of_table(image, robot)
    counts = {depth: states if depth in LIMIT_MS else max(3, states // 50) for depth in DEPTHS}
    paths = {name: shape(name) for name in SHAPES}
    config = plan_config(described, planner, None)
    processes = workers or os.cpu_count() or 1
    with built_firmware("bench", image, described) as built, shown(progress, "decisions") as tell:
        opened_ms = open_ms(built.image)
        speeds = chip_speed(built.image, image, paths, config, counts, seed, processes, tell)
    return ChipStudy(speeds, opened_ms, LIMIT_MS, dataclasses.asdict(CostModel()), seed)


@dataclass(frozen=True, eq=False, repr=False)
class TableStudy:
    """Error of tables of both kinds against their size, and against their library's.

    Attributes:
        sizes: each table that was tried.
        seed: of the unseen states.
    """

    sizes: TableSizes
    seed: int

    def plot(self) -> Figure:
        """A matplotlib figure: error over bytes and over the library's states."""
        from frogkick_studies.table_size_figure import table_size_figure

        return table_size_figure(self.sizes)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study tables``."""
        affine = tuple(point for point in self.sizes.by_size if point.kind == "affine")
        return {
            "by_size": [dataclasses.asdict(point) for point in self.sizes.by_size],
            "by_library": [dataclasses.asdict(point) for point in self.sizes.by_library],
            "affine_bytes_as_good_as_nearest": least_bytes_as_good(self.sizes),
            "affine_64_kib_over_full_nearest": over_full_nearest(self.sizes),
            "affine_exponent": {
                name: round(slope(affine, name), 3) for name in ("position_m", "heading_rad")
            },
            "seed": self.seed,
        }

    def __repr__(self) -> str:
        return f"TableStudy({len(self.sizes.by_size)} sizes, {len(self.sizes.by_library)} libraries)"


def study_tables(
    library: Path | str,
    *,
    test_states: int = 200,
    swims: str = "planned",
    seed: int = 1,
    progress: Progress = False,
) -> TableStudy:
    """Make tables of many sizes of a library, and measure each on unseen states.

    Args:
        library: file; the larger the better.
        test_states: unseen states of each sampling.
        swims: how unseen states of swims are drawn: "box", "visited" or "planned".
        seed: of the unseen states.
        progress: of the tables: True for a bar, or a function of (done, all).

    Raises:
        InputError: no such library, or one of too few states.
    """
    content = read_library(library)
    with shown(progress, "tables") as tell:
        return TableStudy(table_sizes(content, test_states, seed, tell, swims), seed)


@dataclass(frozen=True, eq=False, repr=False)
class HistoryStudy:
    """Error of affine tables with and without limb use as an input.

    Attributes:
        results: for this robot and tiring ones.
        seed: of the states.
    """

    results: Sequence[HistoryResult]
    seed: int

    def plot(self) -> Figure:
        """A matplotlib figure: errors with and without, for each robot."""
        from frogkick_studies.history_figure import history_figure

        return history_figure(self.results)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study history``."""
        return {"robots": [dataclasses.asdict(result) for result in self.results], "seed": self.seed}

    def __repr__(self) -> str:
        return f"HistoryStudy({len(self.results)} robots)"


def study_history(
    robot: Robot | str = "frog2022",
    *,
    states: int = 400,
    test_states: int = 100,
    seed: int = 1,
    progress: Progress = False,
) -> HistoryStudy:
    """Simulate libraries of a robot and of tiring ones, and fit tables with and without limb use.

    Args:
        robot: it, or its name or TOML file.
        states: of each library, 50 or more.
        test_states: unseen ones.
        seed: of the states.
        progress: True for a bar, or a function of (done, all).

    Raises:
        InputError: no such robot.
    """
    described = load_robot(robot)
    with shown(progress, "limb history") as tell:
        return HistoryStudy(history_worth(described, states, test_states, seed, tell), seed)
