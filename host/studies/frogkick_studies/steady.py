"""Steady speeds of a robot with effects, the parameters that they determine, and cross-validation groups."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import InputError
from frogkick.der import WIDTH
from frogkick.effects import BUILT_IN, Parameter, rods_of
from frogkick.effects.swims import Gait
from frogkick.robot import Profile, Robot
from frogkick.validation.gaits import GaitSwim, swim_gaits
from frogkick.validation.validate import ExperimentResult

Table = Mapping[str, Any]

_FAR = 10.0  # widths: a factor whose bound is 0 goes no lower


@dataclass(frozen=True)
class Free:
    """A parameter that may be fitted.

    Attributes:
        width: standard deviation of the prior; for a factor that of its logarithm.
        factor: whether it multiplies, and is fitted by its logarithm.
        expected: mean of the prior, in widths from the nominal model.
        starts: starting values, in widths from there; the one with the smallest residuals is used.
    """

    effect: str
    parameter: str
    width: float
    factor: bool = True
    expected: float = 0.0
    starts: tuple[float, ...] = (0.0,)

    @property
    def declared(self) -> Parameter:
        """Its declaration: bounds, unit, nominal value."""
        return next(p for p in BUILT_IN[self.effect].parameters if p.name == self.parameter)

    @property
    def name(self) -> str:
        """``effect.parameter``."""
        return f"{self.effect}.{self.parameter}"

    def value(self, widths: float) -> float:
        """Return the value at a number of widths from nominal, within its bounds."""
        p, away = self.declared, min(max(widths, self.bounds[0]), self.bounds[1]) * self.width
        value = p.nominal * math.exp(away) if self.factor else p.nominal + away
        return min(max(value, p.low), p.high)

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of its values, in widths."""
        p = self.declared
        least = math.exp(-_FAR * self.width)
        low, high = (
            math.log(max(v / p.nominal, least)) if self.factor else v - p.nominal for v in (p.low, p.high)
        )
        return low / self.width, high / self.width


LIMB_DRAG = Free("hull", "limb_drag", math.log(2.0), starts=(-0.25, 0.0))
FRAME_DRAG = Free("hull", "frame_drag", math.log(2.0))
PLATE = Free("limb_plate", "added", 0.4, False, 2.5, (-1.0, 0.0))

CANDIDATES: tuple[tuple[Free, ...], ...] = (
    (LIMB_DRAG,),
    # Theory gives a limb the added mass of a plate, which makes the robot slower. So something else is off as
    # well: the drag of the frame, or what tips leave behind, of which slender-body theory has too much here.
    (PLATE, FRAME_DRAG),
    (PLATE, Free("limb_plate", "shedding", 0.3, False, 0.0, (0.1,))),
    (FRAME_DRAG,),
    (Free("limb_wear", "duration_scale", math.log(1.5)),),
    (Free("group_loss", "loss", 0.3, False, 0.0, (0.3,)), Free("group_loss", "fade_s", math.log(3.0))),
)
"""Parameters that steady speeds determine and all alloys share; those of a row are fitted together."""


def expected(frees: Sequence[Free]) -> Float64:
    """Return (p,) prior means, in widths from the nominal model."""
    return np.array([free.expected for free in frees])


def tables_of(values: Mapping[Free, float]) -> tuple[Table, ...]:
    """Return effects with these values, as in a robot's TOML file."""
    tables: dict[str, dict[str, Any]] = {}
    for free, value in values.items():
        tables.setdefault(free.effect, {"name": free.effect})[free.parameter] = float(f"{value:.6g}")
    return tuple(tables.values())


def with_effects(robot: Robot, tables: Sequence[Table]) -> Robot:
    """Return the robot with further effects."""
    return replace(robot, effects=(*robot.effects, *(dict(table) for table in tables)))


class Simulation:
    """Steady speeds of a robot with various effects; each speed is simulated once."""

    def __init__(self, robot: Robot, profiles: Sequence[Profile], workers: int) -> None:
        self.robot, self.profiles, self.workers = robot, tuple(profiles), workers
        self._known: dict[tuple[str, Gait], float] = {}

    def speeds(self, effects: Sequence[Sequence[Table]], gaits: Sequence[Gait]) -> Float64:
        """Return (len(effects), len(gaits)) speeds, m/s; NaN if a simulation failed."""
        tasks: list[tuple[tuple[Table, ...], list[Gait]]] = []
        for key, tables in {repr(tuple(each)): tuple(each) for each in effects}.items():
            missing = sorted(
                {gait for gait in gaits if (key, gait) not in self._known},
                key=lambda gait: (gait.frequency_hz, gait.egain_percent, gait.phase),
            )
            tasks += [(tables, missing[first : first + WIDTH]) for first in range(0, len(missing), WIDTH)]
        job = Job(_start, (self.robot, self.profiles), _swim_task, _warm)
        for index, found in run_chunks(job, tasks, self.workers if len(tasks) > 1 else 1):
            tables, swum = tasks[index]
            self._known |= {(repr(tables), gait): speed for gait, speed in zip(swum, found, strict=True)}
        return np.array([[self._known[repr(tuple(each)), gait] for gait in gaits] for each in effects])


_Ready = tuple[Robot, tuple[Profile, ...]]


