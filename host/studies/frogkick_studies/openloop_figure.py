"""The figure of the open-loop study: measured against predicted speeds, and errors over the frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick_studies.openloop import OpenLoop, Predicted, rmse_by_group

_MARKS = "os^Dv<>P"


def openloop_figure(found: OpenLoop) -> Figure:
    """Draw ``open_loop``: a row for each fit; its test swims, its training swims, and both over frequency."""
    with style.styled():
        rows = len(found.splits)
        figure = Figure(figsize=(13.0, 4.4 * rows + 0.5), layout="constrained")
        panels = figure.subplots(rows, 3, squeeze=False)
        every = [row for split in found.splits for row in (*split.train, *split.test)]
        speeds = [1e3 * r.experiment.reference.speed_mps for r in every]
        speeds += [1e3 * r.experiment.model_mps for r in every] + [1e3 * r.speed_mps for r in every]
        low, high = min(0.0, float(np.nanmin(speeds))), 1.05 * float(np.nanmax(speeds))
        fractions = sorted({row.experiment.case.gait.egain_percent for row in every})
        marks = {percent: _MARKS[place % len(_MARKS)] for place, percent in enumerate(fractions)}
        floor = found.noise.neighbours.get("experiments")
        for (test, train, over), split in zip(panels, found.splits, strict=True):
            _against(test, split.test, marks, (low, high), floor)
            test.set_title(f"Fitted to {split.name}: predicted for others")
            _against(train, split.train, marks, (low, high), floor)
            train.set_title(f"The swims fitted to ({split.name})")
            _over_frequency(over, split.test, marks, floor)
            over.set_title("Error of the predictions over frequency")
    return figure


def _against(
    axes: Axes,
    rows: Sequence[Predicted],
    marks: dict[float, str],
    limits: tuple[float, float],
    floor_mps: float | None,
) -> None:
    axes.plot(limits, limits, color=style.DESIRED, linewidth=0.9)
    if floor_mps is not None:
        wide = 1e3 * floor_mps
        axes.fill_between(
            limits, [limits[0] - wide, limits[1] - wide], [limits[0] + wide, limits[1] + wide],
            color=style.DESIRED, alpha=0.15, linewidth=0.0, label=f"noise floor, {wide:.1f} mm/s",
        )  # fmt: skip
    nominal, effects = (1e3 * rmse_by_group(rows, nominal=plain)["all"] for plain in (True, False))
    for percent, mark in marks.items():
        some = [row for row in rows if row.experiment.case.gait.egain_percent == percent]
        if not some:
            continue
        measured = [1e3 * row.experiment.reference.speed_mps for row in some]
        axes.plot(
            measured, [1e3 * row.experiment.model_mps for row in some], mark, color=style.DESIRED, ms=5,
            fillstyle="none", label=f"nominal, {percent:g} %",
        )  # fmt: skip
        axes.plot(
            measured, [1e3 * row.speed_mps for row in some], mark, color=style.TRUE, ms=5, alpha=0.8,
            label=f"with effects, {percent:g} %",
        )  # fmt: skip
    axes.annotate(
        f"RMSE {nominal:.2f} mm/s nominal,\n{effects:.2f} with effects", (0.03, 0.97),
        xycoords="axes fraction", va="top",
    )  # fmt: skip
    axes.set_xlim(*limits)
    axes.set_ylim(*limits)
    axes.set_aspect("equal")
    axes.set_xlabel("measured speed (mm/s)")
    axes.set_ylabel("speed of the model (mm/s)")
    axes.legend(loc="lower right")


def _over_frequency(
    axes: Axes, rows: Sequence[Predicted], marks: dict[float, str], floor_mps: float | None
) -> None:
    axes.axhline(0.0, color=style.DESIRED, linewidth=0.9)
    if floor_mps is not None:
        axes.axhspan(-1e3 * floor_mps, 1e3 * floor_mps, color=style.DESIRED, alpha=0.15, linewidth=0.0)
    for row in rows:
        gait, nominal, effects = row.experiment.case.gait, row.experiment.error_mps, row.error_mps
        at, mark = gait.frequency_hz, marks[gait.egain_percent]
        axes.plot([at, at], [1e3 * nominal, 1e3 * effects], color=style.DESIRED, linewidth=0.5, alpha=0.6)
        axes.plot(at, 1e3 * nominal, mark, color=style.DESIRED, fillstyle="none", ms=5)
        axes.plot(at, 1e3 * effects, mark, color=style.TRUE, ms=5, alpha=0.8)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel("model less measured (mm/s)")
