"""The figure of the closed-loop study: distance to the path and progress, by path and planner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isnan, nan
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from frogkick.report.style import ALARM, ESTIMATED, MEASURED, PREDICTED, TRUE, styled
from frogkick_studies.kept import Case, Outcome

_COLOURS = (MEASURED, ALARM, PREDICTED, ESTIMATED, TRUE)
_SWUM_MMPS = 50  # no faster does it swim
_PROGRESS_TICKS_MMPS = (0, 10, 20, 30, 40, 50, 500)
_DISTANCE_TICKS_MM = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)


def loop_figure(
    outcomes: Mapping[Case, Outcome],
    worlds: Sequence[str],
    paths: Sequence[str],
    planners: Sequence[str],
    recorded: Mapping[str, tuple[float, float]] | None = None,
) -> Figure:
    """A column for each world; each run a point, a bar the middle half of the seeds, a line their median.

    Args:
        outcomes: the study's.
        worlds, paths, planners: names, in the order to draw them; the first planner is the paper's, half of
            whose mean distance is drawn beside the others' where nothing is recorded.
        recorded: path -> mean distance (m) and progress (m/s) of a recorded run, drawn across.
    """
    with styled():
        wide = max(5.2, 1.2 * len(paths))
        figure = Figure(figsize=(1.6 + wide * len(worlds), 7.0), layout="constrained")
        axes = figure.subplots(2, len(worlds), squeeze=False, sharey="row", sharex=True)
        for column, world in enumerate(worlds):
            _draw(axes[0, column], outcomes, "mean_distance_m", (world, paths, planners))
            _draw(axes[1, column], outcomes, "progress_mps", (world, paths, planners))
            if recorded is None:
                _draw_half(axes[0, column], outcomes, (world, paths, planners))
            else:
                _draw_across(axes[0, column], [recorded.get(path, (nan, nan))[0] for path in paths])
                _draw_across(axes[1, column], [recorded.get(path, (nan, nan))[1] for path in paths])
            axes[0, column].set_title(f"world: {world}")
            axes[1, column].set_xticks(range(len(paths)), paths)
            axes[1, column].set_xlim(-0.5, len(paths) - 0.5)
            for edge in range(1, len(paths)):
                for row in (0, 1):
                    axes[row, column].axvline(edge - 0.5, color="black", alpha=0.15, linewidth=0.8)
        for row in (0, 1):
            for one in axes[row]:
                one.grid(axis="x", visible=False)
        axes[0, 0].set_ylabel("mean distance to the path (mm)")
        axes[1, 0].set_ylabel("progress along the path (mm/s)")
        drawn = list((recorded or {}).values())
        drawn += [(outcome.mean_distance_m, outcome.progress_mps) for outcome in outcomes.values()]
        farthest_mm, fastest_mmps = (1e3 * max(one[which] for one in drawn) for which in (0, 1))
        slowest_mmps = min(1e3 * outcome.progress_mps for outcome in outcomes.values())
        axes[0, 0].set_yscale("symlog", linthresh=1.0, linscale=0.4)
        axes[0, 0].set_yticks(_DISTANCE_TICKS_MM, [str(tick) for tick in _DISTANCE_TICKS_MM])
        axes[0, 0].set_ylim(-0.1, 1.4 * max(farthest_mm, 1.0))
        axes[0, 0].minorticks_off()
        if fastest_mmps > _SWUM_MMPS:  # a run that took the path's end for its start
            axes[1, 0].set_yscale("symlog", linthresh=_SWUM_MMPS, linscale=4.0)
            axes[1, 0].set_yticks(_PROGRESS_TICKS_MMPS, [str(tick) for tick in _PROGRESS_TICKS_MMPS])
            axes[1, 0].minorticks_off()
        axes[1, 0].set_ylim(min(0.0, 1.08 * slowest_mmps), max(1.08 * fastest_mmps, 1.0))
        handles: list[Any] = [
            axes[0, 0].plot([], [], "s", color=_COLOURS[index % len(_COLOURS)], label=planner)[0]
            for index, planner in enumerate(planners)
        ]
        dashed = f"half of {planners[0]}'s" if recorded is None else "recorded run"
        if recorded != {}:
            handles += axes[0, 0].plot([], [], "--", color="black", linewidth=1, label=dashed)
        figure.legend(handles=handles, loc="outside upper center", ncols=min(3, len(handles)))
    return figure


def _values(
    outcomes: Mapping[Case, Outcome], name: str, world: str, path: str, planner: str
) -> npt.NDArray[np.float64]:
    """Of each seed, in mm or mm/s."""
    return np.array(
        [
            1e3 * getattr(outcome, name)
            for case, outcome in outcomes.items()
            if (case.world, case.path, case.planner) == (world, path, planner)
        ]
    )


def _draw_half(
    axes: Any, outcomes: Mapping[Case, Outcome], which: tuple[str, Sequence[str], Sequence[str]]
) -> None:
    world, paths, planners = which
    values = [_values(outcomes, "mean_distance_m", world, path, planners[0]) for path in paths]
    _draw_across(axes, [0.5e-3 * one.mean() if one.size else nan for one in values])


def _draw_across(axes: Any, values: Sequence[float]) -> None:
    """Draw a dashed line for each path, of a value in SI units; NaN: none."""
    for place, value in enumerate(values):
        if not isnan(value):
            axes.plot([place - 0.45, place + 0.45], [1e3 * value] * 2, "--", color="black", linewidth=1)


def _draw(
    axes: Any,
    outcomes: Mapping[Case, Outcome],
    name: str,
    which: tuple[str, Sequence[str], Sequence[str]],
) -> None:
    world, paths, planners = which
    width = 0.8 / len(planners)
    for place, path in enumerate(paths):
        for index, planner in enumerate(planners):
            values = _values(outcomes, name, world, path, planner)
            if not values.size:
                continue
            at = place + (index - 0.5 * (len(planners) - 1)) * width
            colour = _COLOURS[index % len(_COLOURS)]
            low, middle, high = np.percentile(values, [25, 50, 75])
            axes.bar(at, high - low, width * 0.85, low, color=colour, alpha=0.35, linewidth=0)
            axes.plot([at - 0.42 * width, at + 0.42 * width], [middle, middle], color=colour, linewidth=2)
            spread = np.linspace(-0.3, 0.3, values.size) * width if values.size > 1 else 0.0
            axes.plot(at + spread, values, ".", color=colour, markersize=3)
