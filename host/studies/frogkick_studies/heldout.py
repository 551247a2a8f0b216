"""Cross-validation of identification: each of several runs is predicted by the effects that all others show.

Errors on the training runs are too low, and a single test run may be an easy one. Here each run is the test
run once, so every period is predicted once, by effects that were identified without it. No values of built-in
robots that were calibrated before are used, because these may have been fitted to the same runs; fits start
from nominal values. Only the lists of effects and parameters of such robots are used.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.core.progress import shown
from frogkick.identification.batching import run_concurrently
from frogkick.identification.outcome import identify, robot_of_runs
from frogkick.identification.segments import Segments, read_segments, reliable
from frogkick.report import style
from frogkick.robot import Robot, load_robot
from frogkick_studies import Found
from frogkick_studies.configs import Heldout

LEAST_RUNS = 3


@dataclass(frozen=True)
class HeldOut:
    """The result for one test run.

    Attributes:
        run: its file.
        verdict: the verdict of identification from the others.
        effects: titles of the effects identified from the others.
        before, after: errors one period ahead on this run, nominal and with these effects.
        floor: error that the noise of the fixes alone causes.
    """

    run: Path
    verdict: str
    effects: tuple[str, ...]
    before: PredictionError
    after: PredictionError
    floor: PredictionError


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
        InputError: too few runs, one twice, one that cannot be read or used, or one with unreliable times of
            its strokes (see ``frogkick.identification.segments.reliable``).
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
    job = Job(_Ready, (robot, tuple(runs), swims, effects), _run, lambda _ready: None)
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


@dataclass(frozen=True, eq=False)
class _Ready:
    robot: Robot
    runs: tuple[Path, ...]
    swims: tuple[Segments, ...]
    effects: Path | None


def _run(ready: _Ready, group: Sequence[int]) -> list[HeldOut]:
    """Process several runs with their simulations in shared batches; the results are those of single runs."""
    done = dict(run_concurrently([partial(_test_on, ready, index) for index in group]))
    return [done[k] for k in range(len(group))]


def _test_on(ready: _Ready, index: int) -> HeldOut:
    swims = ready.swims
    outcome = identify(
        swims[:index] + swims[index + 1 :],
        swims[index : index + 1],
        ready.robot,
        ready.effects,
        measured=False,
    )
    tested = outcome.tested
    titles = tuple(term.title for term in outcome.terms)
    return HeldOut(
        ready.runs[index], outcome.verdict, titles, tested.before, tested.after, tested.noise_floor
    )


@dataclass(frozen=True, eq=False)
class HeldOutStudy(Found):
    """Each run predicted by the effects that all others show.

    Attributes:
        rows: results for each run.
        left_out: runs that were not used: ``run`` and ``reason`` of each.
    """

    rows: Sequence[HeldOut]
    left_out: Sequence[Mapping[str, str]]

    @property
    def before(self) -> PredictionError:
        """Error of the nominal model one period ahead, over all periods of all runs."""
        return self._pooled([row.before for row in self.rows])

    @property
    def after(self) -> PredictionError:
        """The same with the effects identified from the other runs."""
        return self._pooled([row.after for row in self.rows])

    @property
    def noise_floor(self) -> PredictionError:
        """Error that the noise of the fixes alone causes."""
        return self._pooled([row.floor for row in self.rows])

    def _pooled(self, errors: Sequence[PredictionError]) -> PredictionError:
        return pooled(errors, [row.before.count for row in self.rows])

    @property
    def passed(self) -> bool:
        """Whether the effects predict positions no worse than the nominal model."""
        return not self.after.position_rmse_m > self.before.position_rmse_m

    def plot(self) -> Figure:
        return heldout_figure(self.rows)

    def as_json(self) -> dict[str, Any]:
        return {
            "before": self.before.as_json(),
            "after": self.after.as_json(),
            "noise_floor": self.noise_floor.as_json(),
            "periods": sum(row.before.count for row in self.rows),
            "runs": [
                {
                    "run": str(row.run),
                    "verdict": row.verdict,
                    "effects": list(row.effects),
                    "before": row.before.as_json(),
                    "after": row.after.as_json(),
                    "noise_floor": row.floor.as_json(),
                    "periods": row.before.count,
                }
                for row in self.rows
            ],
            "left_out": list(self.left_out),
        }

    def text(self, values: dict[str, Any]) -> str:
        lines = []
        for name, of in [*((Path(row["run"]).name, row) for row in values["runs"]), ("all", values)]:
            titles = (("nominal", "before"), ("after", "after"), ("noise floor", "noise_floor"))
            errors = ", ".join(f"{title} {PredictionError(**of[key])}" for title, key in titles)
            found = f"; {of['verdict']}: {', '.join(of['effects']) or 'no effect'}" if "verdict" in of else ""
            lines.append(f"{name}: {errors} over {of['periods']} periods{found}")
        return "\n".join(lines)


def run(config: Heldout) -> HeldOutStudy:
    """Cross-validate: predict each run by the effects that all others show.

    Raises:
        InputError: too few runs, one twice, or one that cannot be read or used.
    """
    swims = [read_segments(run) for run in config.runs]
    _, unused = reliable(swims)
    for row in unused:
        print(f"frogkick: run {row['run']!r} is LEFT OUT: {row['reason']}", file=sys.stderr)
    used = [run for run, swim in zip(config.runs, swims, strict=True) if not swim.problem]
    robot = load_robot(config.robot or robot_of_runs(swims))
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
                for name in ("before", "after", "floor")
            )
            axes.barh(place + 0.19, before, 0.36, color=style.NOMINAL, label="nominal model")
            axes.barh(
                place - 0.19,
                after,
                0.36,
                color=style.PREDICTED,
                label="with effects that the other runs show",
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
