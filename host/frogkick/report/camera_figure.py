"""The error map of a calibrated camera, and the page with the tag to print."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.arrays import Float32, Float64
from frogkick.core.errors import InputError
from frogkick.report import style


def write_error_map(pool_m: tuple[float, float], places: Float64, title: str, target: Path) -> None:
    """Draw an arrow at each place, long enough to be visible; colour and key give its length in mm.

    ``places`` are (n, 4) x_m, y_m in the pool's frame, error_x_mm, error_y_mm; NaN errors: not found.
    """
    found = places[np.isfinite(places[:, 2])]
    lost = places[~np.isfinite(places[:, 2])]
    with style.new_figure(8.0, 1.4 + 6.6 * pool_m[1] / pool_m[0]) as figure:
        axes = figure.subplots()
        corners_mm = 1e3 * np.array(pool_m) * [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
        axes.plot(*corners_mm.T, color=style.DESIRED, lw=2.0)
        if len(found):
            length = np.hypot(found[:, 2], found[:, 3])
            longest = float(length.max())
            # The longest arrow is a tenth of the pool; the key says what that is in mm.
            scale = max(longest, 1e-6) / (0.1 * 1e3 * pool_m[0])
            look = {**style.TO_SCALE, "scale": scale, "cmap": "viridis", "width": 0.004, "clim": (0, longest)}
            arrows = axes.quiver(*(1e3 * found[:, :2].T), *found[:, 2:].T, length, **look)
            axes.plot(*(1e3 * found[:, :2].T), ".", color=style.TRUE, ms=3)
            figure.colorbar(arrows, ax=axes, label="error (mm)", shrink=0.85)
            key = style.look(labelpos="E", fontproperties={"size": 8})
            axes.quiverkey(arrows, 0.88, 1.04, longest, f"{longest:.3f} mm", **key)
        if len(lost):
            axes.plot(*(1e3 * lost[:, :2].T), "x", color=style.ALARM, ms=8, mew=2, label="not found")
            axes.legend(loc="lower right")
        axes.set_aspect("equal")
        axes.margins(0.12)
        axes.set(xlabel="x (mm), pool", ylabel="y (mm), pool", title=title)
    style.write_picture(figure, target)


MARGIN_MM, ABOVE_MM, BELOW_MM, RULER_MM = 15.0, 25.0, 30.0, 50.0
MOST_MM = 250.0
INCH_MM = 25.4
DPI = 600


def write_tag_page(
    cells: Float32, margin: int, size_m: float, name: str, target: Path
) -> tuple[float, float]:
    """Draw a tag on a page that shows it at true scale, and return the page's width and height in m.

    Args:
        cells: (n, n), 0 black, 1 white, row 0 the picture's top.
        margin: cells outside of the square whose side is the tag's size.

    Raises:
        InputError: a size that fits no page; see also ``style.write_picture``.
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
        look = style.look(cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest", aspect="auto")
        axes.imshow(cells, extent=edges, **look)
        top = BELOW_MM + whole
        style.arrow(axes, (middle, top + 2.0), (middle, top + 12.0), color="black", lw=2)
        axes.text(middle, top + 14.0, "forward on the robot", ha="center", va="bottom", fontsize=9)
        ruler = middle - 0.5 * RULER_MM
        axes.plot([ruler, ruler + RULER_MM], [16.0, 16.0], color="black", lw=1.0, solid_capstyle="butt")
        for step in range(0, int(RULER_MM) + 1, 10):
            axes.plot([ruler + step] * 2, [14.5, 17.5], color="black", lw=0.7)
        legend = f"{RULER_MM:g} mm: if it is not, print at 100 %\n{name}, size {1e3 * size_m:g} mm"
        axes.text(middle, 12.0, legend, ha="center", va="top", fontsize=7)
    style.write_picture(figure, target, dpi=DPI)
    width_in, height_in = figure.get_size_inches()
    return 1e-3 * INCH_MM * float(width_in), 1e-3 * INCH_MM * float(height_in)
