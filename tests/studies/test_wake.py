"""A wake that is planted into swims over phase is found, and predicts a series that was not measured."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.identification.made import robot
from tests.validation.paper_data import write_swim
from typer.testing import CliRunner

from frogkick.cli.app import app
from frogkick.der import prepare
from frogkick.effects.swims import Gait
from frogkick.validation.gaits import GaitSwim, swim_gaits
from frogkick_studies.wake import PHASES, kept

ROBOT = robot()
SERIES = ((10.0, 0.8), (20.0, 1.2))
TO_PREDICT = (30.0, 1.1)
PLANTED = np.array([0.6, 0.3])
NOISE_MPS = 5e-4


def speeds(egain: float, hz: float) -> np.ndarray:
    swum = swim_gaits(prepare(ROBOT), ROBOT.profiles, [Gait(egain, hz, float(phase)) for phase in PHASES])
    return np.array([swim.speed_mps for swim in swum if isinstance(swim, GaitSwim)])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Measured swims with the planted wake, each series with a level of its own."""
    rng = np.random.default_rng(4)
    (tmp_path / "robot.toml").write_text(ROBOT.toml, encoding="utf-8")
    for (egain, hz), level in zip(SERIES, (0.004, -0.003), strict=True):
        for phase, speed in zip(PHASES, speeds(egain, hz) * kept(PLANTED, PHASES, hz), strict=True):
            place = f"exp/phase/{egain:g}_{hz:g}Hz/{10 * phase:02.0f}.mat"
            write_swim(tmp_path / place, speed + level + rng.normal(0.0, NOISE_MPS), hz, 3.0)
    return tmp_path


def test_a_planted_wake_is_found_and_predicts_another_series(folder: Path) -> None:
    egain, hz = TO_PREDICT
    given = ["study", "wake", str(folder), "--robot", str(folder / "robot.toml"), "--workers", "1"]
    run = CliRunner().invoke(
        app, [*given, "--egain", str(egain), "--frequency", str(hz), "--out", str(folder / "w.png"), "--json"]
    )
    assert run.exit_code == 0, run.output
    output = json.loads(run.stdout)
    assert [output["share"], output["memory_s"]] == pytest.approx(PLANTED, rel=0.15)
    assert all(each["after_mps"] < 0.5 * each["before_mps"] for each in output["left_out"])
    assert output["levels"]["count"] == 2 and (folder / "w.png").stat().st_size > 5000
    truth = speeds(egain, hz) * kept(PLANTED, PHASES, hz)
    for row, true in zip(output["prediction"], truth, strict=True):
        assert row["low_mps"] < true < row["high_mps"] and row["speed_mps"] < row["rods_mps"]
        assert row["speed_mps"] == pytest.approx(true, abs=1.5e-3)


def test_one_series_is_too_few(folder: Path) -> None:
    for file in (folder / "exp" / "phase" / "20_1.2Hz").iterdir():
        file.unlink()
    run = CliRunner().invoke(app, ["study", "wake", str(folder), "--robot", str(folder / "robot.toml")])
    assert "has 1 series over phase offset with 5 swims or more, needed are 2" in str(run.exception)


def test_strokes_far_apart_lose_nothing() -> None:
    assert kept(PLANTED, np.array([0.5]), 0.02) == pytest.approx(1.0, abs=1e-9)
    both = kept(PLANTED, np.array([0.0]), 0.02)
    assert both == pytest.approx(1.0 - 0.5 * PLANTED[0])
