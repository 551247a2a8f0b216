"""What limb use as an input is worth, as bars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick_studies.history import HistoryResult

_BARS = (
    ("restarted", "limbs at rest in the library", style.DESIRED),
    ("without", "limbs amid strokes, use no input", style.MEASURED),
    ("with_use", "limb use as an input", style.TRUE),
)
_PANELS = (
    ("position_m", 1e3, "position error (mm)"),
    ("heading_rad", 180.0 / np.pi, "heading error (degrees)"),
)


def history_figure(results: Sequence[HistoryResult]) -> Figure:
    """Draw ``history_worth``: errors one period ahead of three tables for each robot."""
    with style.styled():
        figure = Figure(figsize=(9.0, 3.8), layout="constrained")
        places = np.arange(len(results))
        for axes, (name, factor, label) in zip(figure.subplots(1, 2), _PANELS, strict=True):
            for offset, (table, text, colour) in zip((-0.27, 0.0, 0.27), _BARS, strict=True):
                heights = [factor * getattr(result, table)[name] for result in results]
                bars = axes.bar(places + offset, heights, 0.25, color=colour, label=text)
                axes.bar_label(bars, [f"{height:.2g}" for height in heights], fontsize=7.5, padding=1)
            axes.set_yscale("log")
            axes.set_xticks(places, [_wrapped(result.variant) for result in results])
            axes.set_ylabel(label)
            axes.set_title(f"Affine tables of 64 KiB: {label.split(' (')[0]}")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _wrapped(text: str) -> str:
    words = text.split(" ")
    half = (len(words) + 1) // 2
    return " ".join(words[:half]) + "\n" + " ".join(words[half:])
