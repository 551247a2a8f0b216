"""The wake of earlier strokes: fitted to measured series over phase offset, and predicted for another gait.

The planar rods have no wake, so their speed hardly depends on the phase offset between front and rear limbs.
Here a stroke loses a share of its thrust to the water that the other pair of limbs has set in motion:
``share`` right after that pair's stroke, and ``share`` exp(-gap / memory) after a gap. The two gaps of a
cycle of frequency f are phase / f and (1 - phase) / f, so two numbers determine the speed over all phases and
frequencies.

Both are fitted to series over phase, each with a mean level of its own, because the error of a whole series
varies from build to build and with the frequency, and no wake explains it. The spread of these levels, over
all measured alloys and frequencies, is the larger part of the interval of a prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.progress import shown
from frogkick.effects.swims import Gait
from frogkick.report import style
from frogkick.robot import load_robot
from frogkick.validation.validate import ExperimentResult, swum_of, validate
from frogkick_studies import StudyResult
from frogkick_studies.configs import Wake

Series = Sequence[ExperimentResult]

START, LOWEST, HIGHEST = (0.3, 0.2), (0.0, 0.02), (1.0, 5.0)
"""Share and memory (s) where a fit starts, and their bounds."""

SERIES_LEAST, SWIMS_LEAST = 2, 5
PHASES = np.arange(10) / 10.0
CONFIDENCE = 0.9


@dataclass(frozen=True)
class LeftOut:
    """A series over phase, predicted by a wake that was fitted to the others.

    Attributes:
        before_mps, after_mps: root mean square of measured minus predicted about the series' own level,
            without and with the wake.
    """

    name: str
    before_mps: float
    after_mps: float


@dataclass(frozen=True, eq=False)
class WakeStudy(StudyResult):
    """The wake that was fitted to series over phase offset, and its prediction for another gait.

    Attributes:
        share, memory_s: fitted to all series.
        levels_mps: mean of measured minus predicted of each alloy and frequency.
        gait: alloy and frequency of the prediction.
        rods_mps: (10,) speed of the rods over PHASES.
        predicted_mps, low_mps, high_mps: (10,) the prediction, and its interval of CONFIDENCE for a swim.
    """

    share: float
    memory_s: float
    left_out: Sequence[LeftOut]
    levels_mps: Sequence[float]
    gait: Gait
    rods_mps: Float64
    predicted_mps: Float64
    low_mps: Float64
    high_mps: Float64

    def as_json(self) -> dict[str, Any]:
        return {
            "share": self.share,
            "memory_s": self.memory_s,
            "left_out": [
                {"series": each.name, "before_mps": each.before_mps, "after_mps": each.after_mps}
                for each in self.left_out
            ],
            "levels": {
                "count": len(self.levels_mps),
                "mean_mps": float(np.mean(self.levels_mps)),
                "sd_mps": float(np.std(self.levels_mps, ddof=1)),
            },
            "egain_percent": self.gait.egain_percent,
            "frequency_hz": self.gait.frequency_hz,
            "prediction": [
                dict(zip(("phase", "rods_mps", "speed_mps", "low_mps", "high_mps"), row, strict=True))
                for row in np.column_stack(
                    [PHASES, self.rods_mps, self.predicted_mps, self.low_mps, self.high_mps]
                ).tolist()
            ],
        }

    def text(self, values: dict[str, Any]) -> str:
        lines = [
            f"wake: {self.share:.2f} of the thrust right after the other pair's stroke, memory "
            f"{self.memory_s:.2f} s"
        ]
        lines += [
            f"held out {each.name}: {1e3 * each.before_mps:.2f} mm/s RMS about its level without the wake, "
            f"{1e3 * each.after_mps:.2f} with it"
            for each in self.left_out
        ]
        level = values["levels"]
        lines.append(
            f"levels of {level['count']} alloys and frequencies: {1e3 * level['mean_mps']:.1f} mm/s, "
            f"standard deviation {1e3 * level['sd_mps']:.1f}"
        )
        lines.append(
            f"predicted at {self.gait.egain_percent:g} % and {self.gait.frequency_hz:g} Hz, with "
            f"{CONFIDENCE:.0%} intervals (mm/s):"
        )
        lines += [
            f"phase {row['phase']:.1f}: {1e3 * row['speed_mps']:.1f} ({1e3 * row['low_mps']:.1f} to "
            f"{1e3 * row['high_mps']:.1f}), rods {1e3 * row['rods_mps']:.1f}"
            for row in values["prediction"]
        ]
        return "\n".join(lines)

    def plot(self) -> Figure:
        with style.new_figure(6.4, 4.2) as figure:
            axes = figure.subplots()
            axes.fill_between(
                PHASES, 1e3 * self.low_mps, 1e3 * self.high_mps, color=style.PREDICTED, alpha=0.2,
                label=f"interval of {CONFIDENCE:.0%}",
            )  # fmt: skip
            axes.plot(PHASES, 1e3 * self.predicted_mps, "o-", color=style.PREDICTED, label="with the wake")
            axes.plot(PHASES, 1e3 * self.rods_mps, "--", color=style.DESIRED, label="rods")
            axes.set_xlabel("phase offset between front and rear limbs (1)")
            axes.set_ylabel("speed (mm/s)")
            axes.set_ylim(bottom=0.0)
            axes.set_title(
                f"Predicted for {self.gait.egain_percent:g} % EGaIn at {self.gait.frequency_hz:g} Hz"
            )
            style.legend_below(figure, axes)
        return figure


def kept(values: Float64, phase: Float64, frequency_hz: Float64 | float) -> Float64:
    """The share of the speed that remains with a wake of (share, memory in s), over phases and frequencies.

    Each pair of limbs gives half of the thrust.
    """
    share, memory_s = values
    gaps = phase / frequency_hz, (1.0 - phase) / frequency_hz
    return np.asarray(1.0 - 0.5 * share * sum(np.exp(-gap / memory_s) for gap in gaps))


def fitted(series: Sequence[Series]) -> tuple[Float64, Float64]:
    """(2,) share and memory (s) that fit series over phase best, each about its level; (2, 2) covariance."""
    from scipy.optimize import least_squares

    def residuals(values: Float64) -> Float64:
        off = [_off(values, some) for some in series]
        return np.concatenate([each - each.mean() for each in off])

    found = least_squares(residuals, START, bounds=(LOWEST, HIGHEST), x_scale=(0.3, 0.2))
    spare = max(len(found.fun) - len(series) - len(START), 1)
    return found.x, np.linalg.pinv(found.jac.T @ found.jac) * float(found.fun @ found.fun) / spare


def _columns(series: Series) -> Float64:
    """(4, n) frequency, phase, measured and the rods' speed."""
    rows = [
        (each.case.gait.frequency_hz, each.case.gait.phase, each.reference.speed_mps, each.model_mps)
        for each in series
    ]
    return np.array(rows).T


