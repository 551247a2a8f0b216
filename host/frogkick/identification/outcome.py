"""Identification as a whole: runs in; the effects found, and how well they predict other runs, out."""

from __future__ import annotations

import csv
import io
import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.files import write_text
from frogkick.core.poses import PredictionError, wrap_angle
from frogkick.core.progress import TellStage, silent
from frogkick.identification.batching import Budget, limited
from frogkick.identification.choice import (
    discovered,
    found_in,
    in_all_fixes,
    pruned,
    with_jumps,
    with_misfires,
)
from frogkick.identification.diagnostics import (
    Drift,
    drift_of,
    fix_innovations,
    missing_wrench,
    residual_diagnostics,
    stroke_ratios,
)
from frogkick.identification.experiment import Experiment, experiment_of, law_test
from frogkick.identification.filter import Noise
from frogkick.identification.fit import Model, rollouts_of
from frogkick.identification.horizons import Horizon, horizons_of
from frogkick.identification.jumps import jumps_of, turns_of, without_jumps
from frogkick.identification.laws import MOMENT, moment_intervals
from frogkick.identification.predict import Rollout
from frogkick.identification.search import Found, nominal_fit
from frogkick.identification.segments import Segments, reliable, too_little
from frogkick.identification.terms import FoundEffect, Interval, Term, catalogue, unfittable
from frogkick.identification.verdict import (
    FEW_PERIODS,
    FOUND,
    FOUND_LAW,
    PARTLY,
    TOO_LITTLE,
    Scored,
    discretisation_shift,
    fix_noise,
    grid_intervals,
    intervals,
    noise_floor,
    prediction_errors,
    scored,
    verdict_of,
)
from frogkick.robot import Robot
from frogkick.robot.rewriting import own_id
from frogkick.robot.toml_text import to_toml

