"""Residual diagnostics: which view of a run tells what predictions miss at the end of a period."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frogkick.identification.fit import Fitted
from frogkick.identification.segments import Segments

FloatArray = NDArray[np.float64]

RHYTHMS, RHYTHM_LEAST = 24, 16
"""Periods of time that are tried on what is left, and misses that this needs."""


def signature(fitted: Fitted, rows: NDArray[np.bool_], swims: Sequence[Segments]) -> dict[str, Any]:
    """Where the misses at the end of periods come from: shares of their squares that each view explains.

    Returns:
        ``shares``: view -> share (adjusted for its freedom); ``strongest``: the view with the most;
        ``by_action``: mean forward, left (m), heading (rad) of each action; ``text``: in words.
    """
    missed = fitted.missed[:, -3:]
    names = swims[0].action_names
    action = np.concatenate([swim.action for swim in swims])[rows]
    previous = np.concatenate([np.append([-1], swim.action[:-1]) for swim in swims])[rows]
    run = np.concatenate([np.full(len(swim.action), k) for k, swim in enumerate(swims)])[rows]
    order = np.concatenate([np.arange(len(swim.action)) for swim in swims])[rows]
    start = np.concatenate([track.start for track in fitted.tracks])[rows]
    clock = np.concatenate([swim.start_s for swim in swims])[rows]
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    world = np.column_stack(
        [c * missed[:, 0] - s * missed[:, 1], s * missed[:, 0] + c * missed[:, 1], missed[:, 2]]
    )
    one = np.ones((len(missed), 1))
    views = {
        "constant, body frame": (missed, one),
        "constant, world frame": (world, one),
        "action": (missed, _dummies(action)),
        "previous action": (missed, np.column_stack([one, _dummies(previous)[:, 1:]])),
        "heading": (missed, np.column_stack([one, np.cos(start[:, 2]), np.sin(start[:, 2])])),
        "velocity at the start": (missed, np.column_stack([one, start[:, 3:6]])),
        "place": (world, _place(start[:, :2])),
        "time in the run": (missed, np.column_stack([one, order, np.exp(-order / 2.0)])),
        "clock": (world, np.column_stack([one, clock - clock.mean()])),
        "run": (missed, _dummies(run)),
    }
    shares = {name: _share(values, design) for name, (values, design) in views.items()}
    shares["rhythm"], rhythm_s = _rhythm(missed, clock)
    by_action = {
        str(names[a]) if a >= 0 else "unknown": {
            "periods": int((action == a).sum()),
            "forward_m": float(missed[action == a, 0].mean()),
            "left_m": float(missed[action == a, 1].mean()),
            "heading_rad": float(missed[action == a, 2].mean()),
        }
        for a in np.unique(action)
    }
    strongest = max(shares, key=lambda name: shares[name])
    size = np.sqrt((missed**2).mean(axis=0))
    text = (
        f"what is left at the end of a period: {1e3 * float(size[0]):.2f} mm forward, "
        f"{1e3 * float(size[1]):.2f} mm left, {np.degrees(float(size[2])):.2f} deg RMS; "
        f"best told by {strongest} ({100 * shares[strongest]:.0f} % of its squares)"
        + (f", of {rhythm_s:.0f} s" if strongest == "rhythm" else "")
        if shares[strongest] > 0.05
        else f"what is left at the end of a period: {1e3 * float(size[0]):.2f} mm forward, "
        f"{1e3 * float(size[1]):.2f} mm left, {np.degrees(float(size[2])):.2f} deg RMS, without a pattern"
    )
    return {"shares": shares, "strongest": strongest, "by_action": by_action, "text": text}


def _place(xy_m: FloatArray) -> FloatArray:
    """(n, 6) polynomial of second degree in a place."""
    x, y = (xy_m - xy_m.mean(axis=0)).T
    return np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])


def _rhythm(values: FloatArray, clock_s: FloatArray) -> tuple[float, float]:
    """Share of what a swing of one period in time explains, and that period in s; the best of many."""
    if len(values) < RHYTHM_LEAST:
        return 0.0, 0.0
    beat_s = float(np.median(np.diff(np.unique(clock_s))))
    found = []
    for period_s in np.geomspace(3.0 * beat_s, max(np.ptp(clock_s), 4.0 * beat_s), RHYTHMS):
        angle = math.tau * clock_s / period_s
        design = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
        # The best of many explains something of pure noise: what that is, is taken off.
        share = _share(values, design) - 2.0 * math.log(RHYTHMS) / len(values)
        found.append((max(share, 0.0), float(period_s)))
    return max(found)


def _dummies(labels: NDArray[np.int64]) -> FloatArray:
    return np.asarray((labels[:, None] == np.unique(labels)[None, :]).astype(np.float64))


def _share(values: FloatArray, design: FloatArray) -> float:
    """Of the squares of three columns, each by its own size, that a design explains; adjusted."""
    count, freedom = len(values), int(np.linalg.matrix_rank(design))
    if count <= freedom + 1:
        return 0.0
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    kept = (left**2).sum(axis=0) / (count - freedom) / np.maximum((values**2).mean(axis=0), 1e-30)
    return float(np.clip(1.0 - kept.mean(), 0.0, 1.0))