def _off(values: Float64, series: Series) -> Float64:
    frequency, phase, measured, rods = _columns(series)
    return np.asarray(measured - rods * kept(values, phase, frequency))


def _left_out(series: dict[str, Series], name: str) -> LeftOut:
    values, _ = fitted([some for other, some in series.items() if other != name])
    before, after = (float(np.std(_off(each, series[name]))) for each in (np.array([0.0, 1.0]), values))
    return LeftOut(name, before, after)


def run(config: Wake) -> WakeStudy:
    from scipy import stats

    robot = load_robot(config.robot)
    with shown(True, "wake: swims") as tell:
        found = validate(robot, config.data_dir, config.processes, tell)
    groups: dict[str, list[ExperimentResult]] = {}
    for each in found.experiments:
        gait = each.case.gait
        groups.setdefault(f"{gait.egain_percent:g} % {gait.frequency_hz:g} Hz", []).append(each)
    series: dict[str, Series] = {
        name: some
        for name, some in groups.items()
        if len({each.case.gait.phase for each in some}) >= SWIMS_LEAST
    }
    if len(series) < SERIES_LEAST:
        raise InputError(
            f"{str(config.data_dir)!r} has {len(series)} series over phase offset with {SWIMS_LEAST} swims "
            f"or more, needed are {SERIES_LEAST}: give a folder with more in exp/phase"
        )
    values, covariance = fitted(list(series.values()))

    def levels_of(tried: Float64) -> list[float]:
        return [float(_off(tried, some).mean()) for some in groups.values()]

    def prediction(tried: Float64) -> Float64:
        return rods * kept(tried, PHASES, config.frequency) + float(np.mean(levels_of(tried)))

    gaits = [Gait(config.egain, config.frequency, float(phase)) for phase in PHASES]
    swum, failed = swum_of(robot, found.profiles, set(gaits), config.processes)
    if failed:
        raise InputError(f"nothing to predict: {next(iter(failed.values()))}")
    rods = np.array([swum[gait].speed_mps for gait in gaits])
    levels, predicted, step = levels_of(values), prediction(values), 1e-4
    slope = np.stack([prediction(values + step * unit) - predicted for unit in np.eye(2)], axis=1) / step
    scatter = np.concatenate([off - off.mean() for off in (_off(values, some) for some in series.values())])
    variance = (
        np.einsum("np,pq,nq->n", slope, covariance, slope)
        + np.var(levels, ddof=1) * (1.0 + 1.0 / len(levels))
        + float(scatter @ scatter) / max(len(scatter) - len(series) - len(START), 1)
    )
    wide = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(len(levels) - 1, 1))) * np.sqrt(variance)
    return WakeStudy(
        float(values[0]),
        float(values[1]),
        [_left_out(series, name) for name in series],
        levels,
        gaits[0],
        rods,
        predicted,
        predicted - wide,
        predicted + wide,
    )
