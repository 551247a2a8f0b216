"""The forward speed between frames, and the lag of the motion after a label."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frogkick.core.poses import body_from_world

Float64 = NDArray[np.float64]


def forward_speed(
    time_s: Float64, pose: Float64, usable: NDArray[np.bool_]
) -> tuple[Float64, Float64, Float64]:
    """Start and end (s) of all pairs of successive usable frames, and (k,) speed along the heading, m/s."""
    rows = np.flatnonzero(usable)
    start, end = time_s[rows[:-1]], time_s[rows[1:]]
    step = np.diff(pose[rows], axis=0)
    along = body_from_world(pose[rows[1:], 2], step)[:, 0]
    return start, end, along / np.maximum(end - start, 1e-3)


def motion_lag(time_s: Float64, pose: Float64, usable: NDArray[np.bool_], fired_s: Float64) -> float | None:
    """Time from a label to the onset of forward motion, s; None with too few frames.

    The forward speed around all strokes is fitted by a line (the glide) plus a ramp from the onset on,
    averaged over the interval of each pair of frames. The result is uncertain: other windows and glide models
    gave 0.05 to 0.12 s for the same run. Stroke times come from the labels alone.

    Args:
        time_s, pose, usable: the frames, (n,), (n, 3), (n,).
        fired_s: (k,) s, start of the actions that fire.
    """
    if usable.sum() < 2 or not fired_s.size:
        return None
    start, end, speed = forward_speed(time_s, pose, usable)
    nearest = fired_s[np.abs(0.5 * (start + end)[:, None] - fired_s[None, :]).argmin(axis=1)]
    a, b = start - nearest, end - nearest
    used = (a > -0.25) & (b < 0.20) & (b - a < 0.15)
    if used.sum() < 20:
        return None
    a, b, speed = a[used], b[used], speed[used]
    candidates = np.arange(-0.05, 0.15, 0.002)
    errors = []
    for onset in candidates:
        ramp = (np.maximum(b - onset, 0.0) ** 2 - np.maximum(a - onset, 0.0) ** 2) / (2.0 * (b - a))
        design = np.column_stack([np.ones_like(ramp), 0.5 * (a + b), ramp])
        errors.append(float(((design @ np.linalg.lstsq(design, speed, rcond=None)[0] - speed) ** 2).sum()))
    return float(candidates[int(np.argmin(errors))])
