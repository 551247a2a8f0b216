"""A tag to print: at true scale, with the arrow that points forward on the robot, and a ruler."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from frogkick.core.errors import InputError
from frogkick.report import style

MARGIN_MM, ABOVE_MM, BELOW_MM, RULER_MM = 15.0, 25.0, 30.0, 50.0
MOST_MM = 250.0
INCH_MM = 25.4
DPI = 600


def tag_figure(cells: npt.NDArray[np.float32], margin: int, size_m: float, name: str) -> Figure:
    """Draw a tag; a page of the figure's size shows it at true scale.

    Args:
        cells: (n, n), 0 black, 1 white, row 0 the picture's top.
        margin: cells outside of the square whose side is the tag's size.
        size_m: that side.
        name: of the tag.

    Raises:
        InputError: a size that fits no page.
    """
    whole = 1e3 * size_m * len(cells) / (len(cells) - 2 * margin)
    if not 1.0 <= whole <= MOST_MM:
        raise InputError(
            f"a tag of {1e3 * size_m:g} mm is {whole:.4g} mm wide with its margin: "
            f"give a size that makes it 1 to {MOST_MM:g} mm"
        )
    width, height = max(whole, RULER_MM) + 2 * MARGIN_MM, whole + ABOVE_MM + BELOW_MM
    with style.styled():
        figure = Figure(figsize=(width / INCH_MM, height / INCH_MM))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0.0, width), ylim=(0.0, height))
        axes.axis("off")
        left, middle = 0.5 * (width - whole), 0.5 * width
        edges = (left, left + whole, BELOW_MM, BELOW_MM + whole)
        axes.imshow(
            cells, cmap="gray", vmin=0.0, vmax=1.0, extent=edges, interpolation="nearest", aspect="auto"
        )
        top = BELOW_MM + whole
        axes.annotate(
            "",
            (middle, top + 12.0),
            (middle, top + 2.0),
            arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 2},
        )
        axes.text(middle, top + 14.0, "forward on the robot", ha="center", va="bottom", fontsize=9)
        ruler = middle - 0.5 * RULER_MM
        axes.plot([ruler, ruler + RULER_MM], [16.0, 16.0], color="black", lw=1.0, solid_capstyle="butt")
        for step in range(0, int(RULER_MM) + 1, 10):
            axes.plot([ruler + step] * 2, [14.5, 17.5], color="black", lw=0.7)
        legend = f"{RULER_MM:g} mm: if it is not, print at 100 %\n{name}, size {1e3 * size_m:g} mm"
        axes.text(middle, 12.0, legend, ha="center", va="top", fontsize=7)
    return figure


def write_tag_page(
    cells: npt.NDArray[np.float32], margin: int, size_m: float, name: str, target: Path
) -> tuple[float, float]:
    """Write that page and return its width and height in m.

    Raises:
        InputError: see ``tag_figure`` and ``style.write_picture``.
    """
    figure = tag_figure(cells, margin, size_m, name)
    style.write_picture(figure, target, dpi=DPI)
    width_in, height_in = figure.get_size_inches()
    return 1e-3 * INCH_MM * float(width_in), 1e-3 * INCH_MM * float(height_in)
