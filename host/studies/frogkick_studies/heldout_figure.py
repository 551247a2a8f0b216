"""Errors on runs kept back, run by run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick_studies.heldout import HeldOut


def heldout_figure(rows: Sequence[HeldOut]) -> Figure:
    """Left: position, right: heading, a period ahead; nominal, with what the others show, noise floor."""
    place = np.arange(len(rows))[::-1]
    with style.styled():
        figure = Figure(figsize=(11.0, 1.9 + 0.42 * len(rows)), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, field, scale, what in (
            (panels[0], "position_rmse_m", 1e3, "position missed, mm RMS"),
            (panels[1], "heading_rmse_rad", math.degrees(1.0), "heading missed, degrees RMS"),
        ):
            before, after, floor = (
                [scale * getattr(getattr(row, name), field) for row in rows]
                for name in ("before", "after", "floor")
            )
            axes.barh(place + 0.19, before, 0.36, color=style.NOMINAL, label="nominal model")
            axes.barh(place - 0.19, after, 0.36, color=style.PREDICTED, label="with what the other runs show")
            axes.vlines(
                floor,
                place - 0.4,
                place + 0.4,
                color=style.FLOOR,
                linewidth=1.5,
                label="noise of the fixes alone",
            )
            axes.set_xlim(0.0, None)
            axes.set_xlabel(f"{what}, a period ahead")
        panels[0].set_yticks(place, [row.run.stem for row in rows])
        panels[0].set_ylabel("run kept back")
        panels[0].set_title("Position")
        panels[1].set_title("Heading")
        panels[0].legend(loc="upper left", bbox_to_anchor=(0.0, -0.75 / figure.get_figheight()), ncols=3)
    return figure
