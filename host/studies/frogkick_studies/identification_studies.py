"""Studies of identification: runs kept back in turn, effects planted, swims that were not fitted to."""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.files import require_writable, write_text
from frogkick.core.poses import PredictionError
from frogkick.core.progress import Progress, shown
from frogkick.front.identifying import LeftOut
from frogkick.front.places import robot_of_table, table_image
from frogkick.identification.outcome import robot_of_runs
from frogkick.identification.segments import read_segments, reliable
from frogkick.robot import Robot, load_robot
from frogkick.robot.toml_text import to_toml
from frogkick.validation.validate import authors_rmse_mps, speed_rmse_mps
from frogkick_codegen.firmware import require_tools
from frogkick_studies import heldout
from frogkick_studies.heldout import HeldOut
from frogkick_studies.openloop import OpenLoop, Predicted, Split, open_loop, rmse_by_group
from frogkick_studies.openloop_groups import gain_of
from frogkick_studies.planted import NULL, ONE, OUTSIDE, TWO, kinds
from frogkick_studies.steady import with_effects
from frogkick_studies.verdicts import Case, Result, run_cases

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "HeldOutStudy",
    "OpenLoopStudy",
    "VerdictStudy",
    "study_held_out",
    "study_open_loop",
    "study_verdicts",
]

LEAST = {NULL: 0.95, ONE: 0.95, TWO: 0.90, OUTSIDE: 0.95}
"""Share of the cases of a group that must be right."""

MOST_WRONG = 0.02
"""Share that may be wrongly found."""


@dataclass(frozen=True, eq=False, repr=False)
class HeldOutStudy:
    """Each run predicted by what all others show.

    Attributes:
        rows: what came of each run.
        left_out: runs that were not used: ``run`` and ``reason`` of each.
    """

    rows: Sequence[HeldOut]
    left_out: Sequence[Mapping[str, str]]

    @property
    def before(self) -> PredictionError:
        """Error of the nominal model a period ahead, over all periods of all runs."""
        return self._pooled([row.before for row in self.rows])

    @property
    def after(self) -> PredictionError:
        """The same with the effects found in the other runs."""
        return self._pooled([row.after for row in self.rows])

    @property
    def noise_floor(self) -> PredictionError:
        """What noise of the fixes alone makes."""
        return self._pooled([row.floor for row in self.rows])

    def _pooled(self, errors: Sequence[PredictionError]) -> PredictionError:
        return heldout.pooled(errors, [row.before.count for row in self.rows])

    @property
    def worse(self) -> bool:
        """Whether what was found predicts positions worse than the nominal model."""
        return self.after.position_rmse_m > self.before.position_rmse_m

    def plot(self) -> Figure:
        """A matplotlib figure: errors of each run, before, after, and of noise alone."""
        from frogkick_studies.heldout_figure import heldout_figure

        return heldout_figure(self.rows)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study heldout``, without its picture."""
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

    def __repr__(self) -> str:
        errors = " / ".join(
            f"{1e3 * error.position_rmse_m:.2f}" for error in (self.before, self.after, self.noise_floor)
        )
        return f"HeldOutStudy({len(self.rows)} runs; before / after / noise floor {errors} mm)"


def study_held_out(
    runs: Sequence[Path],
    *,
    robot: Robot | str | None = None,
    effects: Path | None = None,
    workers: int | None = None,
    left_out: LeftOut = lambda _rows: None,
    progress: Progress = False,
) -> HeldOutStudy:
    """Keep each run back in turn, learn from all others what the model lacks, and predict it with that.

    Every period is predicted once, by effects that were found without it. Fits of many effects start from
    nominal values, never from a built-in robot that was measured before.

    Args:
        runs: three or more: logs, or recorded runs (.csv).
        robot: the nominal one, or its name or TOML file; None: the runs' own.
        effects: a Python file of effects of your own, tried as well.
        workers: processes; None: one for each core.
        left_out: told of runs that are not used, before the work.
        progress: of the runs: True for a bar, or a function of (done, all).

    Raises:
        InputError: too few runs, one twice, or one that cannot be read or judged.
    """
    swims = [read_segments(run) for run in runs]
    _, unused = reliable(swims)
    left_out(unused)
    used = [run for run, swim in zip(runs, swims, strict=True) if not swim.problem]
    described = robot if isinstance(robot, Robot) else load_robot(robot or robot_of_runs(swims))
    with shown(progress, "runs kept back") as tell:
        rows = heldout.held_out(described, used, effects, workers or os.cpu_count() or 1, tell)
    return HeldOutStudy(rows, unused)


@dataclass(frozen=True, eq=False, repr=False)
class VerdictStudy:
    """Effects planted in simulated pools, and what identification made of the runs.

    Attributes:
        results: each case.
    """

    results: Mapping[Case, Result]

    @property
    def groups(self) -> dict[str, dict[str, Any]]:
        """Group of kinds -> cases, right ones, wrongly found ones, planted parameters of effects that were
        found, how many of these are inside their intervals, and whether all is as good as asked."""
        known, found = kinds(), {}
        for group, least in LEAST.items():
            some = [result for case, result in self.results.items() if known[case.kind].group == group]
            if some:
                right, wrong = sum(result.right for result in some), sum(result.wrong for result in some)
                found[group] = {
                    "cases": len(some),
                    "right": right,
                    "wrongly_found": wrong,
                    "parameters": sum(result.parameters for result in some),
                    "inside": sum(result.inside for result in some),
                    "passed": right >= least * len(some) and wrong <= MOST_WRONG * len(some),
                }
        return found

    @property
    def passed(self) -> bool:
        """Whether in every group enough are right."""
        return all(group["passed"] for group in self.groups.values())

    def plot(self) -> Figure:
        """A matplotlib figure: verdicts and errors by kind."""
        from frogkick_studies.verdicts_figure import verdicts_figure

        return verdicts_figure(self.results)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study verdicts``, without its picture."""
        return {
            "groups": self.groups,
            "cases": [
                {"kind": case.kind, "seed": case.seed, **result.as_json()}
                for case, result in self.results.items()
            ],
        }

    def __repr__(self) -> str:
        right = sum(result.right for result in self.results.values())
        return f"VerdictStudy({right} of {len(self.results)} right; {'passed' if self.passed else 'missed'})"


