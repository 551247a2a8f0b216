"""Each of several runs, predicted by what identification learns from all the others.

Errors on the runs that effects were fitted to flatter them, and one run kept back may be an easy one. Here
each run is the one kept back in turn: every period counts once, and none among what it was learned from. No
value of a built-in robot that was measured before enters, as it may have been fitted to these very runs: fits
start from nominal values. What remains of such robots is the list of their effects and parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from frogkick.core.chunks import Job, run_chunks
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.identification.batching import run_concurrently
from frogkick.identification.outcome import identify
from frogkick.identification.segments import Segments, read_segments, reliable
from frogkick.robot import Robot

LEAST_RUNS = 3


@dataclass(frozen=True)
class HeldOut:
    """What came of one run that was kept back.

    Attributes:
        run: its file.
        verdict: on the others, and this one.
        effects: titles of those found in the others.
        before, after: errors a period ahead on this run, nominal and with them.
        floor: what noise of the fixes alone makes.
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
    """Keep each run back in turn.

    Args:
        robot: nominal.
        runs: logs, or recorded runs (.csv).
        effects: a file of the user's own, tried as well.
        workers: processes.
        progress: called with runs done and to do.

    Raises:
        InputError: too few runs, one twice, one that cannot be read or judged, or one whose strokes' times
            cannot be relied on (``frogkick.identification.segments.reliable`` tells these first).
    """
    if len(runs) < LEAST_RUNS:
        raise InputError(f"give {LEAST_RUNS} runs or more, not {len(runs)}: one is kept back, others teach")
    places = [run.resolve() for run in runs]
    for place in places:
        if places.count(place) > 1:
            raise InputError(f"{place.name} is given twice: it would be learned from where it is kept back")
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
    """Root mean square over all periods of several runs."""
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
    """Several runs, their simulations in shared batches: each comes out as it would alone."""
    done = dict(run_concurrently([partial(_keep_back, ready, index) for index in group]))
    return [done[k] for k in range(len(group))]


def _keep_back(ready: _Ready, index: int) -> HeldOut:
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
