"""Limbs that misfire by chance: which ones, how often, and at which strokes.

The density of a residual is a mixture; see host/docs/pages/explanation/identification.md. Which stroke fails
next cannot be predicted, so a prediction assumes the likelier case, and the mixture shows in the log score.

Source: Dempster, Laird, Rubin 1977 (mixtures by expectation maximisation).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Bool, Float64, Int64
from frogkick.effects.limbs import WeakenedLimb
from frogkick.identification.bootstrap import drawn_periods
from frogkick.identification.calibrated import end_errors
from frogkick.identification.fit import (
    CONFOUNDED_MARGIN,
    DIVERGED,
    EFFECT_PENALTY,
    PARAMETER_PENALTY,
    Fitted,
    Model,
    residuals_of,
    rollouts_of,
)
from frogkick.identification.predict import Rollout
from frogkick.identification.responses import Values, rollouts_with
from frogkick.identification.segments import Data, Segments
from frogkick.identification.steps import DOF, deviance_of, log_density, scale_of
from frogkick.identification.terms import Interval, Term, law_term

CHANCES = (0.01, 0.7)
"""Smallest and largest probability of a misfire: a limb that mostly does nothing is worn."""

FAILED_LEAST = 2.0  # smallest expected number of failed strokes of a limb: a single one is an outlier
LIMBS_MOST = 3  # largest number of limbs that misfire
TURNS = 200  # largest number of iterations of the expectation maximisation
STARTS = (0.1, 0.35)  # probabilities that the expectation maximisation starts from
DRAWS = 200  # resamples of periods for the stability selection

PATTERN = 25.0
"""Failures follow a rule if a split of the strokes lowers the deviance by more; by chance the best split
gains 10."""

PROFILE = 3.84  # rise of the deviance at the ends of an interval of 95 % (profile likelihood)

_LEAST = np.tile([2e-5, 2e-5, 2e-4], 3)  # m, m, rad: discretisation error, the smallest scale


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture fitted to residuals."""

    chance: Float64  # (k,) probability of a misfire of each limb
    scale: Float64  # (d, d) scale matrix of the Student-t density
    failed: Float64  # (n, k) probability that each stroke failed
    score: Float64  # (n,) log density of each residual

    @property
    def deviance(self) -> float:
        """Minus twice the log likelihood."""
        return -2.0 * float(self.score.sum())


@dataclass(frozen=True, eq=False)
class Misfires:
    """Limbs that misfire beside a model."""

    base: Fitted  # the fitted model without misfires
    limbs: tuple[str, ...]  # names of the limbs
    indices: tuple[int, ...]  # indices of the limbs
    chance: list[Interval]  # probability of a misfire of each limb
    scale: Float64  # scale matrix of the residuals at the ends of periods, by the mixture
    # for each limb, (run, time_s, probability that it did nothing) of each stroke
    failed: list[list[tuple[str, float, float]]]
    stability: list[float]  # share of resamples in which each limb is accepted
    confounded_with: list[list[str]]  # for each limb, the limbs that explain nearly as much in its place
    deviance: float  # penalised deviance of the residuals by the mixture

    @property
    def terms(self) -> tuple[Term, ...]:
        """A law for each limb."""
        return tuple(_term(limb, each.value) for limb, each in zip(self.limbs, self.chance, strict=True))

    def scores(self, swims: Sequence[Segments], rows: Sequence[Bool]) -> list[Float64]:
        """Log density of the residuals at the ends of each run's used periods, by the mixture."""
        (rollouts,) = rollouts_of([self.base.model], swims)
        every = _ends(self.base.model, self.indices, swims, rollouts)
        chance = np.array([each.value for each in self.chance])
        return [
            _log_sum(_joint(ends[row], changes[row], fired[row], chance, self.scale))
            for ends, changes, fired, row in zip(*every, rows, strict=True)
        ]

    def patterned(self, strokes: Values) -> bool:
        """Whether strokes fail by a rule and not by chance.

        They do if failures are clearly more frequent on one side of some time, place, heading or other
        quantity; for ``strokes`` see ``Responses.fired``.
        """
        for limb, strokes_failed in zip(self.indices, self.failed, strict=True):
            fails = np.array([share > 0.5 for *_, share in strokes_failed], dtype=np.float64)
            fired = np.isfinite(np.asarray(strokes["time_s"])[:, limb])
            for name, values in strokes.items():
                column = np.broadcast_to(values, (len(fired), np.shape(strokes["time_s"])[1]))[fired, limb]
                views = [np.cos(column), np.sin(column)] if name == "heading_rad" else [column]
                if max(_split_gain(view, fails) for view in views) > PATTERN:
                    return True
        return False


