"""Effects fitted to the measured open-loop swims of one EGaIn fraction, tested on the others.

A measured swim is one number here: its steady speed. A fraction has some ten to thirty of them, each known to
some 4 mm/s, so few parameters can be told from them, and most effects of the catalogue not at all: what turns
the robot, what fades after the first strokes, what one limb alone does. The candidates are what is left, all
of them the same for every alloy; what differs between alloys is the measured limb profile and nothing else.

A parameter is sought near what physics expects, by how much such a thing may well be off: its distance
counts as one more miss. Effects are taken up one after another, while predicting swims that were left out of
the fit, all of a frequency at a time, gets better by it; the other fractions are not looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear

from frogkick.errors import InputError
from frogkick.robot import Robot
from frogkick.study.noise import Noise, noise_of
from frogkick.study.steady import CANDIDATES, Free, Simulation, Table, expected, tables_of
from frogkick.study.validate import ExperimentResult, Validation, root_mean_square
from frogkick.study.validate import validate as run_validation

FloatArray = NDArray[np.float64]

LEAST_SWIMS = 6
"""Of a fraction, that a fit needs."""

GAIN = 0.03
"""Share by which the error on left-out swims must fall for an effect to be taken up."""

MOST_EFFECTS = 2
TRIED = 1
"""Candidates of a round that are fitted; the others fall behind already where all is taken as linear."""

_SD_MPS = 0.004  # of a measured speed, where the fraction itself does not tell it
_LEAST_SD_MPS = 0.002
_STEP = 0.15  # of a finite difference, in widths: limbs that ring make speeds rough over less
_EDGE = 1e-3  # from a bound, in widths, where a fit may start
_Z95 = 1.96


@dataclass(frozen=True)
class Estimate:
    """A fitted parameter: its value, and between what it lies with 95 %."""

    free: Free
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Fitted:
    """Effects fitted to one fraction's swims.

    Attributes:
        estimates: of all parameters; none where the plain model predicts left-out swims best.
        left_out_mps: RMSE on swims left out of the fit, without effects and after each that was taken up.
        sd_mps: what a measured speed was taken to be known to.
    """

    estimates: tuple[Estimate, ...]
    left_out_mps: tuple[float, ...]
    sd_mps: float

    @property
    def tables(self) -> tuple[Table, ...]:
        """As a robot's TOML has them."""
        return tables_of({estimate.free: estimate.value for estimate in self.estimates})


@dataclass(frozen=True)
class Predicted:
    """A measured swim and its prediction: NaN where the simulation failed."""

    experiment: ExperimentResult
    speed_mps: float

    @property
    def error_mps(self) -> float:
        """Prediction less measurement."""
        return self.speed_mps - self.experiment.reference.speed_mps


@dataclass(frozen=True)
class Split:
    """Fitted on one fraction: predictions of its own swims and of the others'."""

    train_percent: float
    fitted: Fitted
    train: tuple[Predicted, ...]
    test: tuple[Predicted, ...]


@dataclass(frozen=True)
class OpenLoop:
    """All splits of a data folder's measured swims, and what the plain model makes of them."""

    validation: Validation
    noise: Noise
    splits: tuple[Split, ...]


