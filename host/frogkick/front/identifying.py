"""Identification from runs: the effects that a model lacks, and the errors with and without them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.core.progress import in_stages, progress_bar
from frogkick.front.logs import Run, robot_of, run_of
from frogkick.identification.horizons import Horizon
from frogkick.identification.outcome import Outcome, found_toml, write_predictions
from frogkick.identification.outcome import identify as find
from frogkick.identification.segments import Segments, segments_of
from frogkick.identification.terms import FoundEffect, Interval
from frogkick.report.style import page_of
from frogkick.robot import Robot, parse_robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FoundEffect", "Horizon", "Identification", "Interval", "Outcome", "identify"]


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """The result of identification.

    Attributes:
        outcome: the full result; the properties here are those needed most often.
    """

    outcome: Outcome

    @property
    def verdict(self) -> str:
        """``nothing missing``, ``found``, ``found: law``, ``partly explained``, ``unexplained`` or
        ``not enough data``."""
        return self.outcome.verdict

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """The identified effects, with intervals and the effects that they may be confounded with."""
        return self.outcome.effects

    @property
    def before(self) -> PredictionError:
        """Error of the nominal model one period ahead on the test runs: ``position_rmse_m``,
        ``heading_rmse_rad``."""
        return self.outcome.tested.before

    @property
    def after(self) -> PredictionError:
        """The same error with the identified effects."""
        return self.outcome.tested.after

    @property
    def noise_floor(self) -> PredictionError:
        """The error of a perfect model, which the noise of the position fixes causes."""
        return self.outcome.tested.noise_floor

    @cached_property
    def robot(self) -> Robot:
        """The nominal robot with the identified effects, under an id of its own, as ``frog2022-found``."""
        return parse_robot(
            found_toml(self.outcome, renamed=bool(self.effects)), "the robot found", self.outcome.robot.folder
        )

    def report(self, file: Path | str) -> None:
        """Write an HTML page: verdict, errors, tracks, residuals and candidates."""
        from frogkick.report.identify_page import write_identify_page

        write_identify_page(Path(file), self.outcome)

    def plot(self, law: int = 0) -> Figure:
        """Return a matplotlib figure of a law that was found, with the raw residuals beside it.

        Without laws it shows the errors before and after.

        Args:
            law: which of the laws found, in their order.
        """
        from frogkick.report.identify_figures import error_figure
        from frogkick.report.laws import figure_of_law, laws_of

        return figure_of_law(self.outcome, law) if laws_of(self.outcome) else error_figure(self.outcome)

    def predictions(self, file: Path | str) -> None:
        """Write a CSV with one row for each period of each test run: measured, predicted, nominal.

        Raises:
            InputError: the file cannot be written.
        """
        write_predictions(Path(file), self.outcome)

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``identify``."""
        return self.outcome.as_json()

    def __repr__(self) -> str:
        names = ", ".join(term.title for term in self.outcome.terms) or "no effect"
        errors = " / ".join(
            f"{1e3 * error.position_rmse_m:.2f}" for error in (self.before, self.after, self.noise_floor)
        )
        return f"Identification({self.verdict}: {names}; before / after / noise floor {errors} mm)"

    def _repr_html_(self) -> str:
        rows: dict[str, Any] = {"verdict": self.verdict}
        for effect in self.effects:
            title = " ".join([effect.name, *map(str, effect.options.values())])
            rows[title] = ", ".join(map(str, effect.parameters.values()))
        for name in ("before", "after", "noise_floor"):
            rows[name] = str(getattr(self, name))
        if self.outcome.found is None:
            return page_of("Identification", rows)
        from frogkick.report.identify_figures import error_figure

        return page_of("Identification", rows, error_figure(self.outcome))


Given = Run | Path | str
"""A run in memory, or the file of one."""

SAME_M = 3e-5
"""Two fixes are one, rounded, if they differ by less than this, in m and rad."""

LeftOut = Callable[[Sequence[Mapping[str, str]]], None]
"""Called before the work with the runs that are not used: rows with ``run`` and ``reason``."""


