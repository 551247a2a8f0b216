"""Studies of what a planner is told: by tables or by the rods, from bad fixes, of the whole run at once."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frogkick.core.errors import InputError
from frogkick.core.progress import Progress, shown
from frogkick.front.places import plan_config, robot_of_table, start_pose, swim_path, table_image
from frogkick.library import fit_table, quantise, read_library
from frogkick.library.fitting import BUDGET_BYTES, require_enough
from frogkick.paths import SHAPES
from frogkick.paths import Path as SwimPath
from frogkick.runs.closed_loop import require_time
from frogkick.tables.image import Tables, read_image
from frogkick_studies import ceiling
from frogkick_studies.estimator import RATES_HZ, Condition, Outcome, compare_estimators
from frogkick_studies.foresight import Foreseen, foresee, nearest_at

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "RATES_HZ",
    "CeilingStudy",
    "Condition",
    "EstimatorStudy",
    "ForesightStudy",
    "Outcome",
    "study_ceiling",
    "study_estimator",
    "study_foresight",
]

_MEASURES = ("mean_distance_m", "progress_mps")


@dataclass(frozen=True, eq=False, repr=False)
class CeilingStudy:
    """One planner in the pool, told by a full nearest table, by the robot's, or by the rods themselves.

    Attributes:
        runs: each of them.
        depths: strokes that were looked ahead.
        seeds: runs of each.
        table_bytes: sizes of both tables.
    """

    runs: Sequence[ceiling.Run]
    depths: Sequence[int]
    seeds: int
    table_bytes: Mapping[str, int]

    def plot(self) -> Figure:
        """A matplotlib figure: distance and progress by source and depth."""
        from frogkick_studies.ceiling_figure import ceiling_figure

        return ceiling_figure(self.runs)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study ceiling``."""
        ahead = {
            source: {
                of: ceiling.rms_error([run for run in self.runs if run.source == source], of)
                for of in ("told", "planned")
            }
            for source in ceiling.SOURCES
        }
        return {
            "rows": [
                self._row(path, source, depth)
                for depth in self.depths
                for path in (*SHAPES, None)
                for source in ceiling.SOURCES
            ],
            "further_than_rods_m": [
                self._beside_rods(source, depth)
                for depth in self.depths
                for source in (ceiling.NEAREST, ceiling.AFFINE)
            ],
            "one_stroke_ahead": ahead,
            "table_bytes": dict(self.table_bytes),
            "seeds": self.seeds,
        }

    def _of(self, source: str, depth: int) -> list[ceiling.Run]:
        return [run for run in self.runs if (run.source, run.depth) == (source, depth)]

    def _row(self, path: str | None, source: str, depth: int) -> dict[str, Any]:
        """One path's runs; without a path those of all, a mean for each seed."""
        mine = [run for run in self._of(source, depth) if path in (None, run.path)]
        means = {
            name: ceiling.over_seeds(mine, name)
            if path is None
            else ceiling.mean_of([getattr(run, name) for run in mine])
            for name in _MEASURES
        }
        return {
            "path": path or "all",
            "source": source,
            "depth": depth,
            **{name: dataclasses.asdict(mean) for name, mean in means.items()},
            "completed": sum(run.completed for run in mine) / len(mine),
            "decisions": sum(len(run.planned) for run in mine),
        }

    def _beside_rods(self, source: str, depth: int) -> dict[str, Any]:
        """How much further from the paths a source's runs are than those of the rods, seed by seed."""
        mine, rods = self._of(source, depth), self._of(ceiling.RODS, depth)
        mean = ceiling.more_than(mine, rods, "mean_distance_m")
        return {"source": source, "depth": depth, **dataclasses.asdict(mean)}

    def __repr__(self) -> str:
        return f"CeilingStudy({len(self.runs)} runs, {self.seeds} seeds, depths {list(self.depths)})"


def study_ceiling(
    library: Path | str,
    *,
    tables: Path | None = None,
    depths: Sequence[int] = (1, 2),
    seeds: int = 8,
    time_limit_s: float = ceiling.TIME_LIMIT_S,
    workers: int | None = None,
    progress: Progress = False,
) -> CeilingStudy:
    """Follow paths with one planner, told by a full nearest table, by the robot's, or by the rods themselves.

    Args:
        library: file; the larger the better.
        tables: the robot's own; None: affine, 64 KiB, of that library.
        depths: strokes to look ahead, 1 to 3; each one that the rods look further takes as many times longer
            as the robot has actions.
        seeds: runs of each, by noise and start.
        time_limit_s: longest pool time of a run, s.
        workers: processes; None: one for each core.
        progress: True for bars, or a function of (done, all) of each stage.

    Raises:
        InputError: no such library, or a table of another robot.
    """
    require_time(time_limit_s)
    content = read_library(library)
    robot = content.robot()
    if tables is None:
        require_enough(content)
        with shown(progress, "robot's table") as tell:
            own = fit_table(content, "affine", BUDGET_BYTES, tell).image
    else:
        opened = read_image(tables)
        opened.require_robot(robot.id)
        if opened.period_us != round(robot.period_s * 1e6) or len(opened.actions) != len(robot.actions):
            raise InputError(
                f"table {tables.name!r} has another period or other actions than the robot of library "
                f"{Path(library).name!r}: build it from a library of this robot"
            )
        own = opened.image
    images = {ceiling.NEAREST: quantise(content), ceiling.AFFINE: own}
    levels = sorted(set(depths))
    processes = workers or os.cpu_count() or 1
    with shown(progress, "runs") as tell:
        runs = ceiling.follow_paths(robot, images, list(SHAPES), levels, seeds, time_limit_s, processes, tell)
    return CeilingStudy(runs, levels, seeds, {name: len(image) for name, image in images.items()})