def study_verdicts(
    out: Path | str,
    *,
    planted: Sequence[str] | None = None,
    seeds: int = 5,
    cases: int | None = None,
    first: int = 0,
    tables: Path | None = None,
    workers: int = 1,
    progress: Progress = False,
) -> VerdictStudy:
    """Plant effects in simulated pools, identify them from the runs, and count what comes out.

    Args:
        out: folder for results; a second start goes on in it.
        planted: kinds of effects to plant, by name; None: all.
        seeds: cases of each kind.
        cases: instead of ``seeds``, cases of each group, its kinds in turn.
        first: the first seed.
        tables: image; None: the default one.
        workers: processes.
        progress: of the cases: True for a bar, or a function of (done, all).

    Raises:
        InputError: an unknown kind, or a folder that cannot be written to.
        ToolchainError: no compiler for the core.
    """
    known = kinds()
    for name in planted or ():
        if name not in known:
            raise InputError(f"--kind is {name!r}: choose from {', '.join(known)}")
    require_tools("native")
    folder = Path(out)
    require_writable(folder, folder=True)
    image = table_image(tables, None)
    robot = robot_of_table(image, None)
    wanted = cases_of(list(planted or known), first, seeds, cases)
    with shown(progress, "cases") as tell:
        return VerdictStudy(run_cases(robot, image, wanted, folder, workers, tell))


