"""The figure of the closed-loop study: distance to the path and progress, by path and planner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.report.style import ALARM, ESTIMATED, MEASURED, PREDICTED, TRUE, styled
from frogkick.study.loop import Case, Outcome

_COLOURS = (MEASURED, ALARM, PREDICTED, ESTIMATED, TRUE)
_MEASURES = (("mean_distance_m", "mean distance to the path, mm"), ("progress_mps", "progress, mm/s"))


def loop_figure(
    outcomes: Mapping[Case, Outcome], worlds: Sequence[str], paths: Sequence[str], planners: Sequence[str]
) -> Figure:
    """A column for each world; each run a point, each box the middle half of the seeds.

    Args:
        outcomes: the study's.
        worlds, paths, planners: names, in the order to draw them.
    """
    with styled():
        figure = Figure(figsize=(1.0 + 5.2 * len(worlds), 6.4), layout="constrained")
        axes = figure.subplots(2, len(worlds), squeeze=False, sharey="row", sharex=True)
        for column, world in enumerate(worlds):
            for row, (name, label) in enumerate(_MEASURES):
                _draw(axes[row, column], outcomes, name, (world, paths, planners))
                axes[row, column].set_ylabel(label if column == 0 else "")
            axes[0, column].set_title(f"world: {world}")
            axes[0, column].set_yscale("symlog", linthresh=1.0, linscale=0.4)
            axes[0, column].set_yticks([0, 1, 2, 5, 10, 20, 50, 100, 200])
            axes[0, column].set_yticklabels(["0", "1", "2", "5", "10", "20", "50", "100", "200"])
            axes[0, column].set_ylim(0.0, 400.0)
            axes[1, column].set_ylim(bottom=0.0)
            axes[1, column].set_xticks(range(len(paths)), paths)
        handles = [
            axes[0, 0].plot([], [], "s", color=_COLOURS[index % len(_COLOURS)], label=planner)[0]
            for index, planner in enumerate(planners)
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(planners))
    return figure


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
            values = np.array(
                [
                    1e3 * getattr(outcome, name)
                    for case, outcome in outcomes.items()
                    if (case.world, case.path, case.planner) == (world, path, planner)
                ]
            )
            if not values.size:
                continue
            at = place + (index - 0.5 * (len(planners) - 1)) * width
            colour = _COLOURS[index % len(_COLOURS)]
            low, middle, high = np.percentile(values, [25, 50, 75])
            axes.bar(at, high - low, width * 0.85, low, color=colour, alpha=0.35, linewidth=0)
            axes.plot([at - 0.42 * width, at + 0.42 * width], [middle, middle], color=colour, linewidth=2)
            spread = np.linspace(-0.3, 0.3, values.size) * width
            axes.plot(at + spread, values, ".", color=colour, markersize=3)
