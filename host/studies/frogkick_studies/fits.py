"""Effects fitted to some groups of measured open-loop swims, and tested on the held-out groups.

A measured swim is one number here: its steady speed. A fraction has some ten to thirty swims, each measured
to some 4 mm/s, so the data determine few parameters. They do not determine most effects of the catalogue at
all: those that turn the robot, fade after the first strokes, or act on one limb. The candidates are the other
effects, equal for all alloys; alloys differ only by their measured limb profiles. Each parameter has a prior
around its physically expected value.

The method is forward selection: effects are added while they improve the prediction of held-out swims by more
than the sampling error. Whole groups are held out, because swims of one alloy or of neighbouring frequencies
share their errors: each EGaIn fraction (if there are several), and each of three frequency bands. An effect
must improve both; otherwise the nominal model is kept. The test swims are not used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from frogkick.core.arrays import Bool, Float64
from frogkick.robot import Robot
from frogkick.validation.validate import ExperimentResult, SpeedNoise, Validation, noise_of, root_mean_square
from frogkick.validation.validate import validate as run_validation
from frogkick_studies.steady import (
    CANDIDATES,
    Free,
    Simulation,
    Table,
    expected,
    gain_of,
    groupings,
    splits_of,
    tables_of,
)

MOST_EFFECTS = 2
TRIED = 1
"""Number of candidates of an iteration that are fitted, the best by a linearised estimate."""

_SD_MPS = 0.004  # of a measured speed, if the swims of a fraction do not determine it
_LEAST_SD_MPS = 0.002
_STEP = 0.15  # of a finite difference, in widths: limbs that ring make speeds rough over less
_EDGE = 1e-3  # from a bound, in widths, where a fit may start
_Z95 = 1.96


@dataclass(frozen=True)
class Estimate:
    """A fitted parameter: its value, and its 95 % interval."""

    free: Free
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Iteration:
    """An iteration of the forward selection.

    Attributes:
        gains: way of grouping -> decrease of the mean square error on left-out swims, m^2/s^2, and its 95 %
            interval.
        taken: whether the predictions improve in every way of grouping.
    """

    parameters: tuple[str, ...]
    gains: Mapping[str, tuple[float, float, float]]
    taken: bool


@dataclass(frozen=True)
class Fitted:
    """Effects fitted to some swims.

    Attributes:
        estimates: all parameters; empty if no effect improves the prediction of left-out groups.
        left_out_mps: RMSE on swims left out of the fit, without effects and after each accepted one.
        sd_mps: assumed standard deviation of a measured speed.
        iterations: the iterations, in order.
    """

    estimates: tuple[Estimate, ...]
    left_out_mps: tuple[float, ...]
    sd_mps: float
    iterations: tuple[Iteration, ...] = ()

    @property
    def tables(self) -> tuple[Table, ...]:
        """The effects, as in a robot's TOML file."""
        return tables_of({estimate.free: estimate.value for estimate in self.estimates})


@dataclass(frozen=True)
class Predicted:
    """A measured swim and its prediction; NaN if the simulation failed."""

    experiment: ExperimentResult
    speed_mps: float

    @property
    def error_mps(self) -> float:
        """Prediction minus measurement."""
        return self.speed_mps - self.experiment.reference.speed_mps


@dataclass(frozen=True)
class Split:
    """A fit to some groups: predictions of its training swims and of its test swims.

    Attributes:
        kind: way of grouping: ``egain``, ``frequency`` or ``folder``.
    """

    kind: str
    name: str
    fitted: Fitted
    train: tuple[Predicted, ...]
    test: tuple[Predicted, ...]


@dataclass(frozen=True)
class OpenLoop:
    """All splits of measured swims.

    Attributes:
        validation: the nominal model on the (training) folder.
        noise: of measured speeds, in the folder that is tested on.
    """

    validation: Validation
    noise: SpeedNoise
    splits: tuple[Split, ...]


def open_loop(
    robot: Robot,
    folder: Path,
    train: Sequence[float] = (),
    test: Sequence[float] = (),
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
    test_folder: Path | None = None,
) -> OpenLoop:
    """Fit effects to some groups of measured swims, and predict the others.

    Without ``train``, ``test`` and ``test_folder`` each EGaIn fraction and each frequency band is left out
    once, if enough swims remain.

    Args:
        folder: data with the layout of ``frogkick.validation.measured``.
        train: EGaIn fractions, per cent, to fit to one at a time; with ``test_folder`` together.
        test: fractions to predict; by default all but that of the fit, with ``test_folder`` all.
        test_folder: a second folder; the fit uses ``folder`` and the test this one, each with its own limb
            profiles.
    """
    validation = run_validation(robot, folder, workers)
    other = validation if test_folder is None else run_validation(robot, test_folder, workers)
    plans = splits_of(validation.experiments, other.experiments, train, test, test_folder is not None)
    splits = []
    for place, (kind, name, own, tested) in enumerate(plans):
        simulation = Simulation(robot, validation.profiles.profiles, workers)

        def tell(done: int, before: int = place * MOST_EFFECTS) -> None:
            progress(before + done, len(plans) * MOST_EFFECTS)

        fitted = fit_rows(simulation, own, tell)
        there = simulation
        if test_folder is not None:
            there = Simulation(robot, other.profiles.profiles, workers)
        splits.append(
            Split(kind, name, fitted, _predicted(simulation, fitted, own), _predicted(there, fitted, tested))
        )
    return OpenLoop(validation, noise_of(other.experiments), tuple(splits))


