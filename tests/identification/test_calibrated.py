"""Many effects fitted jointly, from the values of a robot that was calibrated before."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import make_swim, robot
from tests.conftest import from_ci

from frogkick.core.poses import PredictionError
from frogkick.identification import calibrated as module
from frogkick.identification.calibrated import best_end_deviance, calibrated_starts, end_deviance, refitted
from frogkick.identification.filter import Noise
from frogkick.identification.fit import EFFECT_PENALTY, Model, derivatives, rollouts_of
from frogkick.identification.predict import Rollout
from frogkick.identification.search import nominal_fit
from frogkick.identification.segments import read_segments
from frogkick.identification.terms import catalogue
from frogkick.identification.verdict import prediction_errors
from frogkick.robot import load_robot
from frogkick.robot.template import new_robot_text

GENERIC = {
    "hull": (1.5, 0.85, 0.5, 4.0),
    "limb_mount front": (30.0,),
    "limb_mount rear": (30.0,),
    "limb_fatigue front": (0.1, 2.0),
    "limb_fatigue left": (0.0, 2.5),
    "limb_wear rear_left": (0.83, 0.0, 1.0),
    "munk_moment": (0.1,),
    "off_centre_mass": (0.0, -0.001),
}
"""Rough values; the gains of limbs are those of the file. Three short runs do not tell a slow return of one
limb or a fatigue of the left ones: both stay nominal."""


def test_a_robot_measured_before_is_a_relative_of_its_own_body_alone() -> None:
    found = calibrated_starts(load_robot("frog2022"))
    assert set(found) == {"frog2022-measured"}
    assert {"hull", "munk_moment"} <= {term.name for term in found["frog2022-measured"]}
    assert calibrated_starts(load_robot("hexapod")) == {}
    alone = {term.name for term in catalogue(load_robot("frog2022"))}
    assert not {"hull", "limb_mount", "limb_fatigue", "munk_moment"} & alone, "told together only"


WEAR_OF_THREE = {f"limb_wear {name}" for name in ("front_right", "front_left", "tail", "all")}
GAINS = {
    1: {"limb_wear tail"},
    2: {"limb_wear front_right", "limb_wear front_left", "limb_wear all"},
    3: WEAR_OF_THREE | {"group_gain front"},
}


@pytest.mark.parametrize("limbs", GAINS)
def test_gains_of_limbs_are_searched_for_once_each(tmp_path: Path, limbs: int) -> None:
    """A group of one limb, or of all, would be another name for the wear of that limb or of all."""
    file = tmp_path / "few.toml"
    file.write_text(new_robot_text(load_robot("frog2022"), "few", limbs))
    terms = catalogue(load_robot(file))
    assert {term.title for term in terms if term.name in ("limb_wear", "group_gain")} == GAINS[limbs]


@from_ci
def test_a_robot_that_swims_as_drawn_is_no_relative() -> None:
    swims = [make_swim([], seed, 14) for seed in (3, 4)]
    data, nominal = nominal_fit(swims, robot())
    assert refitted(nominal, calibrated_starts(load_robot("frog2022"))["frog2022-measured"], data) is None


@from_ci
def test_a_fit_without_measured_values_starts_from_nominal_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which effects and parameters a calibrated start has is kept, but none of its values."""
    swims = [make_swim([], seed, 5) for seed in (3, 4)]
    data, nominal = nominal_fit(swims, robot())
    begun: list[tuple[list[float], frozenset[int], int]] = []

    def run(self: module.GaussNewton, _steps_max: int) -> Model:
        periods = sum(len(swim.start_s) for swim in self.swims)
        begun.append((self.model.values.tolist(), self.model.fixed, periods))
        return self.model

    monkeypatch.setattr(module.GaussNewton, "run", run)
    monkeypatch.setattr(module, "PART", 4)
    terms = calibrated_starts(load_robot("frog2022"))["frog2022-measured"]
    measured = [value for term in terms for value in term.values]
    plain = [p.nominal for term in terms for p in term.parameters]
    refitted(nominal, terms, data, measured=False)
    assert [values for values, *_ in begun] == [plain, plain]
    assert [periods for *_, periods in begun] == [4, 10] or begun[0][2] < begun[1][2]
    fixed = {k for k, pair in enumerate(zip(measured, plain, strict=True)) if pair[0] == pair[1]}
    assert begun[0][1] == fixed and len(fixed) < len(plain) - 10