def _start(robot: Robot, profiles: tuple[Profile, ...]) -> _Ready:
    return robot, profiles


def _swim_task(ready: _Ready, task: tuple[tuple[Table, ...], Sequence[Gait]]) -> list[float]:
    swum = swim_gaits(rods_of(with_effects(ready[0], task[0])), ready[1], task[1])
    return [swim.speed_mps if isinstance(swim, GaitSwim) else math.nan for swim in swum]


def _warm(ready: _Ready) -> None:
    profile = ready[1][0]
    _swim_task(ready, ((), [Gait(profile.egain_percent, profile.frequency_hz, 0.0)]))


_Rows = Sequence[ExperimentResult]

LEAST_SWIMS = 6
"""Least number of swims of a fraction for a fit."""

BANDS = 3
"""Number of frequency bands, with equal numbers of distinct frequencies."""

RESAMPLES, LOWER = 2000, 0.025
"""Paired bootstrap over cases; the quantile of the gain that must be above 0 to accept an effect."""


def splits_of(
    here: _Rows, there: _Rows, train: Sequence[float], test: Sequence[float], apart: bool
) -> list[tuple[str, str, list[ExperimentResult], list[ExperimentResult]]]:
    """Return kind, name, training swims and test swims of each split; see ``fits.open_loop``.

    Args:
        here, there: swims of the training folder and of the test folder.
        train, test: EGaIn fractions, per cent.
        apart: whether the folders differ.
    """
    by_fraction, aims = _by_fraction(here), _by_fraction(there)
    known = ", ".join(f"{percent:g} % ({len(rows)})" for percent, rows in by_fraction.items()) or "none"
    for percents, rows in ((train, by_fraction), (test, aims)):
        for percent in percents:
            if percent not in rows:
                raise InputError(
                    f"no measured swim at {percent:g} % EGaIn that has a limb profile: swims are at {known}"
                )
    if apart:
        own = [row for percent in (train or by_fraction) for row in by_fraction[percent]]
        tested = [row for percent in (test or aims) for row in aims[percent]]
        if len(own) < LEAST_SWIMS or not tested:
            raise InputError(
                f"a fit needs {LEAST_SWIMS} measured swims with limb profiles and a test any: there are "
                f"{len(own)} in --train and {len(tested)} in --test"
            )
        return [("folder", "the training folder", own, tested)]
    plans = []
    for percent in train:
        if len(by_fraction[percent]) < LEAST_SWIMS:
            raise InputError(
                f"too few measured swims at {percent:g} % EGaIn: a fit needs {LEAST_SWIMS}, there are {known}"
            )
        tested = [row for p in (test or by_fraction) if p != percent for row in by_fraction[p]]
        plans.append(("egain", f"{percent:g} % EGaIn", by_fraction[percent], tested))
    if not train:
        everything = [row for rows in by_fraction.values() for row in rows]
        for kind, label in groupings(everything).items():
            for left in dict.fromkeys(label):
                own = [row for row, its in zip(everything, label, strict=True) if its != left]
                tested = [row for row, its in zip(everything, label, strict=True) if its == left]
                if test:
                    tested = [row for row in tested if row.case.gait.egain_percent in test]
                if len(own) >= LEAST_SWIMS and tested:
                    plans.append((kind, f"all but {left}", own, tested))
        if len(by_fraction) < 2:
            plans = []
    if not plans or not all(tested for *_, tested in plans):
        raise InputError(
            f"measured swims with limb profiles are at {known}: needed are {LEAST_SWIMS} or more at one "
            "EGaIn fraction to fit to, and any at another one to test on"
        )
    return plans


def groupings(rows: _Rows) -> dict[str, list[str]]:
    """Return the ways to divide swims into groups: way -> group of each; two groups at least."""
    fractions = [f"{row.case.gait.egain_percent:g} % EGaIn" for row in rows]
    distinct = sorted({row.case.gait.frequency_hz for row in rows})
    bands = {
        hz: f"{part[0]:g} to {part[-1]:g} Hz"
        for part in np.array_split(distinct, min(BANDS, len(distinct)))
        for hz in part.tolist()
    }
    every = {"egain": fractions, "frequency": [bands[row.case.gait.frequency_hz] for row in rows]}
    return {way: label for way, label in every.items() if len(set(label)) > 1}


def gain_of(before: Float64, after: Float64) -> tuple[float, float, float]:
    """Return the mean of before^2 - after^2, and its 95 % interval by a paired bootstrap over cases.

    Args:
        before, after: (n,) errors of the same cases.
    """
    if not len(before):
        return math.nan, math.nan, math.nan
    gains = before**2 - after**2
    rng = np.random.default_rng(0)
    means = gains[rng.integers(len(gains), size=(RESAMPLES, len(gains)))].mean(axis=1)
    low, high = np.quantile(means, (LOWER, 1.0 - LOWER))
    return float(gains.mean()), float(low), float(high)


def _by_fraction(experiments: Sequence[ExperimentResult]) -> dict[float, list[ExperimentResult]]:
    found: dict[float, list[ExperimentResult]] = {}
    for row in sorted(experiments, key=lambda row: row.case.gait.egain_percent):
        found.setdefault(row.case.gait.egain_percent, []).append(row)
    return found
