"""One look for all pictures: one colour for each meaning, units on every axis."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's palette, which colour-blind readers can distinguish.
DESIRED = "#7f7f7f"
TRUE = "#0072b2"
MEASURED = "#e69f00"
ESTIMATED = "#009e73"
PREDICTED = "#cc79a7"
ALARM = "#d55e00"
NOMINAL = "#56b4e9"  # predictions of the nominal model; those of the corrected model have PREDICTED
FLOOR = "#000000"  # error that the noise of the fixes alone causes

POOL_X, POOL_Y = "x in the pool (cm)", "y in the pool (cm)"

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

    matplotlib.use("Agg")
    with matplotlib.rc_context(_SETTINGS):
        yield


def figure_uri(figure: Figure) -> str:
    """The figure as a data URI for an <img>."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120, metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