def misfires_of(base: Fitted, data: Data, changes: Float64 | None = None) -> Misfires | None:
    """Select limbs that misfire by forward selection; None if no limb explains more than chance.

    Args:
        changes: (n, 9, l) change of the residuals if a limb does nothing; None: simulated here.
    """
    model, swims, replicates = base.model, data.swims, data.replicate_count
    limbs = range(len(model.robot.limbs))
    if changes is None:
        moved = rollouts_with(model, [[WeakenedLimb(limb, 0.0) for limb in limbs] for _ in swims], swims)
        plain = residuals_of(moved[0], data.rows)
        changes = np.stack([residuals_of(each, data.rows) - plain for each in moved[1:]], axis=2)
    changes = changes.copy()
    changes[(np.abs(changes) > 0.5 * DIVERGED[:, None]).any(axis=(1, 2))] = 0.0  # a simulation failed
    times = data.used(swim.fired_s(len(limbs)) for swim in swims)
    fired = np.isfinite(times)
    least = deviance_of(base.residuals)
    taken: list[int] = []
    scores = [log_density(base.residuals, scale_of(base.residuals))]
    confounded: list[list[str]] = []
    best: Mixture | None = None
    while len(taken) < LIMBS_MOST:
        tried = []
        for limb in limbs:
            if limb not in taken and fired[:, limb].sum() > 4:
                some = [*taken, limb]
                mixture = fitted_mixture(base.residuals, changes[:, :, some], fired[:, some])
                failed = mixture.failed[:, -1].sum()
                if mixture.chance.max() < CHANCES[1] and failed >= FAILED_LEAST:
                    tried.append((mixture.deviance, limb, mixture))
        if not tried:
            break
        tried.sort(key=lambda row: row[0])
        deviance, limb, mixture = tried[0]
        if (least - deviance) / replicates < EFFECT_PENALTY + PARAMETER_PENALTY:
            break
        confounded.append(
            [
                _title(model.robot.limbs[other].name)
                for rival, other, _ in tried[1:]
                if rival < deviance + CONFOUNDED_MARGIN * replicates
            ]
        )
        taken.append(limb)
        least, best = deviance, mixture
        scores.append(mixture.score)
    if best is None:
        return None
    names = [model.robot.limbs[limb].name for limb in taken]
    chance = [
        Interval("failing", float(best.chance[k]), *_interval(best, base, changes, fired, taken, k), "1")
        for k in range(len(taken))
    ]
    failed = [
        [
            (swims[run].name, float(time_s), round(float(share), 4))
            for run, time_s, share in zip(data.run, times[:, limb], best.failed[:, k], strict=True)
            if math.isfinite(time_s)
        ]
        for k, limb in enumerate(taken)
    ]
    every = _ends(model, taken, swims, base.rollouts)
    ends, moves, commanded = np.concatenate(every[0]), np.concatenate(every[1]), np.concatenate(every[2])
    known = np.isfinite(ends).all(axis=1)
    mixed = fitted_mixture(ends[known], moves[known], commanded[known], best.chance)
    return Misfires(
        base,
        tuple(names),
        tuple(taken),
        chance,
        mixed.scale,
        failed,
        _stability(scores, data.run, replicates),
        confounded,
        least + (EFFECT_PENALTY + PARAMETER_PENALTY) * len(taken),
    )


def fitted_mixture(
    residuals: Float64, changes: Float64, fired: Bool, chance: Float64 | None = None
) -> Mixture:
    """The maximum-likelihood mixture, by expectation maximisation from several starts.

    Args:
        residuals: (n, d) residuals of a model in which all strokes happen.
        changes: (n, d, k) change of the residuals if a limb does nothing.
        fired: (n, k) whether a limb was commanded to fire.
        chance: (k,) known probabilities; None: they are estimated.
    """
    if chance is not None:
        return _maximised(residuals, changes, fired, chance, False)
    starts = [np.full(changes.shape[2], start) for start in STARTS]
    every = [_maximised(residuals, changes, fired, start, True) for start in starts]
    return min(every, key=lambda mixture: mixture.deviance)


def _maximised(residuals: Float64, changes: Float64, fired: Bool, chance: Float64, free: bool) -> Mixture:
    count, width = residuals.shape
    which = np.array(list(itertools.product((0.0, 1.0), repeat=changes.shape[2])))
    every = residuals[None] + np.einsum("hk,nik->hni", which, changes)
    # Start from the hypothesis with the smallest residual, in units of the median residuals.
    size = np.median(np.abs(residuals), axis=0) + _LEAST[:width]
    nearest = ((every / size) ** 2).sum(axis=2).argmin(axis=0)
    scale = scale_of(every[nearest, np.arange(count)])
    before = math.inf
    for _ in range(TURNS):
        each = _joint(residuals, changes, fired, chance, scale)
        score = _log_sum(each)
        share = np.exp(each - score)
        failed = np.einsum("hn,hk->nk", share, which)
        deviance = -2.0 * float(score.sum())
        if before - deviance < 1e-4:
            break
        before = deviance
        if free:
            chance = np.clip(failed.sum(axis=0) / np.maximum(fired.sum(axis=0), 1), *CHANCES)
        white = np.linalg.solve(np.linalg.cholesky(scale), every.reshape(-1, width).T)
        weight = share * ((DOF + width) / (DOF + (white**2).sum(axis=0))).reshape(share.shape)
        scale = np.einsum("hn,hni,hnj->ij", weight, every, every) / count + np.diag(_LEAST[:width] ** 2)
    return Mixture(chance, scale, failed, score)


