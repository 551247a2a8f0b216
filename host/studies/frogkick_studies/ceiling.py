"""The upper bound for tables: one planner with tables as its model, and with the rods as model oracle."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.core.errors import InputError
from frogkick.core.progress import shown
from frogkick.library import fit_table, quantise, read_library
from frogkick.library.fitting import BUDGET_BYTES, require_enough
from frogkick.paths import SHAPES
from frogkick.report import style
from frogkick.runs.closed_loop import require_time
from frogkick.tables.image import read_image
from frogkick_studies import StudyResult
from frogkick_studies.configs import Ceiling
from frogkick_studies.rods_in_loop import AFFINE, NEAREST, RODS, SOURCES, Run, follow_paths

_CONFIDENCE = 0.95
_COLOUR = {NEAREST: style.MEASURED, AFFINE: style.TRUE, RODS: style.ESTIMATED}
_LABEL = {
    NEAREST: "full nearest table (the paper's)",
    AFFINE: "the robot's affine table",
    RODS: "the rods themselves: upper bound",
}
_MEASURES = (
    ("mean_distance_m", "mean distance to the path (mm)"),
    ("progress_mps", "progress (mm/s)"),
)
_ERRORS = (
    ("position_m", 1e3, "position error (mm)"),
    ("heading_rad", 180.0 / np.pi, "heading error (degrees)"),
)


@dataclass(frozen=True)
class Mean:
    """A mean over the seeds, and half the width of its 95 % interval (Student's t; NaN for one seed)."""

    value: float
    half_width: float


def mean_of(values: Sequence[float]) -> Mean:
    """Return the mean of independent seeds, with its interval."""
    from scipy import stats

    many = len(values)
    if many < 2:
        return Mean(float(np.mean(values)), float("nan"))
    factor = float(stats.t.ppf(0.5 + 0.5 * _CONFIDENCE, many - 1))
    return Mean(float(np.mean(values)), factor * float(np.std(values, ddof=1)) / many**0.5)


def over_seeds(runs: Sequence[Run], name: str) -> Mean:
    """Return ``mean_of`` an attribute of runs, after its mean over the paths of each seed."""
    return mean_of(_by_seed(runs, name))


def more_than(runs: Sequence[Run], others: Sequence[Run], name: str) -> Mean:
    """Return ``over_seeds`` of the difference to other runs of the same seeds and paths, which start
    equally."""
    pairs = zip(_by_seed(runs, name), _by_seed(others, name), strict=True)
    return mean_of([one - other for one, other in pairs])


def _by_seed(runs: Sequence[Run], name: str) -> list[float]:
    seeds = sorted({run.seed for run in runs})
    return [float(np.mean([getattr(run, name) for run in runs if run.seed == seed])) for seed in seeds]


def rms_error(runs: Sequence[Run], name: str) -> dict[str, float]:
    """Return the root mean square of ``Run.planned`` or ``Run.told`` over all decisions of some runs."""
    errors = np.concatenate([getattr(run, name) for run in runs])
    return {
        "position_m": float(np.sqrt(np.mean(np.sum(errors[:, :2] ** 2, axis=1)))),
        "heading_rad": float(np.sqrt(np.mean(errors[:, 2] ** 2))),
    }


@dataclass(frozen=True, eq=False)
class CeilingStudy(StudyResult):
    """One planner in the pool with three models: a full nearest table, the robot's table, the rods."""

    runs: Sequence[Run]
    depths: Sequence[int]
    seeds: int
    table_bytes: Mapping[str, int]

    def plot(self) -> Figure:
        """Draw ``follow_paths``: distance and progress by path and depth, and errors one period ahead."""
        paths = list(dict.fromkeys(run.path for run in self.runs))
        depths = sorted({run.depth for run in self.runs})
        with style.new_figure(4.6 * (len(depths) + 1), 6.4) as figure:
            panels = figure.subplots(2, len(depths) + 1, squeeze=False)
            for column, depth in enumerate(depths):
                here = [run for run in self.runs if run.depth == depth]
                for row, (name, label) in enumerate(_MEASURES):
                    axes = panels[row, column]
                    _by_path(axes, here, paths, name)
                    axes.set_ylabel(label)
                    axes.set_ylim(0.0, 1.06e3 * max(getattr(run, name) for run in self.runs))
                panels[0, column].set_title(f"Looking {depth} {'stroke' if depth == 1 else 'strokes'} ahead")
            for axes, (name, factor, label) in zip(panels[:, -1], _ERRORS, strict=True):
                _ahead(axes, self.runs, name, factor)
                axes.set_ylabel(label)
            panels[0, -1].set_title("Error one stroke ahead, RMS of all decisions")
            handles = [panels[0, 0].plot([], [], "s", color=_COLOUR[s], label=_LABEL[s])[0] for s in SOURCES]
            figure.legend(handles=handles, loc="outside lower center", ncols=len(SOURCES))
        return figure

    def as_json(self) -> dict[str, Any]:
        ahead = {
            source: {
                of: rms_error([run for run in self.runs if run.source == source], of)
                for of in ("told", "planned")
            }
            for source in SOURCES
        }
        return {
            "rows": [
                self._row(path, source, depth)
                for depth in self.depths
                for path in (*SHAPES, None)
                for source in SOURCES
            ],
            "further_than_rods_m": [
                self._beside_rods(source, depth) for depth in self.depths for source in (NEAREST, AFFINE)
            ],
            "one_stroke_ahead": ahead,
            "table_bytes": dict(self.table_bytes),
            "seeds": self.seeds,
        }

    def _of(self, source: str, depth: int) -> list[Run]:
        return [run for run in self.runs if (run.source, run.depth) == (source, depth)]

    def _row(self, path: str | None, source: str, depth: int) -> dict[str, Any]:
        """Return the row of one path; without a path that of all, with a mean for each seed."""
        mine = [run for run in self._of(source, depth) if path in (None, run.path)]
        means = {
            name: over_seeds(mine, name) if path is None else mean_of([getattr(run, name) for run in mine])
            for name, _ in _MEASURES
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
        """Return how much larger the distance is than that of the rods, seed by seed."""
        mine, rods = self._of(source, depth), self._of(RODS, depth)
        mean = more_than(mine, rods, "mean_distance_m")
        return {"source": source, "depth": depth, **dataclasses.asdict(mean)}

    def text(self, values: dict[str, Any]) -> str:
        lines = []
        for row in values["rows"]:
            far, fast = row["mean_distance_m"], row["progress_mps"]
            lines.append(
                f"depth {row['depth']} {row['path']:8s} {row['source']:8s} "
                f"{1e3 * far['value']:6.2f} +- {1e3 * far['half_width']:4.2f} mm, "
                f"{1e3 * fast['value']:5.1f} +- {1e3 * fast['half_width']:3.1f} mm/s, "
                f"{100 * row['completed']:3.0f} % completed"
            )
        for more in values["further_than_rods_m"]:
            lines.append(
                f"depth {more['depth']} {more['source']:8s} further from the paths than the rods by "
                f"{1e3 * more['value']:.2f} +- {1e3 * more['half_width']:.2f} mm"
            )
        for source, errors in values["one_stroke_ahead"].items():
            told, planned = (
                f"{1e3 * error['position_m']:.3f} mm, {math.degrees(error['heading_rad']):.3f} degrees"
                for error in (errors["told"], errors["planned"])
            )
            lines.append(
                f"one stroke ahead {source:8s} from the true state {told}; from the estimated state {planned}"
            )
        return "\n".join(lines)


def run(config: Ceiling) -> CeilingStudy:
    require_time(config.simulated_time)
    content = read_library(config.library)
    robot = content.robot()
    if config.tables is None:
        require_enough(content)
        with shown(True, "robot's table") as tell:
            own = fit_table(content, "affine", BUDGET_BYTES, tell).image
    else:
        opened = read_image(config.tables)
        opened.require_robot(robot.id)
        if opened.period_us != round(robot.period_s * 1e6) or len(opened.actions) != len(robot.actions):
            raise InputError(
                f"table {config.tables.name!r} has another period or other actions than the robot of library "
                f"{config.library.name!r}: build it from a library of this robot"
            )
        own = opened.image
    images = {NEAREST: quantise(content), AFFINE: own}
    depths = sorted(set(config.depth or (1, 2)))
    limit_s, processes = config.simulated_time, config.processes
    with shown(True, "runs") as tell:
        runs = follow_paths(robot, images, list(SHAPES), depths, config.seeds, limit_s, processes, tell)
    return CeilingStudy(runs, depths, config.seeds, {name: len(image) for name, image in images.items()})


def _by_path(axes: Axes, runs: Sequence[Run], paths: Sequence[str], name: str) -> None:
    """Draw means with 95 % intervals, and a point for each seed; the last group is for all paths."""
    for offset, source in zip((-0.27, 0.0, 0.27), SOURCES, strict=True):
        for place, path in enumerate([*paths, None]):
            mine = [run for run in runs if run.source == source and path in (None, run.path)]
            mean = over_seeds(mine, name) if path is None else mean_of([getattr(r, name) for r in mine])
            axes.bar(place + offset, 1e3 * mean.value, 0.25, color=_COLOUR[source], alpha=0.45)
            axes.errorbar(
                place + offset,
                1e3 * mean.value,
                1e3 * np.nan_to_num(mean.half_width),
                color=_COLOUR[source],
                capsize=3,
            )
            over = sum(not run.completed for run in mine)
            if over:  # the distance of a run that stops early cannot be compared with that of a complete one
                axes.annotate(
                    f"{over} of {len(mine)}\nnot to\nthe end", (place + offset, 0.0), ha="center",
                    va="bottom", fontsize=6, xytext=(0, 2), textcoords="offset points",
                )  # fmt: skip
            if path is not None:
                spread = place + offset + np.linspace(-0.08, 0.08, len(mine))
                axes.plot(spread, [1e3 * getattr(r, name) for r in mine], ".", color=_COLOUR[source], ms=3)
    axes.set_xticks(range(len(paths) + 1), [*paths, "all, by seed"])
    axes.grid(axis="x", visible=False)


def _ahead(axes: Axes, runs: Sequence[Run], name: str, factor: float) -> None:
    for offset, source in zip((-0.27, 0.0, 0.27), SOURCES, strict=True):
        mine = [run for run in runs if run.source == source]
        for place, of in enumerate(("told", "planned")):
            error = factor * rms_error(mine, of)[name]
            axes.bar(place + offset, error, 0.25, color=_COLOUR[source], alpha=0.45)
            axes.annotate(
                f"{error:.2g}", (place + offset, error), ha="center", va="bottom", fontsize=8,
                xytext=(0, 2), textcoords="offset points",
            )  # fmt: skip
    axes.margins(y=0.12)
    axes.set_xticks([0, 1], ["from the true state", "from the estimated state"])
    axes.grid(axis="x", visible=False)
