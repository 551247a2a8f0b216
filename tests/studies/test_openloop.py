"""Effects planted into swims of one fraction are found and predict another; without any none are found."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.identification.made import robot
from tests.validation.paper_data import write_swim
from typer.testing import CliRunner

from frogkick.cli.app import app
from frogkick.core.errors import InputError
from frogkick.effects import BUILT_IN, changed_robot, make_effect, rods_of
from frogkick.effects.swims import Gait
from frogkick.robot import load_robot
from frogkick.validation.gaits import GaitSwim, swim_gaits
from frogkick_studies import fits
from frogkick_studies.fits import open_loop
from frogkick_studies.steady import Free, Table, tables_of, with_effects

ROBOT = robot()
TRAIN = [Gait(30.0, hz, 0.5) for hz in (1.0, 1.1, 1.2, 1.3, 1.4)] + [Gait(30.0, 1.4, 0.3)]
TEST = [Gait(10.0, 1.1, 0.5), Gait(20.0, 1.3, 0.3)]
PLANTED: Table = {"name": "hull", "limb_drag": 1.8}
NOISE_MPS = 0.001


def speeds(tables: Sequence[Table], gaits: Sequence[Gait]) -> list[float]:
    """What the simulator gives."""
    swum = swim_gaits(rods_of(with_effects(ROBOT, tables)), ROBOT.profiles, gaits)
    assert all(isinstance(swim, GaitSwim) for swim in swum)
    return [swim.speed_mps for swim in swum if isinstance(swim, GaitSwim)]


def robot_file(folder: Path) -> str:
    """The robot of these tests, for the command."""
    file = folder / "robot.toml"
    file.write_text(ROBOT.toml, encoding="utf-8")
    return str(file)


def write_data(folder: Path, tables: Sequence[Table], seed: int) -> Path:
    """A folder in the paper's layout with measured swims of a robot with effects."""
    rng = np.random.default_rng(seed)
    for gait, speed in zip([*TRAIN, *TEST], speeds(tables, [*TRAIN, *TEST]), strict=True):
        place = f"phase/{gait.egain_percent:g}_{gait.frequency_hz:g}Hz/{10 * gait.phase:02.0f}.mat"
        write_swim(folder / "exp" / place, speed + rng.normal(0.0, NOISE_MPS), gait.frequency_hz, 3.0)
    return folder


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small catalogue and one round: the search as it is, in seconds."""
    rows = [row for row in fits.CANDIDATES if row[0].name in {"hull.limb_drag", "limb_wear.duration_scale"}]
    assert len(rows) == 2
    monkeypatch.setattr(fits, "CANDIDATES", tuple(rows))
    monkeypatch.setattr(fits, "MOST_EFFECTS", 1)


@from_ci
@pytest.mark.parametrize("seed", range(count(1, 5)))
def test_a_planted_effect_is_found_and_predicts_other_fractions(few: None, tmp_path: Path, seed: int) -> None:
    folder, out = write_data(tmp_path / "data", [PLANTED], seed), tmp_path / "out"
    asked = ["study", "openloop", str(folder), "--train-egain", "30", "--out", str(out), "--workers", "1"]
    output = CliRunner().invoke(app, [*asked, "--robot", robot_file(tmp_path), "--json"])
    assert output.exit_code == 0, output.output
    result = json.loads(output.stdout)
    (split,) = result["splits"]
    (found,) = split["parameters"]
    assert found["name"] == "hull.limb_drag"
    assert found["low"] < PLANTED["limb_drag"] < found["high"]
    assert found["value"] == pytest.approx(PLANTED["limb_drag"], rel=0.15)
    assert split["test_egain_percent"] == [10.0, 20.0] and split["test"]["swims"] == len(TEST)
    assert split["test"]["nominal_rmse_mps"] > 4.0 * NOISE_MPS
    assert split["test"]["rmse_mps"] < 2.0 * NOISE_MPS
    assert split["left_out_rmse_mps"]["effects"] < split["left_out_rmse_mps"]["nominal"]
    (turn,) = split["tried"]
    assert turn["taken"] and turn["mse_gain_m2_per_s2"]["frequency"]["interval"][0] > 0.0
    assert split["train_egain_percent"] == [30.0] and split["kind"] == "egain"
    assert result["nominal"]["rmse_mps"]["experiments"] > 4.0 * NOISE_MPS
    # The robot that was written swims as predicted.
    fitted = load_robot(split["robot"])
    cases = [case for case in split["cases"] if case["use"] == "test"]
    gaits = [Gait(c["egain_percent"], c["frequency_hz"], c["phase"]) for c in cases]
    again = swim_gaits(rods_of(fitted), fitted.profiles, gaits)
    for case, swim in zip(cases, again, strict=True):
        assert isinstance(swim, GaitSwim)
        assert swim.speed_mps == pytest.approx(case["predicted_mps"], abs=1e-5)
    assert (out / "openloop.png").read_bytes().startswith(b"\x89PNG")


@from_ci
@pytest.mark.parametrize("seed", range(count(1, 5)))
def test_without_an_effect_the_plain_model_stays(few: None, tmp_path: Path, seed: int) -> None:
    (split,) = open_loop(ROBOT, write_data(tmp_path, [], seed), train=[30.0]).splits
    assert split.fitted.estimates == ()
    for row in (*split.train, *split.test):
        assert row.speed_mps == row.experiment.model_mps
        assert abs(row.error_mps) < 5.0 * NOISE_MPS


def test_a_gain_within_its_sampling_error_is_none() -> None:
    rng = np.random.default_rng(2)
    before = rng.normal(0.0, 1.0, 30)
    gain, low, high = fits.gain_of(before, 0.97 * before + rng.normal(0.0, 0.3, 30))
    assert low < 0.0 < high and low < gain < high
    gain, low, high = fits.gain_of(before, 0.4 * before)
    assert 0.0 < low < gain < high
    assert fits.gain_of(before, before) == (0.0, 0.0, 0.0)


@from_ci
def test_one_folder_is_fitted_to_and_another_predicted(few: None, tmp_path: Path) -> None:
    train, test = write_data(tmp_path / "a", [PLANTED], 0), tmp_path / "b"
    for gait, speed in zip(TEST, speeds([PLANTED], TEST), strict=True):
        place = f"phase/{gait.egain_percent:g}_{gait.frequency_hz:g}Hz/{10 * gait.phase:02.0f}.mat"
        write_swim(test / "exp" / place, speed, gait.frequency_hz, 3.0)
    asked = ["study", "openloop", "--train", str(train), "--test", str(test), "--workers", "1", "--json"]
    output = CliRunner().invoke(app, [*asked, "--robot", robot_file(tmp_path)])
    assert output.exit_code == 0, output.output
    (split,) = json.loads(output.stdout)["splits"]
    assert split["kind"] == "folder" and split["test"]["swims"] == len(TEST)
    assert split["train"]["swims"] == len(TRAIN) + len(TEST)
    assert {"egain", "frequency"} == set(split["tried"][0]["mse_gain_m2_per_s2"])
    assert split["test"]["rmse_mps"] < 0.5 * split["test"]["nominal_rmse_mps"]
    for wrong in (["--train", str(train)], [str(train), "--train", str(train), "--test", str(test)], []):
        refused = CliRunner().invoke(app, ["study", "openloop", *wrong])
        assert isinstance(refused.exception, InputError) and "give DATA_DIR, or both" in str(
            refused.exception
        )


def test_effects_of_a_robot_act_on_its_gaits() -> None:
    gaits = TEST[:2]
    plain = speeds([], gaits)
    assert speeds([{"name": "limb_wear", "gain": 1.0}], gaits) == plain
    worn = speeds([{"name": "limb_wear", "gain": 0.8}], gaits)
    assert all(less < 0.9 * more for less, more in zip(worn, plain, strict=True))
    body = changed_robot(ROBOT, [make_effect(PLANTED, Path())])
    swum = swim_gaits(rods_of(body), ROBOT.profiles, gaits)
    assert [s.speed_mps for s in swum if isinstance(s, GaitSwim)] == speeds([PLANTED], gaits)


def test_values_stay_within_their_bounds() -> None:
    for row in fits.CANDIDATES:
        for free in row:
            low, high = free.bounds
            starts = [free.expected + start for start in free.starts]
            assert all(low < start < high for start in starts)
            for widths in (low, 0.0, *starts, high, 1e3, -1e3):
                BUILT_IN[free.effect](**{free.parameter: free.value(widths)})
    drag = Free("hull", "limb_drag", math.log(2.0))
    assert drag.value(1.0) == pytest.approx(2.0) and drag.value(0.0) == 1.0
    assert tables_of({drag: 2.0, Free("hull", "mass", 1.0): 1.5}) == (
        {"name": "hull", "limb_drag": 2.0, "mass": 1.5},
    )


def test_data_that_allows_no_test_is_refused(tmp_path: Path) -> None:
    for gait in TRAIN:
        name = f"phase/30_{gait.frequency_hz:g}Hz/{10 * gait.phase:02.0f}.mat"
        write_swim(tmp_path / "exp" / name, 0.04, gait.frequency_hz, 3.0)
    with pytest.raises(InputError, match=r"swims with limb profiles are at 30 % \(6\).*another one to test"):
        open_loop(ROBOT, tmp_path)
    with pytest.raises(InputError, match="no measured swim at 20 % EGaIn"):
        open_loop(ROBOT, tmp_path, train=[20.0])
    write_swim(tmp_path / "exp" / "freq" / "10" / "1.0Hz.mat", 0.04, 1.0, 3.0)
    with pytest.raises(InputError, match=r"too few measured swims at 10 % EGaIn: a fit needs 6"):
        open_loop(ROBOT, tmp_path, train=[10.0])
