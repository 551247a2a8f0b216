"""What a robot's model lacks, from runs: the effects found, the errors with and without them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.core.progress import progress_bar
from frogkick.front.html import page_of
from frogkick.front.running import Run
from frogkick.identification.horizons import Horizon
from frogkick.identification.outcome import (
    Outcome,
    found_toml,
    robot_of_runs,
    write_predictions,
)
from frogkick.identification.outcome import identify as find
from frogkick.identification.retune import steps
from frogkick.identification.segments import Segments, read_segments, segments_of
from frogkick.identification.verdict import Interval
from frogkick.robot import Robot, load_robot, parse_robot

__all__ = ["FoundEffect", "Horizon", "Identification", "Interval", "Outcome", "identify"]


@dataclass(frozen=True)
class FoundEffect:
    """An effect that explains the runs.

    Attributes:
        name: of the catalogue, or a class of the user's own.
        options: what it acts on, as ``{"limb": "rear_left"}``.
        parameters: name -> value, interval (low, high; 95 %) and unit.
        confounded_with: effects that these runs cannot tell from it.
        stability: in what share of other draws of the training runs it would have been taken, 0 to 1.
    """

    name: str
    options: dict[str, Any]
    parameters: dict[str, Interval]
    confounded_with: tuple[str, ...]
    stability: float


@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """What identification ended with.

    Attributes:
        outcome: all of it; the properties here are what most people ask for.
    """

    outcome: Outcome

    @property
    def verdict(self) -> str:
        """``nothing missing``, ``found``, ``found: law``, ``partly explained``, ``unexplained`` or
        ``not enough data``."""
        return self.outcome.verdict

    @cached_property
    def effects(self) -> tuple[FoundEffect, ...]:
        """What was found, with intervals and with what it may be confounded."""
        found = self.outcome.found
        return tuple(
            FoundEffect(
                term.name,
                term.options,
                {each.name: each for each in row},
                tuple(found.confounded_with[index]),
                found.stability[index],
            )
            for index, (term, row) in enumerate(zip(self.outcome.terms, self.outcome.parameters, strict=True))
            if found is not None
        )

    @property
    def before(self) -> PredictionError:
        """Error of the nominal model a period ahead on the test runs: ``position_rmse_m``,
        ``heading_rmse_rad``."""
        return self.outcome.tested.before

    @property
    def after(self) -> PredictionError:
        """The same with the effects found."""
        return self.outcome.tested.after

    @property
    def noise_floor(self) -> PredictionError:
        """What is left for any model, because position fixes scatter."""
        return self.outcome.tested.noise_floor

    @cached_property
    def robot(self) -> Robot:
        """The nominal robot with the effects found."""
        return parse_robot(
            found_toml(self.outcome), source="the robot found", folder=self.outcome.robot.folder
        )

    def report(self, file: Path | str) -> None:
        """Write an HTML page: verdict, errors, tracks, residuals, what was tried."""
        from frogkick.report.identify_page import write_identify_page

        write_identify_page(Path(file), self.outcome)

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
            told = ", ".join(
                f"{p.name} {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit}"
                for p in effect.parameters.values()
            )
            rows[" ".join([effect.name, *map(str, effect.options.values())])] = told
        for name in ("before", "after", "noise_floor"):
            rows[name] = str(getattr(self, name))
        if self.outcome.found is None:
            return page_of("Identification", rows)
        from frogkick.report.identify_figures import error_figure

        return page_of("Identification", rows, error_figure(self.outcome))


Given = Run | Path | str
"""A run in memory, or its file."""

LeftOut = Callable[[Sequence[Mapping[str, str]]], None]
"""Told of runs that are not used, before the work: rows with ``run`` and ``reason``."""


def identify(
    runs: Given | Sequence[Given],
    *,
    test: Given | Sequence[Given],
    robot: Robot | str | None = None,
    effects: Path | str | None = None,
    measured: bool = True,
    laws: bool = False,
    progress: bool = False,
) -> Identification:
    """Trace what a robot's model lacks to physical effects, and predict other runs with and without them.

    Args:
        runs: to learn from, or one alone, in memory or their files.
        test: to predict, the same; nothing is learned from them.
        robot: the nominal one, or its name or TOML file; None: the runs' own.
        effects: a Python file of effects of your own, tried as well.
        measured: fits of many effects may start from the values of built-in robots that were measured before.
        laws: where the catalogue leaves more than noise, search formulas as well (minutes more). What was
            found has ``options["law"]`` then, and the verdict may be ``found: law``.
        progress: True for bars on stderr.

    Raises:
        InputError: no test run, runs of several robots, or runs that cannot be used.
    """
    runs, test = ([some] if isinstance(some, Given) else some for some in (runs, test))
    if not test:
        raise InputError("test is empty: give at least one run that is kept out of learning")
    described = robot
    if not isinstance(described, Robot):
        described = load_robot(
            described or robot_of_runs([segments_of_given(each, None) for each in (*runs, *test)])
        )
    train, kept = ([segments_of_given(each, described) for each in some] for some in (runs, test))
    own = None if effects is None else Path(effects)
    if not progress:
        return Identification(find(train, kept, described, own, measured=measured, laws=laws))
    with steps(progress_bar) as tell:
        found = find(train, kept, described, own, tell, measured, laws)
    with progress_bar("several periods ahead, what to record next") as last:
        _ = found.horizons, found.experiment
        last(1, 1)
    return Identification(found)


def segments_of_given(given: Given, robot: Robot | None) -> Segments:
    """A run as identification takes it; ``robot`` is whose it is to be, None = the run's own."""
    if isinstance(given, Run):
        return segments_of(given.log, given.log.source, robot)
    return read_segments(given, robot)
