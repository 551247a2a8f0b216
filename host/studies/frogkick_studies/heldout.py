"""Cross-validation of identification: each run is predicted with the effects identified from all others.

Errors on the training runs are too low, and a single test run may be an easy one. Here each run is the test
run once, so every period is predicted once, by effects that were identified without it. No values of built-in
robots that were calibrated before are used, because these may have been fitted to the same runs; fits start
from nominal values. Only the lists of effects and parameters of such robots are used.

How small the error of a model could be is estimated from pairs of similar periods: an error of the model at
their state is in both residuals and cancels in their difference. Pairs within one run show the scatter of
strokes. Pairs of two runs also show what differs from run to run, which no model can predict.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.arrays import Float64
from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.core.progress import shown
from frogkick.front.logs import id_of_runs
from frogkick.identification.batching import all_of
from frogkick.identification.calibrated import end_errors
from frogkick.identification.outcome import identify
from frogkick.identification.predict import Rollout
from frogkick.identification.segments import Segments, read_segments, reliable
from frogkick.report import style
from frogkick.robot import Robot, load_robot
from frogkick_studies import StudyResult
from frogkick_studies.configs import Heldout

LEAST_RUNS = 3

ERRORS = {
    "before": "nominal",
    "after": "after",
    "followed": "with drift followed",
    "noise_floor": "noise floor",
}
"""Errors of a run: attribute of ``HeldOut``, which is also the key of the command -> name in its text."""

LIKE = 1.0
"""Largest difference of initial velocities of similar periods, in standard deviations over all periods."""


@dataclass(frozen=True)
class HeldOut:
    """The result for one test run.

    Attributes:
        before, after: errors one period ahead on this run, nominal and with these effects.
        noise_floor: error that the noise of the fixes alone causes.
        followed: the same as ``after``, with the drift of limbs tracked within the run as well.
        periods: (m, 8) of each period its action; the one before (-1: none); velocity at its start: forward,
            left (m/s), turn rate (rad/s); measured minus predicted pose at its end, by the pose at its
            start: forward, left (m), heading (rad).
    """

    run: Path
    verdict: str
    effects: tuple[str, ...]
    before: PredictionError
    after: PredictionError
    noise_floor: PredictionError
    followed: PredictionError
    periods: Float64 = field(default_factory=lambda: np.empty((0, 8)))


def held_out(
    robot: Robot,
    runs: Sequence[Path],
    effects: Path | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[HeldOut]:
    """Make each run the test run once.

    Args:
        runs: logs, or recorded runs (.csv).
        effects: a file of the user's own effects, which are tried as well.

    Raises:
        InputError: fewer than LEAST_RUNS, the same run twice, or one whose strokes have no reliable times.
    """
    if len(runs) < LEAST_RUNS:
        raise InputError(
            f"give {LEAST_RUNS} runs or more, not {len(runs)}: one is the test run, all others train"
        )
    places = [run.resolve() for run in runs]
    for place in places:
        if places.count(place) > 1:
            raise InputError(
                f"{place.name} is given twice: it would be a training run and the test run at once"
            )
    groups = [group for k in range(workers) if (group := list(range(len(runs)))[k::workers])]
    swims = tuple(read_segments(run, robot) for run in runs)
    for swim in swims:
        reliable([swim])
    # Each process makes _test_on of these runs, which then takes the index of one.
    job = Job(partial, (_test_on, robot, tuple(runs), swims, effects), _run, lambda _test: None)
    kept: dict[int, HeldOut] = {}
    progress(0, len(runs))
    for index, results in run_chunks(job, groups, workers):
        kept |= dict(zip(groups[index], results, strict=True))
        progress(len(kept), len(runs))
    return [kept[k] for k in range(len(runs))]


def pooled(errors: Sequence[PredictionError], periods: Sequence[int]) -> PredictionError:
    """Return the root mean square over all periods of several runs."""
    whole = sum(periods)

    def mean(values: Sequence[float]) -> float:
        return math.sqrt(sum(n * value * value for n, value in zip(periods, values, strict=True)) / whole)

    return PredictionError(
        mean([error.position_rmse_m for error in errors]),
        mean([error.heading_rmse_rad for error in errors]),
        whole,
    )


def _run(test: Callable[[int], HeldOut], group: Sequence[int]) -> list[HeldOut]:
    """Process several runs with their simulations in shared batches; the results are those of single runs."""
    return all_of([partial(test, index) for index in group])


def _test_on(
    robot: Robot, runs: Sequence[Path], swims: Sequence[Segments], effects: Path | None, index: int
) -> HeldOut:
    others = [*swims[:index], *swims[index + 1 :]]
    outcome = identify(others, swims[index : index + 1], robot, effects, measured=False)
    tested = outcome.tested
    titles = tuple(term.title for term in outcome.terms)
    return HeldOut(
        runs[index],
        outcome.verdict,
        titles,
        tested.before,
        tested.after,
        tested.noise_floor,
        tested.after if outcome.followed is None else outcome.followed.after,
        _periods(outcome.rollouts[0], swims[index]),
    )


def _periods(rollout: Rollout, swim: Segments) -> Float64:
    """(m, 8) periods of a run with a known action and a known residual; see ``HeldOut.periods``."""
    before = np.append([-1], swim.action[:-1])
    rows = np.column_stack([swim.action, before, rollout.start[:, 3:6], end_errors(rollout, swim)])
    return np.asarray(rows[np.isfinite(rows).all(axis=1) & (swim.action >= 0)], dtype=np.float64)


def scatter(runs: Sequence[Float64], same_run: bool) -> PredictionError:
    """Root mean square deviation of similar periods from their common part; ``count`` pairs.

    Each period is paired with the period of the same action, after the same action, whose initial velocity is
    nearest. Half the squared difference of their residuals estimates the variance. It contains the noise of
    the fixes.

    Args:
        runs: of each run its periods; see ``HeldOut.periods``.
        same_run: pair with periods of the same run; else with those of other runs.

    Source: Rice 1984, Bandwidth choice for nonparametric regression (variance by differences of neighbours).
    """
    every = np.concatenate(runs)
    if len(every) < 2:
        return PredictionError()
    run = np.repeat(np.arange(len(runs)), [len(rows) for rows in runs])
    velocity = every[:, 2:5] / np.maximum(every[:, 2:5].std(axis=0), 1e-9)
    apart = np.sqrt(((velocity[:, None, :] - velocity[None, :, :]) ** 2).sum(axis=2))
    apart[(every[:, None, :2] != every[None, :, :2]).any(axis=2)] = np.inf
    apart[(run[:, None] == run[None, :]) != same_run] = np.inf
    np.fill_diagonal(apart, np.inf)
    nearest = apart.argmin(axis=1)
    paired = apart[np.arange(len(every)), nearest] < LIKE
    return PredictionError.of((every[paired, 5:] - every[nearest[paired], 5:]) / math.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class HeldOutStudy(StudyResult):
    """Each run predicted with the effects identified from all others.

    Attributes:
        left_out: runs that were not used: ``run`` and ``reason`` of each.
    """

    rows: Sequence[HeldOut]
    left_out: Sequence[Mapping[str, str]]

    def error(self, name: str) -> PredictionError:
        """Error one period ahead over all periods of all runs; ``name`` is one of ERRORS."""
        return pooled([getattr(row, name) for row in self.rows], [row.before.count for row in self.rows])

    @property
    def scatter(self) -> dict[str, PredictionError]:
        """Scatter of similar periods: within a run, and between runs."""
        runs = [row.periods for row in self.rows]
        return {"same_run": scatter(runs, True), "other_runs": scatter(runs, False)}

    @property
    def passed(self) -> bool:
        """Whether the effects predict positions no worse than the nominal model."""
        return not self.error("after").position_rmse_m > self.error("before").position_rmse_m

    def plot(self) -> Figure:
        return heldout_figure(self.rows)

    def as_json(self) -> dict[str, Any]:
        return {
            **{name: self.error(name).as_json() for name in ERRORS},
            "scatter": {
                name: {**each.as_json(), "pairs": each.count} if each.count else None
                for name, each in self.scatter.items()
            },
            "periods": sum(row.before.count for row in self.rows),
            "runs": [
                {
                    "run": str(row.run),
                    "verdict": row.verdict,
                    "effects": list(row.effects),
                    **{name: getattr(row, name).as_json() for name in ERRORS},
                    "periods": row.before.count,
                }
                for row in self.rows
            ],
            "left_out": list(self.left_out),
        }

    def text(self, values: dict[str, Any]) -> str:
        lines = []
        for name, of in [*((Path(row["run"]).name, row) for row in values["runs"]), ("all", values)]:
            errors = ", ".join(f"{title} {PredictionError(**of[key])}" for key, title in ERRORS.items())
            found = f"; {of['verdict']}: {', '.join(of['effects']) or 'no effect'}" if "verdict" in of else ""
            lines.append(f"{name}: {errors} over {of['periods']} periods{found}")
        for name, pairs in (("same_run", "within a run"), ("other_runs", "between runs")):
            if like := values["scatter"][name]:
                error = PredictionError(like["position_rmse_m"], like["heading_rmse_rad"])
                lines.append(f"scatter of similar periods {pairs}: {error} over {like['pairs']} pairs")
        return "\n".join(lines)


def run(config: Heldout) -> HeldOutStudy:
    """Cross-validate: predict each run with the effects identified from all others."""
    swims = [read_segments(run) for run in config.runs]
    _, unused = reliable(swims)
    for row in unused:
        print(f"frogkick: run {row['run']!r} is LEFT OUT: {row['reason']}", file=sys.stderr)
    used = [run for run, swim in zip(config.runs, swims, strict=True) if not swim.problem]
    robot = load_robot(config.robot or id_of_runs(swims))
    with shown(True, "test runs") as tell:
        rows = held_out(robot, used, config.effects, config.processes, tell)
    return HeldOutStudy(rows, unused)


def heldout_figure(rows: Sequence[HeldOut]) -> Figure:
    """Draw position and heading errors one period ahead: nominal, with effects, noise floor."""
    place = np.arange(len(rows))[::-1]
    with style.new_figure(11.0, 1.9 + 0.42 * len(rows)) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, field, scale, what in (
            (panels[0], "position_rmse_m", 1e3, "position error, mm RMS"),
            (panels[1], "heading_rmse_rad", math.degrees(1.0), "heading error, degrees RMS"),
        ):
            before, after, floor = (
                [scale * getattr(getattr(row, name), field) for row in rows]
                for name in ("before", "after", "noise_floor")
            )
            axes.barh(place + 0.19, before, 0.36, color=style.NOMINAL, label="nominal model")
            axes.barh(
                place - 0.19,
                after,
                0.36,
                color=style.PREDICTED,
                label="with effects identified from the other runs",
            )
            axes.vlines(
                floor,
                place - 0.4,
                place + 0.4,
                color=style.FLOOR,
                linewidth=1.5,
                label="noise of the fixes alone",
            )
            axes.set_xlim(0.0, None)
            axes.set_xlabel(f"{what}, one period ahead")
        panels[0].set_yticks(place, [row.run.stem for row in rows])
        panels[0].set_ylabel("test run")
        panels[0].set_title("Position")
        panels[1].set_title("Heading")
        panels[0].legend(loc="upper left", bbox_to_anchor=(0.0, -0.75 / figure.get_figheight()), ncols=3)
    return figure
