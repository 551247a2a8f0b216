"""The picture of measured strokes and the profiles fitted to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from frogkick.report import style
from frogkick.robot.profile import Profile
from frogkick.robot.profile_files import Stroke


def stroke_figure(strokes: Sequence[Stroke], profiles: Sequence[Profile]) -> Figure:
    """Draw each measured stroke and the curve that was fitted to it.

    Args:
        strokes: the measured strokes.
        profiles: the profile fitted to each.
    """
    with style.new_figure(8.0, 1.0 + 2.4 * len(strokes)) as figure:
        rows = figure.subplots(len(strokes), 1, squeeze=False, sharex=True)[:, 0]
        for axes, stroke, profile in zip(rows, strokes, profiles, strict=True):
            time_s = np.linspace(0.0, profile.duration_s, 400)
            axes.plot(stroke.time_s, stroke.curvature_per_m, ".", color=style.TRUE, label="measured")
            axes.plot(time_s, profile.curvature_per_m(time_s), color=style.ALARM, label="fitted")
            axes.set_title(
                f"{stroke.name}: {profile.frequency_hz:.3g} Hz, error {profile.rms_per_m:g} 1/m RMS"
            )
            axes.set_ylabel("curvature (1/m)")
            axes.legend(loc="best")
        rows[-1].set_xlabel("time since the start of the pulse (s)")
    return figure