EVALUATIONS_MOST, EVALUATIONS_MOST_LAWS = 400, 1000
"""How often a search may simulate all runs, without laws and with them."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Predictions of the test runs with the drift tracked within each run, without and with effects."""

    before: PredictionError
    after: PredictionError
    nominal_rollouts: list[Rollout]
    rollouts: list[Rollout]

    def as_json(self) -> dict[str, Any]:
        """The key ``test.followed`` of the command ``identify``."""
        return {"before": self.before.as_json(), "after": self.after.as_json()}


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of identification.

    Attributes:
        verdict: see ``verdict_of``.
        train, test: the runs.
        found: result of the search; None if there was not enough data.
        parameters: intervals of the parameters of each term.
        trained, tested: evaluation of the models alone.
        nominal_rollouts, rollouts: rollouts of the test runs, by the models alone.
        drift: drift of limbs beside the fitted model, from the training runs; None if tracking it gains
            nothing.
        followed: the test runs with drift tracked beside both models; None if neither gains.
        dropped: effects that explain the training runs but did not raise the log score of the test runs, so
            that the nominal model is returned. The test runs decide this and nothing else.
        diagnostics: residual diagnostics of the fitted model, or for "nothing missing" of the nominal one.
        reason: what to record where there was not enough data.
        left_out: runs whose stroke times are unreliable: ``run`` and ``reason`` of each.
        evaluations: how often all training runs were simulated.
        ended_early: the search ended by its bound of evaluations, and effects may be missing.
        untried: a sentence for each effect of the user's file that was not searched for.
    """

    verdict: str
    robot: Robot
    train: Sequence[Segments]
    test: Sequence[Segments]
    found: Found | None
    parameters: list[list[Interval]]
    trained: Scored
    tested: Scored
    nominal_rollouts: list[Rollout]
    rollouts: list[Rollout]
    diagnostics: dict[str, Any]
    reason: str = ""
    drift: Drift | None = None
    left_out: Sequence[dict[str, str]] = ()
    followed: Followed | None = None
    dropped: tuple[str, ...] = ()
    evaluations: int = 0
    ended_early: bool = False
    untried: tuple[str, ...] = ()

    @property
    def terms(self) -> tuple[Term, ...]:
        """Effects found."""
        return () if self.found is None else self.found.fitted.model.terms

    @property
    def few_tested(self) -> str:
        """What to say of effects that were dropped after a short test; "" after a long one."""
        count = self.tested.after.count
        if count >= FEW_PERIODS:
            return ""
        periods = "1 period" if count == 1 else f"{count} periods"
        return f"the test runs have only {periods}: with {FEW_PERIODS} or more a small gain can be told"

    @cached_property
    def horizons(self) -> list[Horizon]:
        """Multi-step prediction errors on the test runs; none where there was not enough data."""
        if self.found is None:
            return []
        return horizons_of(self.found.nominal.model, self.found.fitted.model, self.test)

    @cached_property
    def experiment(self) -> Experiment | None:
        """What to record to discriminate models that are still confounded; None if none are.

        If nothing else is open, the experiment compares a law with the model without it.
        """
        if self.found is None or self.verdict not in (FOUND, FOUND_LAW, PARTLY):
            return None
        return experiment_of(self.found, self.parameters, self.train) or self.law_test

    @cached_property
    def law_test(self) -> Experiment | None:
        """What to record to confirm or refute a law; None without one."""
        return None if self.found is None else law_test(self.found, self.train)

    @cached_property
    def effects(self) -> tuple[FoundEffect, ...]:
        """What was found."""
        if self.found is None:
            return ()
        found = zip(
            self.terms, self.parameters, self.found.confounded_with, self.found.stability, strict=True
        )
        return tuple(
            FoundEffect(term.name, term.options, {each.name: each for each in row}, tuple(others), share)
            for term, row, others, share in found
        )

    def effects_as_json(self) -> list[dict[str, Any]]:
        """The key ``effects`` of the command ``identify``."""
        return [effect.as_json() for effect in self.effects]

    @cached_property
    def residuals(self) -> dict[str, Any] | None:
        """What is left of the training runs, as quantities that can be read; None without a search.

        ``wrench``: the missing force and torque of each third of a period, with covariance; ``strokes``: the
        log likelihood ratio of fired over not fired; both are None if laws were not looked for. ``fixes``:
        innovations in robust standard deviations.
        """
        if self.found is None:
            return None
        found, responses = self.found, self.found.responses
        fixes = fix_innovations(found.fitted, self.train)
        if responses is None:
            return {"wrench": None, "strokes": None, "fixes": fixes}
        limbs = [limb.name for limb in self.robot.limbs]
        wrench = missing_wrench(found.fitted, responses, found.data)
        return {
            "wrench": wrench.as_json([swim.name for swim in self.train]),
            "strokes": stroke_ratios(found.fitted, responses, found.data, limbs),
            "fixes": fixes,
        }

    def tested_as_json(self) -> dict[str, Any]:
        """The key ``test`` of the command ``identify``."""
        return {
            **self.tested.as_json(),
            "followed": None if self.followed is None else self.followed.as_json(),
            "horizons": [each.as_json() for each in self.horizons],
        }

    def as_json(self) -> dict[str, Any]:
        """The keys of the command ``identify``."""
        return {
            "verdict": self.verdict,
            "effects": self.effects_as_json(),
            "dropped": list(self.dropped),
            "train": self.trained.as_json(),
            "test": self.tested_as_json(),
            "drift": None if self.drift is None else self.drift.as_json(),
            "signature": self.diagnostics,
            "residuals": self.residuals,
            "experiment": None if self.experiment is None else self.experiment.as_json(),
            "runs": [
                {"run": swim.name, "use": use, "period_s": swim.period_s}
                for use, swims in (("train", self.train), ("test", self.test))
                for swim in swims
            ],
            "left_out": list(self.left_out),
            "search": {"evaluations": self.evaluations, "ended_early": self.ended_early},
            "untried": list(self.untried),
            **({"reason": self.reason} if self.reason else {}),
        }


def identify(
    train: Sequence[Segments],
    test: Sequence[Segments],
    robot: Robot,
    own: Path | None = None,
    progress: TellStage = silent,
    measured: bool = True,
    laws: bool = False,
) -> Outcome:
    """Find the effects that a robot's model lacks from some runs, and predict others with and without them.

    For the options see ``frogkick.identify``; ``own`` is a file of the user's own effects.

    Raises:
        InputError: the user's effects cannot be used, no period of the runs can be judged, no test run has
            one, or no run's clock can be relied on.
    """
    periods = max(sum(len(swim.start_s) for swim in train if not swim.problem), 1)
    with limited(EVALUATIONS_MOST * periods) as budget:
        outcome = _identified(train, test, robot, own, progress, measured, laws, budget)
    spent, ended_early = budget.spent // periods, budget.ended_search
    return replace(outcome, evaluations=spent, ended_early=ended_early, untried=unfittable(own))


def _identified(
    train: Sequence[Segments],
    test: Sequence[Segments],
    robot: Robot,
    own: Path | None,
    progress: TellStage,
    measured: bool,
    laws: bool,
    budget: Budget,
) -> Outcome:
    """See ``identify``."""
    candidates = catalogue(robot, own)
    train, left_out = reliable(train)
    test, more = reliable(test)
    left_out += more
    train = [swim for swim in train if len(swim.start_s)]
    test = [swim for swim in test if len(swim.start_s)]
    if not test:
        raise InputError("no test run has a whole period with fixes: give --test a longer run")
    reason = too_little(train)
    if reason:
        return replace(_only_predicted(train, test, robot, reason), left_out=left_out)
    raw = train, test
    jumps = []
    for kind in (jumps_of, turns_of) if laws else ():
        if (seen := kind(train)) is not None:
            jumps.append(seen)
            train, test = (without_jumps(swims, seen.of_heading) for swims in (train, test))
    found = found_in(train, robot, candidates, progress, measured)
    if laws:
        budget.most *= EVALUATIONS_MOST_LAWS / EVALUATIONS_MOST
        found = discovered(found, candidates, robot, progress)
    if jumps and (plain := in_all_fixes(found, raw[0], robot)) is not None:
        found, (train, test), jumps = plain, raw, []
    found = with_misfires(pruned(found, progress))
    found = with_jumps(found, jumps, raw[0], robot)
    trained = scored(found, train, found.nominal.rollouts, found.fitted.rollouts, (raw[0], raw[0]))
    models = [found.nominal.model, found.fitted.model]
    if not jumps:
        nominal_rollouts, rollouts = rollouts_of(models, test)
    else:
        nominal_rollouts, rollouts = rollouts_of(models[:1], raw[1])[0], rollouts_of(models[1:], test)[0]
    tested = scored(found, test, nominal_rollouts, rollouts, raw)
    dropped = tuple(term.title for term in found.fitted.model.terms) if not tested.helped else ()
    if dropped:
        # Effects that do not help on other runs are no part of the model that is returned.
        train, test = raw
        data, nominal = nominal_fit(train, robot) if jumps else (found.data, found.nominal)
        plain = Found(data, nominal, nominal, found.iterations, [], found.sensitivities)
        found = replace(plain, responses=None if jumps else found.responses)
        trained = scored(found, train, nominal.rollouts, nominal.rollouts)
        rollouts = nominal_rollouts
        tested = scored(found, test, rollouts, rollouts)
    drift, followed = _followed(found, test, nominal_rollouts, rollouts, robot)
    return Outcome(
        verdict=verdict_of(found, trained, tested),
        robot=robot,
        train=train,
        test=test,
        found=found,
        parameters=_parameters(found),
        trained=trained,
        tested=tested,
        nominal_rollouts=nominal_rollouts,
        rollouts=rollouts,
        diagnostics=residual_diagnostics(found.fitted, found.data),
        drift=drift,
        followed=followed,
        dropped=dropped,
        left_out=left_out,
    )


def _parameters(found: Found) -> list[list[Interval]]:
    """Intervals of each term's parameters. Those of chances are known: no prediction depends on them."""
    by_chance: list[list[Interval]] = []
    if found.misfires is not None:
        by_chance += [[chance] for chance in found.misfires.chance]
    by_chance += [[each.chance, each.size] for each in found.jumps]
    fitted = found.fitted.first(len(found.fitted.model.terms) - len(by_chance))
    known = intervals(fitted, found.data, discretisation_shift(fitted, found.data))
    alike = grid_intervals(fitted, found.data)
    for place, row in enumerate(known):
        pairs = zip(fitted.model.indices(place), row, strict=True)
        known[place] = [each.reaching(*alike[k]) if k in alike else each for k, each in pairs]
    for place, (low, high) in moment_intervals(fitted, found.data).items():
        known[place] = [replace(p, low=low, high=high) if p.name == MOMENT else p for p in known[place]]
    return [*known, *by_chance]