def open_loop(
    robot: Robot,
    folder: Path,
    train: Sequence[float] = (),
    test: Sequence[float] = (),
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> OpenLoop:
    """Fit effects to the swims of one fraction, predict those of others, for each training fraction.

    Args:
        robot: nominal.
        folder: laid out as ``frogkick.study.measured`` says.
        train: EGaIn fractions, per cent, that are fitted to one at a time; by default each at hand that has
            swims enough.
        test: fractions to predict; by default all but that of the fit.
        workers: processes.
        progress: called with (rounds done, at most).

    Raises:
        InputError: no data, a fraction without swims, too few to fit to, or none left to test on.
    """
    validation = run_validation(robot, folder, workers)
    by_fraction = _by_fraction(validation.experiments)
    known = ", ".join(f"{percent:g} % ({len(rows)})" for percent, rows in by_fraction.items()) or "none"
    for percent in (*train, *test):
        if percent not in by_fraction:
            raise InputError(
                f"no measured swim at {percent:g} % EGaIn that has a limb profile: swims are at {known}"
            )
    for percent in train:
        if len(by_fraction[percent]) < LEAST_SWIMS:
            raise InputError(
                f"too few measured swims at {percent:g} % EGaIn: a fit needs {LEAST_SWIMS}, there are {known}"
            )
    trains = list(train) or [percent for percent, rows in by_fraction.items() if len(rows) >= LEAST_SWIMS]
    wanted = {percent: [p for p in (test or by_fraction) if p != percent] for percent in trains}
    if not trains or not all(wanted.values()):
        raise InputError(
            f"measured swims with limb profiles are at {known}: needed are {LEAST_SWIMS} or more at one "
            "EGaIn fraction to fit to, and any at another one to test on"
        )
    splits = []
    for place, percent in enumerate(trains):
        tell = _told(progress, place, len(trains))
        simulation = Simulation(robot, validation.profiles.profiles, workers)
        fitted = fit_fraction(simulation, by_fraction[percent], tell)
        tested = [row for other in wanted[percent] for row in by_fraction[other]]
        rows = [*by_fraction[percent], *tested]
        speeds = simulation.speeds([fitted.tables], [row.case.gait for row in rows])[0]
        predicted = tuple(Predicted(row, float(speed)) for row, speed in zip(rows, speeds, strict=True))
        own = len(rows) - len(tested)
        splits.append(Split(percent, fitted, predicted[:own], predicted[own:]))
    return OpenLoop(validation, noise_of(validation.experiments), tuple(splits))


def _told(
    progress: Callable[[int, int], None] | None, before: int, splits: int
) -> Callable[[int], None] | None:
    if progress is None:
        return None
    return lambda done: progress(before * MOST_EFFECTS + done, splits * MOST_EFFECTS)


def _by_fraction(experiments: Sequence[ExperimentResult]) -> dict[float, list[ExperimentResult]]:
    found: dict[float, list[ExperimentResult]] = {}
    for row in sorted(experiments, key=lambda row: row.case.gait.egain_percent):
        found.setdefault(row.case.gait.egain_percent, []).append(row)
    return found


class _Fit:
    """Fits of some parameters to the swims of a fraction."""

    def __init__(self, simulation: Simulation, rows: Sequence[ExperimentResult]) -> None:
        self.simulation = simulation
        distinct = {(row.case.gait, round(row.reference.speed_mps, 9)): row for row in rows}
        self.rows = sorted(
            distinct.values(), key=lambda row: (row.case.gait.frequency_hz, row.case.gait.phase)
        )
        self.gaits = [row.case.gait for row in self.rows]
        self.measured = np.array([row.reference.speed_mps for row in self.rows])
        self.sd_mps = max(noise_of(self.rows).neighbours.get("experiments", _SD_MPS), _LEAST_SD_MPS)
        self.frequency_hz = np.array([gait.frequency_hz for gait in self.gaits])

    def missed(self, frees: Sequence[Free], points: Sequence[FloatArray]) -> FloatArray:
        """(len(points), n) prediction less measurement in standard deviations; a failed one stands still."""
        tables = [
            tables_of({f: f.value(float(z)) for f, z in zip(frees, point, strict=True)}) for point in points
        ]
        speeds = np.nan_to_num(self.simulation.speeds(tables, self.gaits), nan=0.0)
        return np.asarray((speeds - self.measured) / self.sd_mps)

    def jacobian(self, frees: Sequence[Free], point: FloatArray, first: int = 0) -> FloatArray:
        """(n, p - first) of these, by finite differences that stay within the bounds."""
        high = np.array([free.bounds[1] for free in frees])
        steps = np.where(point + _STEP > high, -_STEP, _STEP)[first:]
        moves = np.eye(len(frees))[first:] * steps[:, None]
        base, *moved = self.missed(frees, [point, *(point + moves)])
        return np.stack([(there - base) / step for there, step in zip(moved, steps, strict=True)], axis=1)

    def fit(self, frees: Sequence[Free], start: FloatArray) -> FloatArray:
        """(p,) likeliest distances from the plain model, in widths."""
        low, high = np.array([free.bounds for free in frees]).T
        found = least_squares(
            lambda z: np.concatenate([self.missed(frees, [z])[0], z - expected(frees)]),
            np.clip(start, low + _EDGE, high - _EDGE),
            jac=lambda z: np.vstack([self.jacobian(frees, z), np.eye(len(frees))]),
            bounds=(low, high),
            ftol=2e-3,
            xtol=1e-2,
            max_nfev=25,
        )
        return np.asarray(found.x)

    def left_out(self, frees: Sequence[Free], point: FloatArray, jacobian: FloatArray) -> float:
        """RMSE, m/s, of swims left out a frequency at a time, all taken as linear about a point."""
        missed = self.missed(frees, [point])[0]
        after = missed.copy()
        low, high = np.array([free.bounds for free in frees]).reshape(-1, 2).T
        for frequency_hz in set(self.frequency_hz.tolist()) if len(frees) else ():
            kept = self.frequency_hz != frequency_hz
            matrix = np.vstack([jacobian[kept], np.eye(len(frees))])
            wanted = -np.concatenate([missed[kept], point - expected(frees)])
            room = (np.minimum(low - point, -1e-9), np.maximum(high - point, 1e-9))
            step = lsq_linear(matrix, wanted, room).x
            after[~kept] = missed[~kept] + jacobian[~kept] @ step
        return self.sd_mps * root_mean_square(after.tolist())


def fit_fraction(
    simulation: Simulation, rows: Sequence[ExperimentResult], told: Callable[[int], None] | None = None
) -> Fitted:
    """Choose and fit effects by the swims of one fraction alone.

    Args:
        rows: measured swims; one that stands in two sweeps counts once.
        told: called with the rounds done.
    """
    fit = _Fit(simulation, rows)
    frees: tuple[Free, ...] = ()
    point, scores = np.empty(0), [fit.left_out((), np.empty(0), np.empty((len(fit.rows), 0)))]
    for taken in range(MOST_EFFECTS):
        best: tuple[float, tuple[Free, ...], FloatArray] | None = None
        for more in _promising(fit, frees, point):
            tried = (*frees, *more)
            if len(tried) > len(fit.rows) // 3:
                continue
            found = fit.fit(tried, _begin(fit, tried, frees, point))
            score = fit.left_out(tried, found, fit.jacobian(tried, found))
            if best is None or score < best[0]:
                best = (score, tried, found)
        if told is not None:
            told(taken + 1)
        if best is None or best[0] > (1.0 - GAIN) * scores[-1]:
            break
        scores.append(best[0])
        _, frees, point = best
    if told is not None:
        told(MOST_EFFECTS)
    return Fitted(tuple(_estimates(fit, frees, point)), tuple(scores), fit.sd_mps)


def _begin(fit: _Fit, tried: Sequence[Free], frees: Sequence[Free], point: FloatArray) -> FloatArray:
    """Where a fit begins: what was found so far, and new ones at the best of their starts."""
    known = dict(zip(frees, point.tolist(), strict=True))
    places = [
        (known[free],) if free in known else tuple(free.expected + start for start in free.starts)
        for free in tried
    ]
    points = [np.array(place) for place in product(*places)]
    costs = [float(missed @ missed) for missed in fit.missed(tried, points)]
    away = [float(np.sum((each - expected(tried)) ** 2)) for each in points]
    return points[int(np.argmin(np.add(costs, away)))]


def _promising(fit: _Fit, frees: tuple[Free, ...], point: FloatArray) -> list[tuple[Free, ...]]:
    """Parameters to add that predict left-out swims best where all is taken as linear about their start."""
    rows = [tuple(free for free in row if free not in frees) for row in CANDIDATES if row[0] not in frees]
    known = fit.jacobian(frees, point) if frees else np.empty((len(fit.rows), 0))
    scored = []
    for more in dict.fromkeys(rows):
        tried = (*frees, *more)
        start = _begin(fit, tried, frees, point)
        new = fit.jacobian(tried, start, len(frees))
        scored.append((fit.left_out(tried, start, np.hstack([known, new])), more))
    return [more for _, more in sorted(scored, key=lambda pair: pair[0])[:TRIED]]


def _estimates(fit: _Fit, frees: tuple[Free, ...], point: FloatArray) -> Iterator[Estimate]:
    """Values with intervals: of the misses' curvature, where these scatter by more than noise by that."""
    if not frees:
        return
    jacobian = fit.jacobian(frees, point)
    missed = fit.missed(frees, [point])[0]
    scatter = max(1.0, float(missed @ missed) / max(len(missed) - len(frees), 1))
    covariance = np.linalg.inv(jacobian.T @ jacobian / scatter + np.eye(len(frees)))
    for free, z, sd in zip(frees, point.tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True):
        yield Estimate(free, free.value(z), free.value(z - _Z95 * sd), free.value(z + _Z95 * sd))


def rmse_by_group(rows: Sequence[Predicted], nominal: bool = False) -> dict[str, float]:
    """RMS error, m/s, over ``all`` and each group of swims that could be simulated."""
    errors: dict[str, list[float]] = {"all": []}
    for row in rows:
        error = row.experiment.error_mps if nominal else row.error_mps
        if math.isfinite(error):
            errors["all"].append(error)
            errors.setdefault(row.experiment.case.group, []).append(error)
    return {group: root_mean_square(values) for group, values in errors.items()}