def _joint(residuals: Float64, changes: Float64, fired: Bool, chance: Float64, scale: Float64) -> Float64:
    """(h, n) log of prior times density of each hypothesis, one for each combination of limbs that fail."""
    found = []
    for row in itertools.product((False, True), repeat=changes.shape[2]):
        fails = np.array(row)
        prior = np.where(fired, np.log(np.where(fails, chance, 1.0 - chance)), np.where(fails, -np.inf, 0.0))
        density = log_density(residuals + changes @ fails.astype(np.float64), scale)
        found.append(prior.sum(axis=1) + density)
    return np.array(found)


def _log_sum(each: Float64) -> Float64:
    most = each.max(axis=0)
    return np.asarray(most + np.log(np.exp(each - most).sum(axis=0)))


def _interval(
    best: Mixture, base: Fitted, changes: Float64, fired: Bool, taken: Sequence[int], k: int
) -> tuple[float, float]:
    """Interval of a probability by its profile likelihood, at the fitted scale."""
    tried = np.linspace(*CHANCES, 160)
    deviances = []
    for value in tried:
        chance = best.chance.copy()
        chance[k] = value
        each = _joint(base.residuals, changes[:, :, list(taken)], fired[:, list(taken)], chance, best.scale)
        deviances.append(-2.0 * float(_log_sum(each).sum()))
    inside = tried[np.array(deviances) <= best.deviance + PROFILE]
    own = float(best.chance[k])
    return min([own, *inside.tolist()]), max([own, *inside.tolist()])


def _split_gain(values: Float64, fails: Float64) -> float:
    """Fall of the deviance if values below and above the best threshold have different probabilities."""
    order = np.argsort(values, kind="stable")
    bounds = np.flatnonzero(np.diff(values[order]) > 1e-9) + 1
    if not len(bounds):
        return 0.0
    total, count = np.cumsum(fails[order]), len(fails)

    def deviance(failed: Float64, of: Float64) -> Float64:
        share = np.clip(failed / of, 1e-9, 1.0 - 1e-9)
        return np.asarray(-2.0 * (failed * np.log(share) + (of - failed) * np.log1p(-share)))

    low, below = total[bounds - 1], np.asarray(bounds, dtype=np.float64)
    parts = deviance(low, below) + deviance(total[-1] - low, np.asarray(count - below))
    return float((deviance(total[-1:], np.array([float(count)])) - parts).max())


def _stability(scores: Sequence[Float64], runs: Int64, replicates: int) -> list[float]:
    rng = np.random.default_rng(0)
    accepted = np.zeros(len(scores) - 1)
    for _ in range(DRAWS):
        drawn = drawn_periods(runs, rng)
        for k in range(len(accepted)):
            gain = 2.0 * float((scores[k + 1] - scores[k])[drawn].sum()) / replicates
            accepted[k] += gain > EFFECT_PENALTY + PARAMETER_PENALTY
    return [float(each) for each in accepted / DRAWS]


def _ends(
    model: Model, limbs: Sequence[int], swims: Sequence[Segments], rollouts: Sequence[Rollout]
) -> tuple[list[Float64], list[Float64], list[Bool]]:
    """Residuals (m, 3) of each run at the ends of periods, their change (m, 3, k) if a limb does nothing, and
    (m, k) whether the limb was commanded to fire."""
    moved = rollouts_with(model, [[WeakenedLimb(limb, 0.0) for limb in limbs] for _ in swims], swims)
    ends = [[end_errors(rollout, swim) for rollout, swim in zip(each, swims, strict=True)] for each in moved]
    changes = [
        np.nan_to_num(np.stack([each[run] - ends[0][run] for each in ends[1:]], axis=2))
        for run in range(len(swims))
    ]
    fired = [np.isfinite(swim.fired_s(len(model.robot.limbs))[:, list(limbs)]) for swim in swims]
    plain = [end_errors(rollout, swim) for rollout, swim in zip(rollouts, swims, strict=True)]
    return plain, changes, fired


def without_failed(swims: Sequence[Segments], found: Misfires) -> list[Segments]:
    """The runs without the strokes that probably failed."""
    gone = {
        (run, limb, time_s)
        for limb, strokes in zip(found.indices, found.failed, strict=True)
        for run, time_s, share in strokes
        if share > 0.5
    }
    return [
        replace(swim, strokes=tuple(row for row in swim.strokes if (swim.name, row[1], row[0]) not in gone))
        for swim in swims
    ]


def _title(limb: str) -> str:
    return f"misfire {limb}"


def _term(limb: str, chance: float) -> Term:
    declared = {"failing": {"unit": "1", "low": 0.0, "high": 1.0, "nominal": 0.0, "step": 0.1}}
    table = {"on": "stroke", "limb": limb, "gain": "chance >= failing"}
    return law_term("misfire", table, declared, (chance,))