def cases_of(names: Sequence[str], first: int, seeds: int, each: int | None) -> list[Case]:
    """Cases of some kinds: so many seeds of each kind, or so many of each group, its kinds in turn."""
    if each is None:
        return [Case(name, seed) for seed in range(first, first + seeds) for name in names]
    found = []
    for group in LEAST:
        some = [name for name in names if kinds()[name].group == group]
        found += [Case(some[k % len(some)], first + k // len(some)) for k in range(each if some else 0)]
    return found


@dataclass(frozen=True, eq=False, repr=False)
class OpenLoopStudy:
    """Effects fitted to some groups of measured swims, and what they predict of the others.

    Attributes:
        nominal: the robot without them.
        found: each split of the swims.
    """

    nominal: Robot
    found: OpenLoop

    def plot(self) -> Figure:
        """A matplotlib figure: measured and predicted speeds of each split."""
        from frogkick_studies.openloop_figure import openloop_figure

        return openloop_figure(self.found)

    def save_robots(self, folder: Path | str) -> list[Path]:
        """Write for each split the nominal robot with the effects fitted (TOML); the files.

        Raises:
            InputError: the folder cannot be written to.
        """
        files = []
        for split in self.found.splits:
            name = re.sub(r"[^a-z0-9.]+", "-", split.name.lower()).strip("-")
            files.append(Path(folder) / f"{self.nominal.id}-{name}.toml")
            table = tomllib.loads(self.nominal.toml)
            effects = with_effects(self.nominal, split.fitted.tables).effects
            if effects:
                table["effect"] = [dict(effect) for effect in effects]
            write_text(files[-1], to_toml(table))
        return files

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``study openloop``, without its files."""
        validation, splits = self.found.validation, self.found.splits
        group = "experiments"
        kinds = dict.fromkeys(split.kind for split in splits)
        pooled = {kind: [row for s in splits if s.kind == kind for row in s.test] for kind in kinds}
        return {
            "robot": validation.robot.id,
            "nominal": {
                "rmse_mps": {g: v for g, v in speed_rmse_mps(validation).items() if g.startswith(group)},
                "authors_rmse_mps": authors_rmse_mps(validation),
            },
            "noise_floor_mps": self.found.noise.neighbours,
            "test": _errors(pooled[next(iter(kinds))]),
            "test_by_kind": {kind: _errors(rows) for kind, rows in pooled.items()},
            "splits": [_split_row(split) for split in splits],
            "skipped": [
                {"case": skipped.case, "reason": skipped.reason}
                for skipped in validation.skipped
                if skipped.case.startswith(("exp", "profile"))
            ],
        }

    def __repr__(self) -> str:
        return f"OpenLoopStudy({self.nominal.id!r}: {len(self.found.splits)} splits)"


def _split_row(split: Split) -> dict[str, Any]:
    scores = split.fitted.left_out_mps
    return {
        "kind": split.kind,
        "fitted_to": split.name,
        "train_egain_percent": sorted({row.experiment.case.gait.egain_percent for row in split.train}),
        "test_egain_percent": sorted({row.experiment.case.gait.egain_percent for row in split.test}),
        "parameters": [
            {
                "name": estimate.free.name,
                "value": estimate.value,
                "low": estimate.low,
                "high": estimate.high,
                "nominal": estimate.free.declared.nominal,
                "unit": estimate.free.declared.unit,
            }
            for estimate in split.fitted.estimates
        ],
        "effects": list(split.fitted.tables),
        "left_out_rmse_mps": {"nominal": scores[0], "effects": scores[-1]},
        "tried": [
            {
                "parameters": list(turn.parameters),
                "taken": turn.taken,
                "mse_gain_m2_per_s2": {
                    way: {"value": gain, "interval": [low, high]}
                    for way, (gain, low, high) in turn.gains.items()
                },
            }
            for turn in split.fitted.turns
        ],
        "assumed_sd_mps": split.fitted.sd_mps,
        "train": _errors(split.train),
        "test": _errors(split.test),
        "cases": [_case(row, name) for name in ("train", "test") for row in getattr(split, name)],
    }


def _errors(rows: Sequence[Predicted]) -> dict[str, Any]:
    nominal, effects = rmse_by_group(rows, nominal=True), rmse_by_group(rows)
    mean = [row.error_mps for row in rows if math.isfinite(row.error_mps)]
    swum = [row for row in rows if math.isfinite(row.error_mps)]
    gain = gain_of(
        np.array([row.experiment.error_mps for row in swum]), np.array([row.error_mps for row in swum])
    )
    return {
        "swims": len(rows),
        "failed": sum(not math.isfinite(row.speed_mps) for row in rows),
        "nominal_rmse_mps": nominal["all"],
        "rmse_mps": effects["all"],
        "mse_gain_m2_per_s2": {"value": gain[0], "interval": list(gain[1:])},
        "nominal_mean_error_mps": sum(row.experiment.error_mps for row in rows) / max(len(rows), 1),
        "mean_error_mps": sum(mean) / len(mean) if mean else math.nan,
        "by_group": {
            group: {"nominal_rmse_mps": nominal[group], "rmse_mps": effects.get(group, math.nan)}
            for group in nominal
            if group != "all"
        },
    }


def _case(row: Predicted, use: str) -> dict[str, Any]:
    experiment, gait = row.experiment, row.experiment.case.gait
    return {
        "case": experiment.case.name,
        "use": use,
        "egain_percent": gait.egain_percent,
        "frequency_hz": gait.frequency_hz,
        "phase": gait.phase,
        "measured_mps": experiment.reference.speed_mps,
        "nominal_mps": experiment.model_mps,
        "predicted_mps": row.speed_mps,
        "profile": experiment.profile,
    }


def study_open_loop(
    data_dir: Path | str,
    *,
    test_dir: Path | str | None = None,
    train_egain: Sequence[float] = (),
    test_egain: Sequence[float] = (),
    robot: Robot | str = "frog2022",
    workers: int | None = None,
    progress: Progress = False,
) -> OpenLoopStudy:
    """Fit effects to some groups of measured swims, and predict the speeds of those left out.

    Without further options each EGaIn fraction and each band of frequency is left out in turn. Effects are
    the same for every alloy: alloys differ by their measured limb profiles alone. Effects are taken up only
    where groups of the training swims that are left out of the fit are predicted better by more than the
    sampling error (paired bootstrap over cases); else the nominal model stays.

    Args:
        data_dir: the paper's data, ``exp/``, ``profile/``.
        test_dir: another folder of the kind, to predict; then all of ``data_dir`` is fitted to.
        train_egain: fractions, %, to fit to, one at a time, or with ``test_dir`` together.
        test_egain: fractions, %, to predict; none: all others.
        robot: it, or its name or TOML file.
        workers: processes; None: one for each core.
        progress: of the rounds of fits: True for a bar, or a function of (done, all).

    Raises:
        InputError: no data, a fraction without swims, too few to fit to, or none left to test on.
    """
    nominal = load_robot(robot)
    other = None if test_dir is None else Path(test_dir)
    with shown(progress, "openloop: rounds of fits") as tell:
        cores = workers or os.cpu_count() or 1
        found = open_loop(nominal, Path(data_dir), train_egain, test_egain, cores, tell, other)
    return OpenLoopStudy(nominal, found)