def test_a_model_is_held_against_at_its_best_noise() -> None:
    """A process noise that is too small for a wrong model makes its predictions worse than necessary."""
    swims = [make_swim([{"name": "limb_wear", "limb": "front_left", "gain": 0.4}], 3, 8)]
    data, nominal = nominal_fit(swims, robot())
    sure = replace(nominal.model, noise=Noise((5e-3, 5e-2), (2e-5, 5e-4), (2e-5, 5e-4)))
    (fitted,) = derivatives([sure], data)
    assert best_end_deviance(fitted, swims) < end_deviance(fitted.rollouts, swims) - 5.0
    assert best_end_deviance(nominal, swims) <= end_deviance(nominal.rollouts, swims)


@from_ci
def test_a_relative_must_beat_nominal_at_its_best_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect that does nothing must not gain by being tried at better noises than the nominal model."""
    swims = [make_swim([{"name": "limb_wear", "limb": "front_left", "gain": 0.4}], 3, 20)]
    data, nominal = nominal_fit(swims, robot())
    sure = replace(nominal.model, noise=Noise((5e-3, 5e-2), (2e-5, 5e-4), (2e-5, 5e-4)))
    (fitted,) = derivatives([sure], data)
    idle = next(each for each in catalogue(robot()) if each.title == "steady_wrench")
    monkeypatch.setattr(module, "START_GAIN", -1e6)  # only what comes after the descent is asked
    monkeypatch.setattr(module.GaussNewton, "run", lambda descent, *_steps_max: descent.model)
    assert end_deviance(fitted.rollouts, swims) - best_end_deviance(fitted, swims) > EFFECT_PENALTY
    assert refitted(fitted, [idle], data) is None


@given(st.integers(0, 10_000), st.integers(20, 120), st.floats(0.0, 0.4), st.floats(0.0, 3.0))
@settings(max_examples=60, deadline=None)
def test_worse_predictions_are_never_likelier(seed: int, count: int, wild: float, worse: float) -> None:
    """Every residual grows in its own direction by a factor of its own; some are outliers from the start."""
    rng = np.random.default_rng(seed)
    residuals = rng.standard_normal((count, 3)) * (3e-4, 3e-4, 4e-3)
    residuals[rng.random(count) < wild] *= rng.uniform(2.0, 40.0)
    factor = 1.0 + worse * rng.random((count, 1))
    here, there = ends_of(residuals), ends_of(factor * residuals)
    assert end_deviance(*there) >= end_deviance(*here) - 1e-4
    if worse > 1e-3:
        assert end_deviance(*ends_of((1.0 + worse) * residuals)) > end_deviance(*here)


def test_a_core_with_strays_is_no_worse_than_predictions_that_are_all_bad() -> None:
    """A quarter of large residuals among precise ones, as of a limb that misfires, against large ones."""
    rng = np.random.default_rng(5)
    residuals = rng.standard_normal((100, 3)) * (3e-4, 3e-4, 4e-3)
    residuals[:25] += rng.standard_normal((25, 3)) * (3.5e-3, 3.5e-3, 0.1)
    bad = residuals + rng.standard_normal((100, 3)) * (5.5e-3, 5.5e-3, 0.06)
    assert end_deviance(*ends_of(residuals)) < end_deviance(*ends_of(bad)) - 100.0


def ends_of(residuals: np.ndarray) -> Any:
    """A rollout and a run with these residuals at the ends of periods; headings are zero."""
    none, nothing = np.empty(0), np.zeros((len(residuals), 6))
    rollout = Rollout(none, none, none, nothing[:, :3], nothing, none, failed=False)
    return [rollout], [SimpleNamespace(measured=residuals)]


@from_ci
def test_effects_fitted_to_recorded_runs_predict_another_one(
    frog2022_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two steps from rough values on short training runs; one run is held out."""
    monkeypatch.setattr(module, "STEPS_MAX", 2)
    model, names = load_robot("frog2022"), ("line1", "sin3", "sin1")
    train = [read_segments(frog2022_dir / "control" / f"{name}.csv", model) for name in names]
    test = [read_segments(frog2022_dir / "control" / "ellipse5.csv", model)]
    data, nominal = nominal_fit(train, model)
    start = [
        term.at(GENERIC.get(term.title, term.values))
        for term in calibrated_starts(model)["frog2022-measured"]
    ]
    fitted = refitted(nominal, start, data)
    assert fitted is not None
    after, before = (
        PredictionError.of(prediction_errors(rollouts, test))
        for rollouts in rollouts_of([fitted.model, nominal.model], test)
    )
    assert before.heading_rmse_rad > np.radians(6.0) and before.position_rmse_m > 0.007
    assert after.heading_rmse_rad < np.radians(4.5) and after.position_rmse_m < 0.006
