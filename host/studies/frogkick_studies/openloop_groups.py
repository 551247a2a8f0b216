"""Groups of measured swims that the open-loop study leaves out whole, and what is gained on them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from frogkick.core.errors import InputError
from frogkick.validation.validate import ExperimentResult

FloatArray = NDArray[np.float64]
_Rows = Sequence[ExperimentResult]

LEAST_SWIMS = 6
"""Of a fraction, that a fit needs."""

BANDS = 3
"""Of frequency, with as many distinct frequencies each."""

RESAMPLES, LOWER = 2000, 0.025
"""Of the paired bootstrap over cases; the quantile of the gain that must be above 0 to take an effect."""


def plans_of(
    here: _Rows, there: _Rows, train: Sequence[float], test: Sequence[float], apart: bool
) -> list[tuple[str, str, list[ExperimentResult], list[ExperimentResult]]]:
    """Kind, name, swims to fit to and swims to predict, of each split.

    Raises:
        InputError: see ``open_loop``.
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
    """Ways to put swims into groups that are left out whole: way -> group of each; two groups at least."""
    fractions = [f"{row.case.gait.egain_percent:g} % EGaIn" for row in rows]
    distinct = sorted({row.case.gait.frequency_hz for row in rows})
    bands = {
        hz: f"{part[0]:g} to {part[-1]:g} Hz"
        for part in np.array_split(distinct, min(BANDS, len(distinct)))
        for hz in part.tolist()
    }
    every = {"egain": fractions, "frequency": [bands[row.case.gait.frequency_hz] for row in rows]}
    return {way: label for way, label in every.items() if len(set(label)) > 1}


def gain_of(before: FloatArray, after: FloatArray, seed: int = 0) -> tuple[float, float, float]:
    """Mean of before^2 - after^2, and its 95 % interval by a bootstrap over cases, paired.

    Args:
        before, after: (n,) errors of the same cases.
        seed: of the resampling.
    """
    if not len(before):
        return math.nan, math.nan, math.nan
    gains = before**2 - after**2
    rng = np.random.default_rng(seed)
    means = gains[rng.integers(len(gains), size=(RESAMPLES, len(gains)))].mean(axis=1)
    low, high = np.quantile(means, (LOWER, 1.0 - LOWER))
    return float(gains.mean()), float(low), float(high)


def _by_fraction(experiments: Sequence[ExperimentResult]) -> dict[float, list[ExperimentResult]]:
    found: dict[float, list[ExperimentResult]] = {}
    for row in sorted(experiments, key=lambda row: row.case.gait.egain_percent):
        found.setdefault(row.case.gait.egain_percent, []).append(row)
    return found