@typed
def identify(
    runs: Given | Sequence[Given],
    *,
    test: Given | Sequence[Given],
    robot: Robot | str | None = None,
    effects: Path | str | None = None,
    measured: bool = True,
    laws: bool = True,
    progress: bool = False,
) -> Identification:
    """Identify the physical effects that a robot's model lacks, and predict test runs with and without them.

    Args:
        runs: training runs, or a single one, in memory or as files.
        test: test runs, the same; nothing is fitted to them.
        robot: the nominal robot, its name or its TOML file; None: the one in the logs of the runs, or the
            built-in one of their id.
        effects: a Python file with your own effects, which are tried as well.
        measured: fits of many effects may start from built-in robots that were calibrated before.
        laws: if the catalogue leaves more than noise, search formulas as well (a minute more). A formula that
            is found has ``options["law"]``, and the verdict may be ``found: law``.
        progress: True for bars on stderr.

    Raises:
        InputError: no test run, runs of several robots, or runs that cannot be used.
    """
    runs, test = ([some] if isinstance(some, Given) else some for some in (runs, test))
    for some in (runs, test):
        if some is not None and not isinstance(some, Iterable):
            raise InputError(f"runs are given as {type(some).__name__}: give runs of fk.run, or their files")
    if not test:
        raise InputError("test is empty: give at least one run that is not a training run")
    runs, test = list(runs), list(test)
    trained, tested = (
        [Path(one).resolve() if isinstance(one, str | Path) else one for one in some] for some in (runs, test)
    )
    for each in tested:
        if isinstance(each, Given) and each in trained:
            name = each.source if isinstance(each, Run) else each.name
            raise InputError(
                f"run {name!r} is a training run and a test run: its test would show how well it "
                "was fitted, not how well it is predicted; give each run once"
            )
    logs = [logs_of(some) for some in (runs, test)]
    described = robot_of(logs[0] + logs[1], robot)
    train, kept = ([segments_of(log, name, described) for log, name in some] for some in logs)
    require_held_out(train, kept)
    own = None if effects is None else Path(effects)
    if not progress:
        return Identification(find(train, kept, described, own, measured=measured, laws=laws))
    with in_stages(progress_bar, "identify") as tell:
        found = find(train, kept, described, own, tell, measured, laws)
    with progress_bar("multi-step predictions, next experiment") as last:
        _ = found.horizons, found.experiment
        last(1, 1)
    return Identification(found)


def require_held_out(train: Sequence[Segments], test: Sequence[Segments]) -> None:
    """Refuse runs whose fixes are those of another run, in whole or in part, whatever their files are called.

    Raises:
        InputError: a test run is a training run, or a run is given twice.
    """
    for one, other in product(test, train):
        if _same_fixes(one, other):
            raise InputError(
                f"test run {one.name!r} is training run {other.name!r} once more: its test would show how "
                "well it was fitted, not how well it is predicted; give each run once"
            )
    for one, other in (*combinations(train, 2), *combinations(test, 2)):
        if _same_fixes(one, other):
            raise InputError(
                f"run {other.name!r} is run {one.name!r} once more: it would count twice; give each run once"
            )


def _same_fixes(one: Segments, other: Segments) -> bool:
    """Whether most fixes of the shorter run are in the longer one, rounded or at other times.

    The noise of fixes keeps those of two runs apart.
    """
    from scipy.spatial import cKDTree

    if one.problem or other.problem or not (len(one.pose) and len(other.pose)):
        return False
    poses = [np.column_stack([each.pose[:, :2], each.pose[:, 2] % math.tau]) for each in (one, other)]
    shorter, longer = sorted((np.unique(each, axis=0) for each in poses), key=len)
    apart, _nearest = cKDTree(longer).query(shorter, distance_upper_bound=SAME_M)
    return bool(np.isfinite(apart).mean() > 0.5)


def logs_of(given: Sequence[Given]) -> list[tuple[Run, str]]:
    """Return runs, and their names in messages and tables: paths or numbers where several have one name."""
    names = [each.source if isinstance(each, Run) else Path(each).name for each in given]
    logs = []
    for k, (each, name) in enumerate(zip(given, names, strict=True)):
        told = name
        if names.count(name) > 1:
            told = f"{name} ({1 + names[:k].count(name)})" if isinstance(each, Run) else str(each)
        logs.append((run_of(each), told))
    return logs
