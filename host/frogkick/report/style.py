"""The common style of all figures: one colour for each meaning, units on every axis."""

from __future__ import annotations

import base64
import html
import io
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frogkick.core.errors import InputError
from frogkick.core.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from frogkick.core.arrays import Float64

# Okabe and Ito's palette, which colour-blind readers can distinguish.
DESIRED = "#7f7f7f"
TRUE = "#0072b2"
MEASURED = "#e69f00"
ESTIMATED = "#009e73"
PREDICTED = "#cc79a7"
ALARM = "#d55e00"
NOMINAL = "#56b4e9"  # predictions of the nominal model; those of the corrected model use PREDICTED
FLOOR = "#000000"  # error that the noise of the fixes alone causes

PICTURES = {".png": "Software", ".svg": "Date", ".pdf": "CreationDate"}
"""Ending of a picture's file -> the field of its metadata that would differ between runs."""

TO_SCALE: Any = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
"""Options of arrows that are as long as their values on the axes."""

_SETTINGS: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.hashsalt": "frogkick",
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the common style, whatever the user's own settings are, and without a screen."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_SETTINGS)
        yield


@contextmanager
def _any_letters() -> Iterator[None]:
    """Draw a file's name without a warning if the font lacks one of its letters, which becomes a box."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        yield


@contextmanager
def new_figure(width_in: float, height_in: float) -> Iterator[Figure]:
    """Yield a figure with an automatic layout, to draw on in the common style."""
    from matplotlib.figure import Figure

    with styled():
        yield Figure(figsize=(width_in, height_in), layout="constrained")


def pool_axes(axes: Axes) -> None:
    """Set equal scales, and the labels of positions in the pool in cm."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x in the pool (cm)")
    axes.set_ylabel("y in the pool (cm)")


def arrow(
    axes: Axes, start: Sequence[float] | Float64, end: Sequence[float] | Float64, **options: Any
) -> None:
    """Draw an arrow between two points; options are those of matplotlib's ``arrowprops``."""
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops={"arrowstyle": "-|>", **options})


def plain_decades(axis: Axis) -> None:
    """Label a logarithmic axis with 1, 2, 5, 10 instead of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def look(**options: Any) -> dict[str, Any]:
    """Return drawing options, to share them between calls."""
    return options


def round_factor(wanted: float) -> float:
    """Return the largest of 1, 2 and 5 times powers of ten that is not above the wanted factor."""
    factor = 10.0 ** math.floor(math.log10(wanted))
    return float(factor * (5.0 if wanted > 5.0 * factor else 2.0 if wanted > 2.0 * factor else 1.0))


def legend_below(figure: Figure, axes: Axes, columns: int = 5) -> None:
    """Draw the legend of one panel below all panels."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns)


def write_picture(figure: Figure, target: Path, ending: str = "", dpi: int = 120) -> None:
    """Write a figure into a file, by its ending or another one; the same figure gives the same bytes.

    Raises:
        InputError: an unknown kind, or a place that cannot be written.
    """
    ending = ending or target.suffix.lower()
    if ending not in PICTURES:
        raise InputError(f"picture {str(target)!r} does not end in {' or '.join(PICTURES)}: choose one")
    content = io.BytesIO()  # on a full disk the writer of PDF would raise an error of its own
    with styled(), _any_letters():
        figure.savefig(content, format=ending[1:], dpi=dpi, metadata={PICTURES[ending]: None})
    write_bytes(target, content.getvalue())


def png_of(figure: Figure) -> bytes:
    """Return a new figure as a PNG. A layout that was drawn once may come out differently the next time."""
    buffer = io.BytesIO()
    with styled(), _any_letters():
        figure.savefig(buffer, format="png", dpi=120, metadata={"Software": None})
    return buffer.getvalue()


def figure_uri(figure: Figure | bytes) -> str:
    """Return a new figure, or its PNG, as a data URI for an <img>."""
    png = figure if isinstance(figure, bytes) else png_of(figure)
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def page_of(title: str, rows: Mapping[str, Any], figure: Any = None) -> str:
    """Return the HTML of an object in a notebook: name, values, below a matplotlib figure if there is one."""
    texts = {name: f"{each:.4g}" if isinstance(each, float) else str(each) for name, each in rows.items()}
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in texts.items()
    )
    picture = ""
    if figure is not None:
        picture = f"<img style='max-width:100%' alt='{html.escape(title)}' src='{figure_uri(figure)}'>"
    return f"<div><b>{html.escape(title)}</b><table>{cells}</table>{picture}</div>"
