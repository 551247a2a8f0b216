"""Errors of tables against their size and against the size of the library."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from frogkick.report import style
from frogkick_studies.table_size import KIB, TablePoint, TableSizes

_COLOUR = {"nearest": style.MEASURED, "affine": style.TRUE}
_MARKER = {"nearest": "o", "affine": "s"}
_NOISE = {"position_m": (0.2e-3, "0.2 mm"), "heading_rad": (np.deg2rad(0.2), "0.2°")}
_UNIT = {
    "position_m": (1e3, "position error (mm)"),
    "heading_rad": (180.0 / np.pi, "heading error (degrees)"),
}


def table_size_figure(sizes: TableSizes) -> Figure:
    """Draw ``table_sizes``: two errors against bytes, and the position error against library states."""
    with style.styled():
        figure = Figure(figsize=(11.0, 4.4), layout="constrained")
        panels = figure.subplots(1, 3)
        for axes, name in zip(panels, _UNIT, strict=False):
            for kind in _COLOUR:
                points = [p for p in sizes.by_size if p.kind == kind]
                _curve(axes, points, [p.bytes / KIB for p in points], name)
            axes.axvline(64, color=style.DESIRED, linewidth=0.8, linestyle=":")
            axes.text(
                66, 0.99, "64 KiB", color=style.DESIRED, va="top", fontsize=7.5,
                transform=axes.get_xaxis_transform(),
            )  # fmt: skip
            axes.set_xlabel("table image (KiB)")
            _finish(axes, name)
        panels[0].set_title("Error one period ahead, by table size")
        panels[1].set_title("The same for the heading")
        nearest = [p for p in sizes.by_size if p.kind == "nearest"]
        for points in (nearest, list(sizes.by_library)):
            _curve(panels[2], points, [p.library_states for p in points], "position_m")
        panels[2].set_xlabel("states of the library (each times all actions)")
        panels[2].set_title("By library size (affine: 64 KiB)")
        _finish(panels[2], "position_m")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _curve(axes: Axes, points: Sequence[TablePoint], along: Sequence[float], name: str) -> None:
    factor = _UNIT[name][0]
    for tested, line, fill in (("box", "-", "full"), ("visited", "--", "none")):
        kind = points[0].kind
        axes.loglog(
            along,
            [factor * getattr(p, tested)[name] for p in points],
            _MARKER[kind] + line,
            color=_COLOUR[kind],
            fillstyle=fill,
            markersize=4.5,
            linewidth=1.2,
            label=f"{kind}, unseen states {'of the box' if tested == 'box' else 'of swims'}",
        )


def _finish(axes: Axes, name: str) -> None:
    factor, label = _UNIT[name]
    noise, text = _NOISE[name]
    axes.axhline(factor * noise, color=style.ALARM, linewidth=1)
    axes.text(
        0.99, factor * noise * 1.06, f"measurement's noise, {text}", color=style.ALARM, ha="right",
        va="bottom", fontsize=7.5, transform=axes.get_yaxis_transform(),
    )  # fmt: skip
    axes.set_ylabel(label)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
