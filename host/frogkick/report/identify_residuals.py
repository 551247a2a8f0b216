"""Residuals of one-period predictions on the runs of an identification, in columns, and their views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import AnyArray, Float64, Int64
from frogkick.core.poses import body_from_world, wrap_angle
from frogkick.identification.outcome import Outcome
from frogkick.identification.segments import Segments
from frogkick.identification.steps import whitener
from frogkick.identification.verdict import prediction_errors


@dataclass(frozen=True, eq=False)
class Residuals:
    """Rows are the periods of runs whose end was measured and predicted by both models.

    Poses are in the world frame, m and rad.
    """

    run: Int64  # (n,) index of the run
    period: Int64  # (n,) index of the period in its run
    time_s: Float64  # (n,) start of the period, from the start of its run's first period
    at_s: Float64  # (n,) middle of the period, on the run's clock
    action: Int64  # (n,) index of the action; -1: unknown
    limbs: Int64  # (n, limbs) strokes of each limb in the period
    pose: Float64  # (n, 3) pose at its start
    middle: Float64  # (n, 3) pose at its middle, by the fixes
    velocity: Float64  # (n, 3) forward, left (m/s), turn rate (rad/s) there, body frame, by the fixes
    # (n, 3) pose at its end: from fixes, and predicted without and with effects
    measured: Float64
    nominal: Float64
    found: Float64

    def residual_world(self, which: str) -> Float64:
        """(n, 3) measured minus predicted pose, of the model "nominal" or "found": m, m, rad."""
        gap = self.measured - getattr(self, which)
        gap[:, 2] = wrap_angle(gap[:, 2])
        return np.asarray(gap)

    def residual_body(self, which: str) -> Float64:
        """(n, 3) the same as forward, left (m) and heading (rad), by the heading at the start."""
        return body_from_world(self.pose[:, 2], self.residual_world(which))

    @property
    def explained(self) -> Float64:
        """(n, 3) change of the nominal model's residuals by the effects, body frame."""
        return self.residual_body("nominal") - self.residual_body("found")


def all_residuals(outcome: Outcome) -> Residuals:
    """Return the residuals of an outcome on its training runs and its test runs; ``run`` counts in each."""
    parts = [residuals_of(outcome, train) for train in (True, False)]
    names = Residuals.__dataclass_fields__
    return Residuals(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def pose_at(swim: Segments, at_s: Float64) -> Float64:
    """(n, 3) poses of a run at (n,) times, between its fixes."""
    return np.column_stack([np.interp(at_s, swim.time_s, column) for column in swim.pose.T])


def residuals_of(outcome: Outcome, train: bool = False) -> Residuals:
    """Return the residuals of an outcome on its test runs, or on its training runs."""
    swims, nominal, fitted = outcome.test, outcome.nominal_rollouts, outcome.rollouts
    if train and outcome.found is not None:
        found = outcome.found
        swims, nominal, fitted = outcome.train, found.nominal.rollouts, found.fitted.rollouts
    parts: list[dict[str, AnyArray]] = []
    for k, (swim, plain, full) in enumerate(zip(swims, nominal, fitted, strict=True)):
        errors = (prediction_errors([rollout], [swim]) for rollout in (plain, full))
        kept = np.all([np.isfinite(each).all(axis=1) for each in errors], axis=0)
        limbs = np.zeros((len(swim.start_s), len(outcome.robot.limbs)), dtype=np.int64)
        for time_s, limb in swim.strokes:
            limbs[(swim.start_s <= time_s + 1e-6) & (time_s < swim.end_s - 1e-6), limb] += 1
        middle, early, late = (
            pose_at(swim, first * swim.start_s + (1.0 - first) * swim.end_s) for first in (0.5, 0.75, 0.25)
        )
        rate = (late - early) / (0.5 * (swim.end_s - swim.start_s))[:, None]
        columns = {
            "run": np.full(len(kept), k),
            "period": np.arange(len(kept)),
            "time_s": swim.start_s - swim.start_s[0],
            "at_s": 0.5 * (swim.start_s + swim.end_s),
            "action": swim.action,
            "limbs": limbs,
            # Of the nominal model, because an effect may move the centre of mass away from the tag.
            "pose": plain.start[:, :3],
            "middle": middle,
            "velocity": body_from_world(middle[:, 2], rate),
            "measured": swim.measured,
            "nominal": plain.predicted,
            "found": full.predicted,
        }
        parts.append({name: column[kept] for name, column in columns.items()})
    return Residuals(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def by_limb(residuals: Float64, limbs: Int64) -> tuple[Float64, Float64]:
    """Return the residual of each limb's strokes, and its standard error, by least squares.

    Args:
        residuals: (n, 3).
        limbs: (n, limbs) strokes of each limb; limbs that never fired get NaN.
    """
    fired = limbs.any(axis=0)
    design = np.column_stack([np.ones(len(limbs)), limbs[:, fired]]).astype(np.float64)
    if np.linalg.matrix_rank(design) < design.shape[1]:
        design = design[:, 1:]  # no action rests, so the strokes take the constant too
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


def explained_shares(outcome: Outcome) -> list[tuple[str, float]]:
    """Return how much of the change by the found effects each candidate could explain by itself.

    The shares come from derivatives at the nominal model over the training periods, with whitened residuals.

    Returns:
        (title, share of the sum of squares), largest first, with the found effects; empty without a search.
    """
    found = outcome.found
    if found is None or not outcome.terms or not found.sensitivities:
        return []
    nominal, fitted = found.nominal, found.fitted
    change = fitted.residuals - nominal.residuals
    white = whitener(fitted.residuals)
    flat = (change @ white).ravel()
    best: dict[str, float] = {}
    for column in found.sensitivities:
        by = np.einsum("nip,ij->njp", column.jacobian, white).reshape(flat.size, -1)
        left = flat - by @ np.linalg.lstsq(by, flat, rcond=1e-9)[0]
        share = float(1.0 - (left @ left) / max(flat @ flat, 1e-30))
        best[column.term.title] = max(share, best.get(column.term.title, 0.0))
    return sorted(best.items(), key=lambda row: -row[1])
