"""One water for all alloys and builds: what is planted is found, what is unknown is integrated over."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.identification.made import robot, robot_option
from tests.validation.paper_data import write_swim
from typer.testing import CliRunner

from frogkick.cli.app import app
from frogkick.core.arrays import Float64
from frogkick.effects import rods_of
from frogkick.effects.swims import Gait
from frogkick.identification.calibrated import NOISES, GaussNewton
from frogkick.identification.fit import Model
from frogkick.robot import load_robot
from frogkick.validation.gaits import GaitSwim, swim_gaits
from frogkick_studies.hierarchy import NOISE_MPS, OFFSET_SD, Z90, Estimate, Speeds, fit_swims, unseen
from frogkick_studies.shared import OWN, Informed, waters
from frogkick_studies.steady import Simulation, Table, with_effects
from frogkick_studies.water import started

DRAG = waters(load_robot("frog2022"))[OWN[0]]
GAITS = [Gait(alloy, hz, 0.5) for alloy in (10.0, 20.0, 30.0) for hz in (0.5, 0.7, 0.9, 1.1, 1.3, 1.5)]


class Formula(Simulation):
    """Speeds by a formula instead of rods, so that hundreds of fits can be looked at."""

    def __init__(self) -> None:
        super().__init__(load_robot("frog2022"), (), 1)

    def speeds(self, effects: Sequence[Sequence[Table]], gaits: Sequence[Gait]) -> Float64:
        found = np.empty((len(effects), len(gaits)))
        for row, tables in enumerate(effects):
            value = {key: each for table in tables for key, each in table.items()}
            limb, frame = (np.log(value[name]) for name in ("limb_drag", "frame_drag"))
            slow = np.log(value["duration_scale"])
            for column, gait in enumerate(gaits):
                thrust = 0.03 * gait.frequency_hz * np.exp(0.4 * limb - 0.6 * frame)
                late = 1.0 - 0.3 * slow * gait.frequency_hz
                found[row, column] = thrust * late * value["gain"] ** 2
        return found


def speeds_of(gaits: Sequence[Gait], builds: Sequence[str]) -> Speeds:
    return Speeds(Formula(), DRAG, gaits, builds)


def test_fits_find_what_the_swims_show_and_say_how_well() -> None:
    """The errors of all numbers over planted robots are as large as the fits say: 90 % within 90 %."""
    rng = np.random.default_rng(3)
    speeds = speeds_of(GAITS, [f"{gait.egain_percent:g}" for gait in GAITS])
    inside, away = [], []
    for _ in range(40):
        planted = speeds.expected + 0.5 * rng.normal(size=speeds.size)
        (clean,) = speeds.of([planted])
        estimate, *_ = speeds.fitted(clean + NOISE_MPS * rng.normal(size=len(clean)))
        sd = np.sqrt(np.diag(estimate.covariance))
        inside.append(np.abs(estimate.at - planted) < Z90 * sd)
        away.append((estimate.at - planted) / sd)
    assert np.mean(inside) > 0.9
    assert 0.3 < np.std(away) < 1.1


def test_an_unknown_alloy_is_integrated_over() -> None:
    """Against a sum over ten thousand draws of amplitude, time scale and offset."""
    speeds = speeds_of(GAITS, ["one"] * len(GAITS))
    (measured,) = speeds.of([speeds.expected])
    estimate, *_ = speeds.fitted(measured)
    other = [Gait(50.0, hz, 0.5) for hz in (0.6, 1.4)]
    found = unseen(speeds, estimate, other)
    rng = np.random.default_rng(1)
    there = speeds_of(other, ["of 50 %"] * 2)
    covariance = np.eye(there.size)
    covariance[:2, :2] = estimate.covariance[:2, :2]
    centre = np.concatenate([estimate.at[:2], np.zeros(there.size - 2)])
    draws = rng.multivariate_normal(centre, covariance, size=10_000)
    drawn = there.of(list(draws)) + NOISE_MPS * rng.normal(size=(len(draws), 2))
    for k, each in enumerate(found):
        assert each.mean_mps == pytest.approx(drawn[:, k].mean(), rel=0.02)
        inside = (drawn[:, k] > each.low_mps) & (drawn[:, k] < each.high_mps)
        assert inside.mean() == pytest.approx(0.9, abs=0.03)
    assert found[0].high_mps - found[0].low_mps > 4.0 * NOISE_MPS


def test_an_alloy_that_is_left_out_has_wide_intervals_and_does_not_teach() -> None:
    labels = [f"{gait.egain_percent:g}" for gait in GAITS]
    speeds = speeds_of(GAITS, ["one"] * len(GAITS))
    (measured,) = speeds.of([speeds.expected])
    spoiled = np.where(speeds.alloy == 1, 1.3 * measured, measured)
    fit, _ = fit_swims(speeds, spoiled, {"egain": labels})
    left = fit.left_out["egain"]
    assert left.by_group["20"] == pytest.approx(
        0.3 * float(np.sqrt((measured**2)[speeds.alloy == 1].mean())), rel=0.2
    )
    assert left.inside == 1.0 and fit.rmse_mps < 0.3 * left.rmse_mps
    value, low, high = fit.values["20 % EGaIn gain"]
    assert low < value < high and value > 1.05


def test_what_runs_say_of_the_water_moves_it_and_nothing_else_is_lost() -> None:
    speeds = speeds_of(GAITS, ["one"] * len(GAITS))
    (measured,) = speeds.of([speeds.expected])
    alone, base, columns = speeds.fitted(measured)
    sure = Estimate(np.array([1.0, 1.0]), 1e-6 * np.eye(2))
    told = speeds.posterior(base, columns, alone.at, measured, sure)
    assert told.at[:2] == pytest.approx(sure.at, abs=1e-3)
    vague = Estimate(np.array([5.0, -5.0]), 1e9 * np.eye(2))
    same = speeds.posterior(base, columns, alone.at, measured, vague)
    assert same.at == pytest.approx(alone.at, abs=1e-3)
    assert speeds.cost(alone.at, base, measured, sure) > speeds.cost(alone.at, base, measured, vague)
    assert OFFSET_SD > 0.0


def test_a_step_on_runs_weighs_what_is_known_besides() -> None:
    """Without it the step is that of GaussNewton; the surer it is, the nearer the step comes to it."""
    terms, fixed = started(load_robot("frog2022"), ())
    model = Model(load_robot("frog2022"), terms, NOISES[0], fixed=fixed)
    rng = np.random.default_rng(2)
    plain, fit = GaussNewton(model, []), Informed(model, [])
    at = plain._scaled(model.values)
    base = rng.normal(size=(60, 3)) * [0.004, 0.004, 0.05]
    columns = rng.normal(size=(60, 3, len(at))) * 0.01
    expected = plain.stepped(at, base, columns, 1e-3)
    assert np.array_equal(fit.stepped(at, base, columns, 1e-3).values, expected.values)
    gaps = []
    for sure in (0.0, 1.0, 1e4):
        fit.known, fit.mean, fit.root = [2, 3], at[[2, 3]] + 0.1, sure * np.eye(2)
        moved = fit._scaled(fit.stepped(at, base, columns, 1e-3).values)
        gaps.append(np.abs(moved[[2, 3]] - fit.mean).max())
    assert gaps[0] > gaps[1] > gaps[2] and gaps[2] < 1e-3


@from_ci
def test_the_study_tells_every_water(tmp_path: Path) -> None:
    """Swims of a robot with twice the limbs' drag: they show it, and no recorded runs are asked for."""
    planted = with_effects(robot(), [{"name": "hull", "limb_drag": 2.0}])
    gaits = [Gait(egain, hz, 0.5) for egain in (10.0, 30.0) for hz in (0.8, 1.1)]
    for gait, swim in zip(gaits, swim_gaits(rods_of(planted), planted.profiles, gaits), strict=True):
        assert isinstance(swim, GaitSwim)
        name = f"exp/freq/{gait.egain_percent:g}/{gait.frequency_hz:g}Hz.mat"
        write_swim(tmp_path / name, swim.speed_mps, gait.frequency_hz, 3.0)
    given = ["study", "shared", str(tmp_path), "--robot", robot_option(tmp_path), "--no-runs"]
    done = CliRunner().invoke(app, [*given, "--workers", "1", "--json", "--out", str(tmp_path / "s.png")])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)["waters"]
    assert [row["name"] for row in told] == list(waters(robot()))
    first = told[0]
    value, low, high = first["swims"]["swims"]["values"]["hull.limb_drag"]
    assert low < value < high and low < 2.0 < high
    assert first["swims"]["swims"]["rmse_mps"] < NOISE_MPS
    assert set(first["swims"]["swims"]["left_out"]) == {"egain", "frequency", "series"}
    assert not first["runs"]
    assert {row["egain_percent"] for row in first["unseen"]} == {0.0, 20.0, 40.0, 50.0}
    assert all(row["low_mps"] < row["mean_mps"] < row["high_mps"] for row in first["unseen"])
    assert (tmp_path / "s.png").stat().st_size > 5000
