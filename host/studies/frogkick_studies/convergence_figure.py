"""The error of the rod simulation against its time step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick_studies.convergence import ERROR_LIMIT, Curve


def convergence_figure(curves: Sequence[Curve], default_step_s: float) -> Figure:
    """Draw the curves of ``convergence`` with a second-order slope, the default step and the limit."""
    with style.styled():
        figure = Figure(figsize=(6.4, 4.6), layout="constrained")
        axes = figure.subplots()
        for curve, colour, marker in zip(curves, (style.TRUE, style.MEASURED), "os", strict=False):
            step_ms = 1e3 * curve.step_s
            axes.loglog(
                step_ms,
                100 * curve.error,
                marker + "-",
                color=colour,
                label=f"{curve.name}: RMS, order {curve.order:.2f}",
            )
            axes.loglog(step_ms, 100 * curve.worst, marker + ":", color=colour, label=f"{curve.name}: worst")
        first = curves[0]
        guide = first.error[-1] * (first.step_s / first.step_s[-1]) ** 2
        axes.loglog(1e3 * first.step_s, 50 * guide, "--", color=style.DESIRED, label="slope 2")
        axes.axvline(1e3 * default_step_s, color=style.ESTIMATED, linewidth=1)
        axes.axhline(100 * ERROR_LIMIT, color=style.ALARM, linewidth=1)
        axes.text(1e3 * default_step_s, axes.get_ylim()[0] * 1.3, " default", color=style.ESTIMATED)
        axes.text(
            1e3 * first.step_s.max(),
            85 * ERROR_LIMIT,
            "limit at the default step",
            color=style.ALARM,
            ha="right",
            va="top",
        )
        axes.set_xticks(1e3 * np.sort(first.step_s), [f"{ms:g}" for ms in 1e3 * np.sort(first.step_s)])
        axes.minorticks_off()
        axes.set_xlabel("finest time step (ms)")
        axes.set_ylabel("error of distance or speed (%)")
        axes.set_title("Error of the rod simulation against its time step")
        axes.legend(loc="upper left")
    return figure
