"""Each run predicted by what the others show: nothing of itself is learned from, all periods count once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.identification.made import make_run, robot
from typer.testing import CliRunner

from frogkick.cli.app import app
from frogkick.core.errors import InputError
from frogkick.core.poses import PredictionError
from frogkick.identification.outcome import identify
from frogkick.identification.segments import read_segments
from frogkick.robot import load_robot
from frogkick.runs.runlog_file import write_run
from frogkick_studies import heldout
from frogkick_studies.heldout import HeldOut, held_out, pooled, scatter

CURRENT = {"name": "steady_current", "x_mps": 0.008, "y_mps": -0.004}
PERIODS = (14, 12, 10)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three runs with the same effect."""
    folder = tmp_path_factory.mktemp("runs")
    files = [folder / f"run{seed}.h5" for seed in range(len(PERIODS))]
    for seed, (file, periods) in enumerate(zip(files, PERIODS, strict=True)):
        write_run(file, make_run([CURRENT], seed, periods))
    return files


@from_ci
def test_each_run_is_predicted_by_what_the_others_show(runs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "heldout.png"
    toml = tmp_path / "robot.toml"
    toml.write_text(robot().toml, encoding="utf-8")
    asked = ["study", "heldout", *map(str, runs), "--robot", str(toml), "--out", str(out), "--workers", "1"]
    output = CliRunner().invoke(app, [*asked, "--json"])
    assert output.exit_code == 0, output.stderr
    values = json.loads(output.stdout)
    assert out.read_bytes().startswith(b"\x89PNG")
    assert [row["run"] for row in values["runs"]] == [str(run) for run in runs]
    assert values["periods"] == sum(row["periods"] for row in values["runs"]) > sum(PERIODS) - 6
    for row in values["runs"]:
        assert row["effects"] == [CURRENT["name"]]
        assert row["after"]["position_rmse_m"] < 0.2 * row["before"]["position_rmse_m"]
        assert row["followed"]["position_rmse_m"] < 0.2 * row["before"]["position_rmse_m"]
    whole = values["after"]["position_rmse_m"]
    squares = [row["periods"] * row["after"]["position_rmse_m"] ** 2 for row in values["runs"]]
    assert whole == pytest.approx(np.sqrt(sum(squares) / values["periods"]))

    swims = [read_segments(run, robot()) for run in runs]
    alone = identify(swims[:2], swims[2:], robot())
    assert values["runs"][2]["after"] == alone.tested.after.as_json(), "the same as identify by itself"


def test_no_value_of_a_robot_measured_before_enters(
    runs: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The built-in measured robot was fitted to the very runs that are kept back here."""
    asked: list[bool] = []

    def spied(*given: Any, measured: bool = True) -> Any:
        asked.append(measured)
        raise InputError("enough")

    monkeypatch.setattr(heldout, "identify", spied)
    with pytest.raises(InputError, match="enough"):
        held_out(load_robot("frog2022"), runs)
    assert asked and not any(asked)


def test_periods_weigh_the_same_whatever_run_they_are_of() -> None:
    found = pooled([PredictionError(3.0, 0.0), PredictionError(0.0, 1.0)], [1, 8])
    assert found == PredictionError(1.0, pytest.approx((8 / 9) ** 0.5), 9)


def test_scatter_tells_strokes_from_runs() -> None:
    """Runs that differ by more than their strokes do; a misfit by action is in neither figure."""
    rng = np.random.default_rng(5)
    strokes, between, runs = (1e-3, 2e-3, 0.01), (4e-3, 3e-3, 0.05), []
    for _ in range(40):
        action = rng.integers(3, size=60)
        miss = 0.02 * action[:, None] + rng.normal(0.0, between, 3) + rng.normal(0.0, strokes, (60, 3))
        before = np.append([-1], action[:-1])
        runs.append(np.column_stack([action, before, rng.normal(size=(60, 3)), miss]))
    same, others = scatter(runs, True), scatter(runs, False)
    both = np.hypot(strokes, between)
    assert same.position_rmse_m == pytest.approx(np.hypot(*strokes[:2]), rel=0.1)
    assert same.heading_rmse_rad == pytest.approx(strokes[2], rel=0.1)
    assert others.position_rmse_m == pytest.approx(np.hypot(*both[:2]), rel=0.2)
    assert others.heading_rmse_rad == pytest.approx(both[2], rel=0.2)
    far = [rows.copy() for rows in runs[:2]]
    far[1][:, 2] += 1e3
    assert scatter(far, False).count == 0, "no velocity of the other run is near"


def test_what_is_asked_wrongly_is_refused(runs: list[Path]) -> None:
    robot = load_robot("frog2022")
    with pytest.raises(InputError, match="give 3 runs or more, not 2"):
        held_out(robot, runs[:2])
    with pytest.raises(InputError, match=r"run0\.h5 is given twice"):
        held_out(robot, [*runs, runs[0]])


@pytest.mark.parametrize(("after_m", "code"), [(2e-3, 0), (3e-3, 0), (4e-3, 1)])
def test_the_exit_code_says_whether_it_is_worse_than_nominal(
    runs: list[Path], after_m: float, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors = [PredictionError(at_m, 0.02, 10) for at_m in (3e-3, after_m)] + [PredictionError(1e-3, 0.01)] * 2
    monkeypatch.setattr(heldout, "held_out", lambda *_: [HeldOut(runs[0], "found", (), *errors)])
    assert CliRunner().invoke(app, ["study", "heldout", *map(str, runs)]).exit_code == code
