"""The error map of a calibrated camera: the position error at each place of the pool."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from frogkick.report import style


def write_error_map(
    pool_m: tuple[float, float], places: npt.NDArray[np.float64], title: str, target: Path
) -> None:
    """Draw an arrow at each place, long enough to be visible; colour and key give its length in mm.

    Args:
        pool_m: length, width.
        places: (n, 4) x_m, y_m in the pool's frame, error_x_mm, error_y_mm; NaN errors: not found.
        title: one line.
        target: picture to write.
    """
    found = places[np.isfinite(places[:, 2])]
    lost = places[~np.isfinite(places[:, 2])]
    with style.new_figure(8.0, 1.4 + 6.6 * pool_m[1] / pool_m[0]) as figure:
        axes = figure.subplots()
        axes.plot(
            1e3 * pool_m[0] * np.array([0, 1, 1, 0, 0]),
            1e3 * pool_m[1] * np.array([0, 0, 1, 1, 0]),
            color=style.DESIRED,
            lw=2.0,
        )
        if len(found):
            length = np.hypot(found[:, 2], found[:, 3])
            # The longest arrow is a tenth of the pool; the key says what that is in mm.
            scale = max(float(length.max()), 1e-6) / (0.1 * 1e3 * pool_m[0])
            arrows = axes.quiver(
                *(1e3 * found[:, :2].T), *found[:, 2:].T, length,
                angles="xy", scale_units="xy", scale=scale, cmap="viridis", width=0.004,
                clim=(0, length.max()),
            )  # fmt: skip
            axes.plot(*(1e3 * found[:, :2].T), ".", color=style.TRUE, ms=3)
            figure.colorbar(arrows, ax=axes, label="error (mm)", shrink=0.85)
            axes.quiverkey(
                arrows,
                0.88,
                1.04,
                float(length.max()),
                f"{length.max():.3f} mm",
                labelpos="E",
                fontproperties={"size": 8},
            )
        if len(lost):
            axes.plot(*(1e3 * lost[:, :2].T), "x", color=style.ALARM, ms=8, mew=2, label="not found")
            axes.legend(loc="lower right")
        axes.set_aspect("equal")
        axes.margins(0.12)
        axes.set_xlabel("x (mm), pool")
        axes.set_ylabel("y (mm), pool")
        axes.set_title(title)
    style.write_picture(figure, target)
