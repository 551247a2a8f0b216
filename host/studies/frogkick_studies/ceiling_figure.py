"""The figure of the ceiling study: what tables cost against the rods themselves, in the loop and ahead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick_studies.ceiling import AFFINE, NEAREST, RODS, SOURCES, Run, mean_of, over_seeds, rms_error

_COLOUR = {NEAREST: style.MEASURED, AFFINE: style.TRUE, RODS: style.ESTIMATED}
_LABEL = {
    NEAREST: "full nearest table (the paper's)",
    AFFINE: "the robot's affine table",
    RODS: "the rods themselves: the ceiling",
}
_MEASURES = (
    ("mean_distance_m", "mean distance to the path (mm)"),
    ("progress_mps", "progress (mm/s)"),
)
_ERRORS = (
    ("position_m", 1e3, "position error (mm)"),
    ("heading_rad", 180.0 / np.pi, "heading error (degrees)"),
)


def ceiling_figure(runs: Sequence[Run]) -> Figure:
    """Draw ``follow_paths``: distance and progress by path and depth, and errors one period ahead."""
    paths = list(dict.fromkeys(run.path for run in runs))
    depths = sorted({run.depth for run in runs})
    with style.styled():
        figure = Figure(figsize=(4.6 * (len(depths) + 1), 6.4), layout="constrained")
        panels = figure.subplots(2, len(depths) + 1, squeeze=False)
        for column, depth in enumerate(depths):
            here = [run for run in runs if run.depth == depth]
            for row, (name, label) in enumerate(_MEASURES):
                axes = panels[row, column]
                _by_path(axes, here, paths, name)
                axes.set_ylabel(label)
                axes.set_ylim(0.0, 1.06e3 * max(getattr(run, name) for run in runs))
            panels[0, column].set_title(f"Looking {depth} {'stroke' if depth == 1 else 'strokes'} ahead")
        for axes, (name, factor, label) in zip(panels[:, -1], _ERRORS, strict=True):
            _ahead(axes, runs, name, factor)
            axes.set_ylabel(label)
        panels[0, -1].set_title("Error one stroke ahead, RMS of all decisions")
        handles = [panels[0, 0].plot([], [], "s", color=_COLOUR[s], label=_LABEL[s])[0] for s in SOURCES]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(SOURCES))
    return figure


def _by_path(axes: Axes, runs: Sequence[Run], paths: Sequence[str], name: str) -> None:
    """Bars of means with their 95 % intervals; a point for each seed. The last group is over all paths."""
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
            if over:  # a run that stops early can stay near its path: its distance is not to be compared
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
    axes.set_xticks([0, 1], ["asked of the true state", "as planned, from fixes"])
    axes.grid(axis="x", visible=False)
