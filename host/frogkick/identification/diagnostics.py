"""Residual diagnostics: which explanatory variable accounts for the residuals at the ends of periods."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.core.poses import world_from_body
from frogkick.identification.fit import Fitted
from frogkick.identification.segments import Segments

PERIODOGRAM_PERIODS, PERIODOGRAM_COUNT_MIN = 24, 16
"""Periods of the periodogram of the residuals, and the residuals that it needs at least."""


def residual_diagnostics(fitted: Fitted, rows: Bool, swims: Sequence[Segments]) -> dict[str, Any]:
    """Shares of the squared residuals at the ends of periods that each explanatory variable accounts for.

    Returns:
        ``shares``: variable -> share (adjusted for degrees of freedom); ``strongest``: the one with the most;
        ``by_action``: mean forward, left (m), heading (rad) of each action; ``text``: in words.
    """
    residuals = fitted.residuals[:, -3:]
    names = swims[0].action_names
    action = np.concatenate([swim.action for swim in swims])[rows]
    previous = np.concatenate([np.append([-1], swim.action[:-1]) for swim in swims])[rows]
    run = np.concatenate([np.full(len(swim.action), k) for k, swim in enumerate(swims)])[rows]
    order = np.concatenate([np.arange(len(swim.action)) for swim in swims])[rows]
    start = np.concatenate([rollout.start for rollout in fitted.rollouts])[rows]
    clock = np.concatenate([swim.start_s for swim in swims])[rows]
    world = world_from_body(start[:, 2], residuals)
    one = np.ones((len(residuals), 1))
    views = {
        "constant, body frame": (residuals, one),
        "constant, world frame": (world, one),
        "action": (residuals, _dummies(action)),
        "previous action": (residuals, np.column_stack([one, _dummies(previous)[:, 1:]])),
        "heading": (residuals, np.column_stack([one, np.cos(start[:, 2]), np.sin(start[:, 2])])),
        "velocity at the start": (residuals, np.column_stack([one, start[:, 3:6]])),
        "place": (world, _place(start[:, :2])),
        "time in the run": (residuals, np.column_stack([one, order, np.exp(-order / 2.0)])),
        "clock": (world, np.column_stack([one, clock - clock.mean()])),
        "run": (residuals, _dummies(run)),
    }
    shares = {name: _share(values, design) for name, (values, design) in views.items()}
    shares["rhythm"], cycle_s = _periodogram(residuals, clock)
    by_action = {
        str(names[a]) if a >= 0 else "unknown": {
            "periods": int((action == a).sum()),
            "forward_m": float(residuals[action == a, 0].mean()),
            "left_m": float(residuals[action == a, 1].mean()),
            "heading_rad": float(residuals[action == a, 2].mean()),
        }
        for a in np.unique(action)
    }
    strongest = max(shares, key=lambda name: shares[name])
    size = np.sqrt((residuals**2).mean(axis=0))
    rhythm = f", with a period of {cycle_s:.0f} s" if strongest == "rhythm" else ""
    pattern = (
        f"; best explained by {strongest} ({100 * shares[strongest]:.0f} % of the sum of squares){rhythm}"
        if shares[strongest] > 0.05
        else ", without a pattern"
    )
    text = (
        f"residuals at the end of a period: {1e3 * float(size[0]):.2f} mm forward, "
        f"{1e3 * float(size[1]):.2f} mm left, {np.degrees(float(size[2])):.2f} deg RMS{pattern}"
    )
    return {"shares": shares, "strongest": strongest, "by_action": by_action, "text": text}


def _place(xy_m: Float64) -> Float64:
    """(n, 6) polynomial of second degree in the position."""
    x, y = (xy_m - xy_m.mean(axis=0)).T
    return np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])


def _periodogram(values: Float64, clock_s: Float64) -> tuple[float, float]:
    """Largest share of a periodogram, less the share by chance, and its period, s."""
    if len(values) < PERIODOGRAM_COUNT_MIN:
        return 0.0, 0.0
    beat_s = float(np.median(np.diff(np.unique(clock_s))))
    found = []
    for period_s in np.geomspace(3.0 * beat_s, max(np.ptp(clock_s), 4.0 * beat_s), PERIODOGRAM_PERIODS):
        angle = math.tau * clock_s / period_s
        design = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
        # The best of many periods explains a part of pure noise, which is subtracted.
        share = _share(values, design) - 2.0 * math.log(PERIODOGRAM_PERIODS) / len(values)
        found.append((max(share, 0.0), float(period_s)))
    return max(found)


def _dummies(labels: Int64) -> Float64:
    return np.asarray((labels[:, None] == np.unique(labels)[None, :]).astype(np.float64))


def _share(values: Float64, design: Float64) -> float:
    """Share of the sum of squares of three scaled columns that a design explains: adjusted R^2."""
    count, freedom = len(values), int(np.linalg.matrix_rank(design))
    if count <= freedom + 1:
        return 0.0
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    kept = (left**2).sum(axis=0) / (count - freedom) / np.maximum((values**2).mean(axis=0), 1e-30)
    return float(np.clip(1.0 - kept.mean(), 0.0, 1.0))