def _predicted(
    simulation: Simulation, fitted: Fitted, rows: Sequence[ExperimentResult]
) -> tuple[Predicted, ...]:
    speeds = simulation.speeds([fitted.tables], [row.case.gait for row in rows])[0]
    return tuple(Predicted(row, float(speed)) for row, speed in zip(rows, speeds, strict=True))


class _Fit:
    def __init__(
        self, simulation: Simulation, rows: Sequence[ExperimentResult], sd_mps: float | None = None
    ) -> None:
        self.simulation = simulation
        distinct = {(row.case.gait, round(row.reference.speed_mps, 9)): row for row in rows}
        self.rows = sorted(
            distinct.values(), key=lambda row: (row.case.gait.frequency_hz, row.case.gait.phase)
        )
        self.gaits = [row.case.gait for row in self.rows]
        self.measured = np.array([row.reference.speed_mps for row in self.rows])
        known = noise_of(self.rows).neighbours.get("experiments", _SD_MPS) if sd_mps is None else sd_mps
        self.sd_mps = max(known, _LEAST_SD_MPS)
        self.groupings = groupings(self.rows)

    def residuals(self, frees: Sequence[Free], points: Sequence[Float64]) -> Float64:
        """Return (len(points), n) residuals, prediction minus measurement in standard deviations; 0 m/s
        for a failure."""
        tables = [
            tables_of({f: f.value(float(z)) for f, z in zip(frees, point, strict=True)}) for point in points
        ]
        speeds = np.nan_to_num(self.simulation.speeds(tables, self.gaits), nan=0.0)
        return np.asarray((speeds - self.measured) / self.sd_mps)

    def jacobian(self, frees: Sequence[Free], point: Float64, first: int = 0) -> Float64:
        """Return (n, p - first) derivatives by finite differences within the bounds."""
        high = np.array([free.bounds[1] for free in frees])
        steps = np.where(point + _STEP > high, -_STEP, _STEP)[first:]
        moves = np.eye(len(frees))[first:] * steps[:, None]
        base, *moved = self.residuals(frees, [point, *(point + moves)])
        return np.stack([(there - base) / step for there, step in zip(moved, steps, strict=True)], axis=1)

    def fit(self, frees: Sequence[Free], start: Float64) -> Float64:
        """Return (p,) maximum a posteriori values, in widths from the nominal model."""
        from scipy.optimize import least_squares

        low, high = np.array([free.bounds for free in frees]).T
        found = least_squares(
            lambda z: np.concatenate([self.residuals(frees, [z])[0], z - expected(frees)]),
            np.clip(start, low + _EDGE, high - _EDGE),
            jac=lambda z: np.vstack([self.jacobian(frees, z), np.eye(len(frees))]),
            bounds=(low, high),
            ftol=2e-3,
            xtol=1e-2,
            max_nfev=25,
        )
        return np.asarray(found.x)

    def folds(self, way: str) -> Iterator[Bool]:
        """Yield the mask of training swims for each group of a way of grouping."""
        label = np.array(self.groupings[way])
        for group in sorted(set(self.groupings[way])):
            yield label != group

    def roughly_left_out(self, frees: Sequence[Free], point: Float64, jacobian: Float64) -> float:
        """Return the RMSE, m/s, of left-out groups in the worst way of grouping, linearised about a point."""
        from scipy.optimize import lsq_linear

        residuals = self.residuals(frees, [point])[0]
        low, high = np.array([free.bounds for free in frees]).reshape(-1, 2).T
        room = (np.minimum(low - point, -1e-9), np.maximum(high - point, 1e-9))
        errors = []
        for way in self.groupings:
            after = residuals.copy()
            for kept in self.folds(way):
                matrix = np.vstack([jacobian[kept], np.eye(len(frees))])
                wanted = -np.concatenate([residuals[kept], point - expected(frees)])
                after[~kept] = residuals[~kept] + jacobian[~kept] @ lsq_linear(matrix, wanted, room).x
            errors.append(root_mean_square(after.tolist()))
        return self.sd_mps * max(errors)

    def left_out(self, frees: Sequence[Free]) -> dict[str, Float64]:
        """Return way of grouping -> (n,) residuals, m/s, of swims by fits without their group."""
        if not len(frees):
            plain = self.sd_mps * self.residuals((), [np.empty(0)])[0]
            return dict.fromkeys(self.groupings, plain)
        found = {}
        for way in self.groupings:
            errors = np.empty(len(self.rows))
            for kept in self.folds(way):
                rows = [row for row, its in zip(self.rows, kept, strict=True) if its]
                part = _Fit(self.simulation, rows, self.sd_mps)
                point = part.fit(frees, _begin(part, frees, (), np.empty(0)))
                errors[~kept] = self.sd_mps * self.residuals(frees, [point])[0][~kept]
            found[way] = errors
        return found


