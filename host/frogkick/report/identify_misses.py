"""What predictions a period ahead missed on the test runs of an identification, in columns, and its views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frogkick.core.poses import body_from_world, wrap_angle
from frogkick.identification.fit import Fitted
from frogkick.identification.outcome import Outcome
from frogkick.identification.steps import whitener
from frogkick.identification.verdict import prediction_errors

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Misses:
    """Rows are the periods of all test runs whose end was measured and predicted by both models.

    Attributes:
        run: (n,) which of the test runs.
        period: (n,) which of its periods.
        time_s: (n,) when it began, from its run's first period.
        action: (n,) what was done; -1 unknown.
        limbs: (n, limbs) strokes of each limb in it.
        pose: (n, 3) at its start, world frame, m and rad.
        measured, nominal, found: (n, 3) pose at its end: by fixes, as predicted without and with effects.
    """

    run: IntArray
    period: IntArray
    time_s: FloatArray
    action: IntArray
    limbs: IntArray
    pose: FloatArray
    measured: FloatArray
    nominal: FloatArray
    found: FloatArray

    def missed_world(self, which: str) -> FloatArray:
        """(n, 3) measured minus predicted by "nominal" or "found": m, m, rad."""
        gap = self.measured - getattr(self, which)
        gap[:, 2] = wrap_angle(gap[:, 2])
        return np.asarray(gap)

    def missed_body(self, which: str) -> FloatArray:
        """(n, 3) the same forward, left (m) and heading (rad), by the heading at the start."""
        return body_from_world(self.pose[:, 2], self.missed_world(which))


def misses_of(outcome: Outcome) -> Misses:
    """The rows of an outcome."""
    swims = outcome.test
    known = [
        np.isfinite(prediction_errors([rollouts[k]], [swim])).all(axis=1)
        for rollouts in (outcome.nominal_rollouts, outcome.rollouts)
        for k, swim in enumerate(swims)
    ]
    both = [known[k] & known[k + len(swims)] for k in range(len(swims))]
    rows = [np.flatnonzero(each) for each in both]

    def joined(parts: list[FloatArray]) -> FloatArray:
        return np.concatenate([part[kept] for part, kept in zip(parts, rows, strict=True)])

    limbs = []
    for swim in swims:
        counts = np.zeros((len(swim.start_s), len(outcome.robot.limbs)), dtype=np.int64)
        for time_s, limb in swim.strokes:
            counts[(swim.start_s <= time_s + 1e-6) & (time_s < swim.end_s - 1e-6), limb] += 1
        limbs.append(counts)
    return Misses(
        run=np.concatenate([np.full(len(kept), k) for k, kept in enumerate(rows)]),
        period=np.concatenate(rows),
        time_s=joined([swim.start_s - swim.start_s[0] for swim in swims]),
        action=np.concatenate([swim.action[kept] for swim, kept in zip(swims, rows, strict=True)]),
        limbs=np.concatenate([counts[kept] for counts, kept in zip(limbs, rows, strict=True)]),
        # The nominal model's: what was found may have the centre of mass beside the tag that a camera sees.
        pose=joined([rollout.start[:, :3] for rollout in outcome.nominal_rollouts]),
        measured=joined([swim.measured for swim in swims]),
        nominal=joined([rollout.predicted for rollout in outcome.nominal_rollouts]),
        found=joined([rollout.predicted for rollout in outcome.rollouts]),
    )


def by_limb(residuals: FloatArray, limbs: IntArray) -> tuple[FloatArray, FloatArray]:
    """What is missed for each stroke of a limb, and its standard error, by least squares.

    Args:
        residuals: (n, 3).
        limbs: (n, limbs) strokes of each limb; limbs that never fired get NaN.
    """
    fired = limbs.any(axis=0)
    design = np.column_stack([np.ones(len(limbs)), limbs[:, fired]]).astype(np.float64)
    if np.linalg.matrix_rank(design) < design.shape[1]:
        design = design[:, 1:]  # no rest among the actions: the strokes take all
    first = design.shape[1] - int(fired.sum())
    each = np.full((limbs.shape[1], 3), np.nan)
    error = np.full((limbs.shape[1], 3), np.nan)
    inverse = np.linalg.pinv(design.T @ design)
    found = inverse @ design.T @ residuals
    left = residuals - design @ found
    freedom = max(len(residuals) - design.shape[1], 1)
    each[fired] = found[first:]
    error[fired] = np.sqrt(np.outer(np.diag(inverse)[first:], (left**2).sum(axis=0) / freedom))
    return each, error


def mimics(outcome: Outcome) -> list[tuple[str, float]]:
    """Candidates, and what share of the change that the found effects made each could make by itself.

    By derivatives about the nominal model, over the training periods, each miss by its own size.

    Returns:
        (title, share of the squares), most first; what was found is among them; none without a search.
    """
    found = outcome.found
    if found is None or not outcome.terms or not found.sensitivities:
        return []
    nominal, fitted = found.nominal, found.fitted
    change = fitted.residuals - nominal.residuals
    best: dict[str, float] = {}
    for column in found.sensitivities:
        share = _share(fitted, change, column.jacobian)
        best[column.term.title] = max(share, best.get(column.term.title, 0.0))
    return sorted(best.items(), key=lambda row: -row[1])


def _share(fitted: Fitted, change: FloatArray, jacobian: FloatArray) -> float:
    white = whitener(fitted.residuals)
    flat = (change @ white).ravel()
    columns = np.einsum("nip,ij->njp", jacobian, white).reshape(flat.size, -1)
    left = flat - columns @ np.linalg.lstsq(columns, flat, rcond=1e-9)[0]
    return float(1.0 - (left @ left) / max(flat @ flat, 1e-30))