def _followed(
    found: Found,
    test: Sequence[Segments],
    nominal_rollouts: Sequence[Rollout],
    rollouts: Sequence[Rollout],
    robot: Robot,
) -> tuple[Drift | None, Followed | None]:
    """Drift beside the fitted model, and the test runs with each model's own drift tracked."""
    drifts = [drift_of(each.rollouts, found.data.swims, robot) for each in (found.nominal, found.fitted)]
    if drifts == [None, None]:
        return None, None
    moved = [
        list(some) if drift is None else drift.followed(some, test, robot)
        for drift, some in zip(drifts, (nominal_rollouts, rollouts), strict=True)
    ]
    before, after = (PredictionError.of(prediction_errors(each, test)) for each in moved)
    return drifts[1], Followed(before, after, moved[0], moved[1])


def _only_predicted(
    train: Sequence[Segments], test: Sequence[Segments], robot: Robot, reason: str
) -> Outcome:
    """Too little data: the test runs by the nominal model, at the default noise."""
    model = Model(robot, (), Noise())
    rollouts = rollouts_of([model], test)[0]
    error = PredictionError.of(prediction_errors(rollouts, test))
    tested = Scored(error, error, noise_floor(test, fix_noise(test) or model.noise.fix))
    unknown = PredictionError()
    trained = Scored(unknown, unknown, unknown)
    signed = {"text": f"not looked for: {reason}"}
    return Outcome(
        TOO_LITTLE, robot, train, test, None, [], trained, tested, rollouts, rollouts, signed, reason
    )


