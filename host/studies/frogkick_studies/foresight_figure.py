"""The figure of the foresight study: how near plans of a whole run stay, and which way they take."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from frogkick.paths import Path
from frogkick.report import style
from frogkick_studies.foresight import Foreseen


def foresight_figure(path: Path, plans: Sequence[Foreseen]) -> Figure:
    """Draw ``foresee``: ways of the fastest and the nearest plan, and distance against progress of all."""
    with style.styled():
        figure = Figure(figsize=(10.0, 4.2), layout="constrained")
        way, trade = figure.subplots(1, 2, width_ratios=(3, 2))
        way.plot(*(1e3 * path.points_m.T), color=style.DESIRED, lw=2.5, label="path")
        for plan, colour, name in (
            (plans[0], style.ALARM, "fastest"),
            (plans[-1], style.PREDICTED, "nearest"),
        ):
            label = f"{name}: {1e3 * plan.mean_distance_m:.1f} mm off, {1e3 * plan.progress_mps:.1f} mm/s"
            way.plot(*(1e3 * plan.poses_world[:, :2].T), ".-", ms=3, color=colour, label=label)
        way.set_aspect("equal", adjustable="datalim")
        way.set_xlabel("x (mm), pool")
        way.set_ylabel("y (mm), pool")
        way.set_title("The way of two plans, by the table")
        way.legend(loc="best")
        trade.plot(
            [1e3 * plan.progress_mps for plan in plans],
            [1e3 * plan.mean_distance_m for plan in plans],
            "o-",
            color=style.PREDICTED,
        )
        trade.set_ylim(bottom=0.0)
        trade.set_xlabel("progress along the path (mm/s)")
        trade.set_ylabel("mean distance to the path (mm)")
        trade.set_title("No plan found is below the line")
    return figure
