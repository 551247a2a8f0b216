"""Theory held against swims: the ring's inertia, the factor fitted to others, what a joint fit holds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.identification.made import WORN, make_swim, robot, robot_option, term
from tests.validation.paper_data import write_swim
from typer.testing import CliRunner

from frogkick.cli.app import app
from frogkick.core.poses import PredictionError
from frogkick.effects import rods_of
from frogkick.effects.body import frame_mass_kg
from frogkick.effects.swims import Gait
from frogkick.identification.calibrated import NOISES, GaussNewton, calibrated_starts, end_residuals
from frogkick.identification.fit import Model, rollouts_of
from frogkick.robot import load_robot
from frogkick.validation.gaits import GaitSwim, swim_gaits
from frogkick_studies.steady import with_effects
from frogkick_studies.water import DAMPING, FITTED, HEIGHT_M, INNER_M, Joint, hypotheses, ring, started

ROBOT = load_robot("frog2022")
GAITS = [Gait(egain, hz, 0.5) for egain in (10.0, 30.0) for hz in (0.7, 0.8, 1.1)]
FACTOR = 0.8


def test_the_ring_has_the_mass_and_the_inertia_of_the_drawing() -> None:
    """Of 90 and 35 mm, 35 mm high, at 0.9 of the water's density: cells of 0.5 mm."""
    cells = np.arange(-0.04475, 0.045, 5e-4)
    x, y = np.meshgrid(cells, cells)
    full = np.maximum(np.abs(x), np.abs(y)) > 0.5 * INNER_M
    cell_kg = 900.0 * HEIGHT_M * 25e-8
    wanted_kg, wanted_kg_m2 = cell_kg * full.sum(), cell_kg * (x**2 + y**2)[full].sum()

    def of(tables: list[dict[str, float | str]]) -> tuple[float, float]:
        mesh = rods_of(with_effects(ROBOT, tables)).mesh
        arm = mesh.rest_m - mesh.rest_m[: mesh.frame_nodes].mean(axis=0)
        return float(mesh.mass_kg.sum()), float(mesh.mass_kg @ (arm**2).sum(axis=1))

    plain, filled = of([]), of([{"name": "hull", **ring(ROBOT)}])
    outline_kg = frame_mass_kg(ROBOT.frame)
    assert filled[0] - plain[0] == pytest.approx(wanted_kg - outline_kg, rel=1e-2)
    assert filled[1] - plain[1] == pytest.approx(wanted_kg_m2 - outline_kg * 2700e-6, rel=1e-2)
    assert wanted_kg_m2 / wanted_kg == pytest.approx(1554e-6, rel=2e-3)


def test_a_joint_fit_holds_what_theory_says() -> None:
    every = hypotheses(ROBOT)
    for name, tables in every.items():
        terms, fixed = started(ROBOT, tables, FITTED.get(name))
        flat = [
            (term.name, p.name, v)
            for term in terms
            for p, v in zip(term.parameters, term.values, strict=True)
        ]
        held = {flat[k][:2]: flat[k][2] for k in fixed}
        fitted = FITTED.get(name, ("", "", 0.0))
        for table in tables:
            for key, value in table.items():
                if key != "name" and (table["name"], key) != fitted[:2]:
                    assert held[str(table["name"]), key] == pytest.approx(value)
        assert fitted[:2] not in held
    plain, _ = started(ROBOT, ())
    assert plain == next(iter(calibrated_starts(ROBOT).values()))


@from_ci
def test_swims_of_a_plated_robot_in_other_drag_are_told(tmp_path: Path) -> None:
    """Where limbs are plates and the frame's drag is another, that hypothesis wins in every way."""
    plated = with_effects(robot(), hypotheses(ROBOT)["limbs are plates"])
    swum = swim_gaits(rods_of(plated), plated.profiles, GAITS)
    for gait, swim in zip(GAITS, swum, strict=True):
        assert isinstance(swim, GaitSwim)
        name = f"exp/freq/{gait.egain_percent:g}/{gait.frequency_hz:g}Hz.mat"
        write_swim(tmp_path / name, FACTOR * swim.speed_mps, gait.frequency_hz, 3.0)
    given = ["study", "water", str(tmp_path), "--robot", robot_option(tmp_path), "--workers", "1", "--json"]
    done = CliRunner().invoke(app, [*given, "--out", str(tmp_path / "w.png")])
    assert done.exit_code == 0, done.output
    output = json.loads(done.stdout)
    rows = {row["name"]: row for row in output["hypotheses"]}
    assert {row["egain_percent"] for row in output["predictions"]} == {0.0, 20.0, 40.0, 50.0}
    again = next(row for row in output["predictions"] if row["egain_percent"] == 20.0)
    gait = Gait(20.0, again["frequency_hz"], 0.5)
    (swim,) = swim_gaits(rods_of(plated), plated.profiles, [gait])
    assert isinstance(swim, GaitSwim)
    assert again["predicted_mps"] == pytest.approx(FACTOR * swim.speed_mps, rel=1e-3)
    best = rows["limbs are plates"]["swims"]
    assert best["factor"] == pytest.approx(FACTOR, rel=1e-3)
    assert set(best["left_out_mps"]) == {"egain", "frequency", "series"}
    for way, error in best["left_out_mps"].items():
        assert error < 1e-5
        others = [
            row["swims"]["left_out_mps"][way] for name, row in rows.items() if name != "limbs are plates"
        ]
        assert min(others) > 20.0 * error
        assert best["gain_m2_per_s2"][way][1] > 0.0
    assert all(row["runs"] is None and row["joint"] is None for row in rows.values())
    assert (tmp_path / "w.png").stat().st_size > 5000


def test_a_run_is_held_out_by_a_step_from_the_others_alone() -> None:
    swims = [make_swim([WORN], seed, 6) for seed in (1, 2, 3)]
    model = Model(robot(), (term("limb_wear rear_left", 0.9),), NOISES[0])
    fit = GaussNewton(model, swims)
    at, residuals, derivatives, _ = fit.linearised()
    joint = Joint.of(fit, robot(), at, residuals, derivatives)

    alone = []
    for left, swim in enumerate(swims):
        others = GaussNewton(model, [each for k, each in enumerate(swims) if k != left])
        there, base, columns, _ = others.linearised()
        step = others.stepped(there, np.concatenate(base), np.concatenate(columns), DAMPING)
        alone.append(end_residuals(rollouts_of([step], [swim])[0], [swim]))
    expected = PredictionError.of(np.concatenate(alone))
    assert joint.left_out.position_rmse_m == pytest.approx(expected.position_rmse_m, rel=1e-9)
    assert joint.left_out.heading_rmse_rad == pytest.approx(expected.heading_rmse_rad, rel=1e-9)
    assert joint.fitted == PredictionError.of(np.concatenate(residuals))
    assert joint.values == {"limb_wear rear_left gain": 0.9}
    told = joint.as_json()
    assert told["left_out"] == joint.left_out.as_json() and told["values"] == joint.values