def write_predictions(target: Path, outcome: Outcome) -> None:
    """Write one row for each period of each test run, in the run's own frame, predicted by the models alone.

    Where tracking drift gains something, the columns ``_followed`` and ``_nominal_followed`` are added.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    poses = ("x_m", "y_m", "heading_rad")
    predicted = ("x_pred_m", "y_pred_m", "heading_pred_rad")
    header = ["run", "time_s", "horizon_s", *poses]
    models = [outcome.rollouts, outcome.nominal_rollouts]
    kinds = ["", "_nominal"]
    if outcome.followed is not None:
        models += [outcome.followed.rollouts, outcome.followed.nominal_rollouts]
        kinds += ["_followed", "_nominal_followed"]
    writer.writerow([*header, *(f"{name}{kind}" for kind in kinds for name in predicted)])
    for index, swim in enumerate(outcome.test):
        for k, start_s in enumerate(swim.start_s):
            row = np.concatenate([swim.measured[k], *(rollouts[index].predicted[k] for rollouts in models)])
            if not np.isfinite(row).all():
                continue
            row[2::3] = wrap_angle(row[2::3])
            horizon_s = swim.end_s[k] - start_s
            writer.writerow([swim.name, f"{start_s:.6f}", f"{horizon_s:.6f}", *(f"{v:.7f}" for v in row)])
    write_text(target, text.getvalue())


def write_robot(target: Path, outcome: Outcome) -> None:
    """Write the nominal robot's TOML with the effects found."""
    write_text(target, found_toml(outcome, target.resolve().parent))


def found_toml(
    outcome: Outcome, folder: Path | None = None, terms: Sequence[Term] | None = None, renamed: bool = False
) -> str:
    """The nominal robot's text with the effects found.

    Args:
        folder: folder that paths of the user's effect files are relative to; None: the nominal robot's.
        terms: of those found, the ones to write; None: all.
        renamed: with an id of its own. A robot takes no table of another id.
    """
    table = tomllib.loads(outcome.robot.toml) | (own_id(outcome.robot) if renamed else {})
    place = folder or outcome.robot.folder or Path()
    effects = [dict(row) for row in table.get("effect", [])]
    for row in effects:
        if "file" in row and outcome.robot.folder is not None:
            row["file"] = os.path.relpath(outcome.robot.folder / str(row["file"]), place)
    for term in outcome.terms if terms is None else terms:
        row = term.toml
        if "file" in row:
            row["file"] = os.path.relpath(term.folder / str(row["file"]), place)
        effects.append(row)
    if effects:
        table["effect"] = effects
    return to_toml(table)