@dataclass(frozen=True, eq=False, repr=False)
class EstimatorStudy:
    """States from late, lost, doubled and wrong fixes, by several methods.

    Attributes:
        outcomes: condition of the camera -> method -> errors of its states.
        seeds: runs along each path.
    """

    outcomes: Mapping[Condition, Mapping[str, Outcome]]
    seeds: int

    def plot(self) -> Figure:
        """A matplotlib figure: errors of each method by rate and by fault."""
        from frogkick_studies.estimator_figure import estimator_figure

        return estimator_figure(self.outcomes)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study estimator``."""
        rows = [
            {
                "rate_hz": condition.rate_hz,
                "fault": condition.fault,
                "method": method,
                **dataclasses.asdict(one),
            }
            for condition, methods in self.outcomes.items()
            for method, one in methods.items()
        ]
        return {"outcomes": rows, "seeds": self.seeds}

    def __repr__(self) -> str:
        return f"EstimatorStudy({len(self.outcomes)} conditions, {self.seeds} seeds)"


def study_estimator(
    tables: Path | None = None,
    *,
    robot: str | None = None,
    paths: Sequence[str] = ("line", "ellipse"),
    rates_hz: Sequence[float] = RATES_HZ,
    planner: str = "robot",
    depth: int | None = None,
    seeds: int = 3,
    time_limit_s: float = 60.0,
    workers: int | None = None,
    progress: Progress = False,
) -> EstimatorStudy:
    """Estimate states from bad fixes in the pool: the robot's way, by a line, the paper's.

    Args:
        tables: image; None: the robot's default one.
        robot: name or TOML file; None: the table's own.
        paths: names of shapes, or files.
        rates_hz: fixes a second.
        planner: whose weights and depth: "robot" or "paper".
        depth: periods to look ahead, 1 to 4; None: the planner's own.
        seeds: runs along each path.
        time_limit_s: longest pool time of a run, s.
        workers: processes; None: one for each core.
        progress: of the runs: True for a bar, or a function of (done, all).

    Raises:
        InputError: an unknown path, or a table of another robot.
    """
    require_time(time_limit_s)
    image = table_image(tables, robot)
    described = robot_of_table(image, robot)
    courses = [swim_path(name) for name in paths]
    config = plan_config(described, planner, depth)
    processes = workers or os.cpu_count() or 1
    with shown(progress, "runs") as tell:
        outcomes = compare_estimators(
            described, image.read_bytes(), courses, config, seeds, time_limit_s, rates_hz, processes, tell
        )
    return EstimatorStudy(outcomes, seeds)


@dataclass(frozen=True, eq=False, repr=False)
class ForesightStudy:
    """How near to a path any plan could stay, and how fast.

    Attributes:
        path: that is followed.
        name: as it was given.
        tables: that tell what each action does.
        plans: the best ones, from fast to near.
        at_least_mps: progress that was asked for; None: none was.
    """

    path: SwimPath
    name: str
    tables: Tables
    plans: Sequence[Foreseen]
    at_least_mps: float | None = None

    @property
    def nearest_m(self) -> float | None:
        """Mean distance of the nearest plan of ``at_least_mps``; None where none is so fast."""
        return nearest_at(self.plans, self.at_least_mps or 0.0)

    def plot(self) -> Figure:
        """A matplotlib figure: distance against progress, and the tracks."""
        from frogkick_studies.foresight_figure import foresight_figure

        return foresight_figure(self.path, self.plans)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study foresight``."""
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
            values |= {"at_least_mps": self.at_least_mps, "nearest_m": self.nearest_m}
        return values

    def __repr__(self) -> str:
        return f"ForesightStudy({self.name}: {len(self.plans)} plans)"


def study_foresight(
    path: SwimPath | str = "sine",
    *,
    tables: Path | None = None,
    at_least_mps: float | None = None,
    breadth: int = 300,
    progress: Progress = False,
) -> ForesightStudy:
    """Plan a whole run at once, by the table, without noise, delay, or a limit of time or memory.

    A planner on the robot stays further off; by how much more tells what it misses, and the rest is what the
    path asks of the robot.

    Args:
        path: to follow, world frame, or a shape's name or a path file.
        tables: image; None: the default one.
        at_least_mps: progress that a plan has to make, m/s; None: any.
        breadth: plans kept for each part of the path.
        progress: of the decisions ahead: True for a bar, or a function of (done, all).

    Raises:
        InputError: no such path or table, or a speed below 0.
    """
    if at_least_mps is not None and not (math.isfinite(at_least_mps) and at_least_mps >= 0.0):
        raise InputError(f"--at-least {at_least_mps} m/s: give a speed from 0 on")
    course = swim_path(path)
    opened = read_image(table_image(tables, None))
    with shown(progress, "decisions ahead") as tell:
        plans = foresee(opened, course, start_pose(course), breadth, tell)
    name = path if isinstance(path, str) else path.name
    return ForesightStudy(course, name, opened, plans, at_least_mps)