def fit_rows(
    simulation: Simulation,
    rows: Sequence[ExperimentResult],
    progress: Callable[[int], None] = lambda _done: None,
) -> Fitted:
    """Choose and fit effects from some swims.

    Args:
        rows: measured swims; one that belongs to two sweeps counts once.
        progress: called with the number of iterations done.
    """
    fit = _Fit(simulation, rows)
    frees: tuple[Free, ...] = ()
    point, errors = np.empty(0), fit.left_out(())
    scores, iterations = [_worst(errors)], []
    for taken in range(MOST_EFFECTS):
        best: tuple[float, tuple[Free, ...], dict[str, Float64]] | None = None
        for more in _promising(fit, frees, point):
            tried = (*frees, *more)
            if len(tried) > len(fit.rows) // 3:
                continue
            after = fit.left_out(tried)
            if best is None or _worst(after) < best[0]:
                best = (_worst(after), tried, after)
        progress(taken + 1)
        if best is None:
            break
        gains = {way: gain_of(errors[way], best[2][way]) for way in errors}
        wins = bool(gains) and all(low > 0.0 for _, low, _ in gains.values())
        iterations.append(Iteration(tuple(free.name for free in best[1]), gains, wins))
        if not wins:
            break
        _, frees, errors = best
        scores.append(_worst(errors))
        point = fit.fit(frees, _begin(fit, frees, (), np.empty(0)))
    progress(MOST_EFFECTS)
    return Fitted(tuple(_estimates(fit, frees, point)), tuple(scores), fit.sd_mps, tuple(iterations))


def _worst(errors: Mapping[str, Float64]) -> float:
    """Return the RMSE of the way of grouping in which it is largest; NaN if all swims are of one group."""
    return max((root_mean_square(each.tolist()) for each in errors.values()), default=math.nan)


def _begin(fit: _Fit, tried: Sequence[Free], frees: Sequence[Free], point: Float64) -> Float64:
    """Return the starting point of a fit: known values, and new ones at the best of their starts."""
    known = dict(zip(frees, point.tolist(), strict=True))
    places = [
        (known[free],) if free in known else tuple(free.expected + start for start in free.starts)
        for free in tried
    ]
    points = [np.array(place) for place in product(*places)]
    costs = [float(residuals @ residuals) for residuals in fit.residuals(tried, points)]
    away = [float(np.sum((each - expected(tried)) ** 2)) for each in points]
    return points[int(np.argmin(np.add(costs, away)))]


def _promising(fit: _Fit, frees: tuple[Free, ...], point: Float64) -> list[tuple[Free, ...]]:
    """Return parameters to add, those that predict left-out swims best by a linearised estimate."""
    rows = [tuple(free for free in row if free not in frees) for row in CANDIDATES if row[0] not in frees]
    known = fit.jacobian(frees, point) if frees else np.empty((len(fit.rows), 0))
    scored = []
    for more in dict.fromkeys(rows):
        tried = (*frees, *more)
        start = _begin(fit, tried, frees, point)
        new = fit.jacobian(tried, start, len(frees))
        scored.append((fit.roughly_left_out(tried, start, np.hstack([known, new])), more))
    return [more for _, more in sorted(scored, key=lambda pair: pair[0])[:TRIED]]


def _estimates(fit: _Fit, frees: tuple[Free, ...], point: Float64) -> Iterator[Estimate]:
    """Yield values with intervals from the curvature, widened if the residuals scatter more than the
    noise."""
    if not frees:
        return
    jacobian = fit.jacobian(frees, point)
    residuals = fit.residuals(frees, [point])[0]
    scatter = max(1.0, float(residuals @ residuals) / max(len(residuals) - len(frees), 1))
    covariance = np.linalg.inv(jacobian.T @ jacobian / scatter + np.eye(len(frees)))
    for free, z, sd in zip(frees, point.tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True):
        yield Estimate(free, free.value(z), free.value(z - _Z95 * sd), free.value(z + _Z95 * sd))


def rmse_by_group(rows: Sequence[Predicted], nominal: bool = False) -> dict[str, float]:
    """Return the RMS error, m/s, over ``all`` and each group of swims that could be simulated."""
    errors: dict[str, list[float]] = {"all": []}
    for row in rows:
        error = row.experiment.error_mps if nominal else row.error_mps
        if math.isfinite(error):
            errors["all"].append(error)
            errors.setdefault(row.experiment.case.group, []).append(error)
    return {group: root_mean_square(values) for group, values in errors.items()}
