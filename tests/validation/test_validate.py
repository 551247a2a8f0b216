"""Validation: it finds differences that are there, and none that are not."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import count, from_ci
from tests.identification.made import robot
from tests.validation.paper_data import GAIT, model_swim, write_simulation, write_swim

from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.effects.swims import Gait
from frogkick.robot import load_robot
from frogkick.validation import matched
from frogkick.validation.measured import Case, SteadySpeed
from frogkick.validation.validate import (
    ExperimentResult,
    Requirement,
    by_group,
    noise_of,
    second_differences,
    validate,
)

ROBOT = load_robot("frog2022")


def test_the_model_agrees_with_itself(tmp_path: Path) -> None:
    write_simulation(tmp_path / "sim" / "freq" / "10", GAIT)
    result = validate(ROBOT, tmp_path, workers=1)
    (case,) = result.simulations
    assert abs(case.error_mps) < 1e-6 and case.within_cycle_rms_m < 1e-5
    assert case.profile == "cached coefficients" and result.skipped == ()
    assert all(requirement.held for requirement in result.requirements)
    assert result.single_groups_above == []


def test_a_slower_and_a_rougher_reference_are_found(tmp_path: Path) -> None:
    """5 % of 46 mm/s less speed is an error of 2.3 mm/s; a sine of 1 mm is 0.71 mm RMS."""
    write_simulation(tmp_path / "sim" / "freq" / "10", GAIT, scale=0.95)
    write_simulation(tmp_path / "sim" / "phase" / "10_1Hz", Gait(10.0, 1.0, 0.3), wave_m=1e-3)
    result = validate(ROBOT, tmp_path, workers=1)
    slow, rough = result.simulations
    assert slow.error_mps == pytest.approx(0.05 * slow.model_mps, rel=1e-3)
    assert abs(rough.error_mps) < 1e-5
    assert rough.within_cycle_rms_m == pytest.approx(1e-3 / math.sqrt(2.0), rel=0.02)
    verdicts = {(r.what, r.group): r.held for r in result.requirements}
    assert not verdicts["speed_rmse_mps", "simulations/freq"]
    assert verdicts["speed_rmse_mps", "simulations/phase"]
    assert not verdicts["within_cycle_rms_m", "simulations/phase"]
    above = {(r.what, r.group) for r in result.single_groups_above}
    assert above == {
        ("speed_rmse_mps", "simulations/freq/10"),
        ("within_cycle_rms_m", "simulations/phase/10_1Hz"),
    }


def test_swims_are_compared_with_both_simulations(tmp_path: Path) -> None:
    write_simulation(tmp_path / "sim" / "freq" / "10", GAIT, scale=0.95)
    write_swim(tmp_path / "exp" / "freq" / "10" / "1.0Hz.mat", 0.05, 1.0, cycles=4.0)
    (tmp_path / "exp" / "speeds.csv").write_text(
        "egain_percent,frequency_hz,phase_offset,speed_mm_per_s\n10,1,0.5,30\n10,1,0.5,51\n10,1,0.2,44\n"
    )
    result = validate(ROBOT, tmp_path, workers=1)
    swim, table = sorted(result.experiments, key=lambda r: -r.case.gait.phase)
    model = model_swim(GAIT).speed_mps
    assert swim.reference.speed_mps == pytest.approx(0.05, rel=1e-9)
    assert swim.tabulated_mps == pytest.approx(0.051)  # the nearer of the gait's two rows
    assert swim.error_mps == pytest.approx(model - 0.05, abs=1e-9)
    assert swim.authors_mps == pytest.approx(0.95 * model, rel=1e-4)
    assert table.case.group == "experiments/tabulated"  # a row without a file
    assert table.reference.speed_mps == pytest.approx(0.044) and table.authors_mps is None
    assert result.authors_rmse_mps["experiments"] == pytest.approx(0.05 - 0.95 * model, rel=1e-3)


def test_what_cannot_be_compared_is_listed_with_its_reason(tmp_path: Path) -> None:
    write_simulation(tmp_path / "sim" / "freq" / "10", GAIT)
    short = write_simulation(tmp_path / "sim" / "freq" / "20", Gait(20.0, 1.0, 0.5))
    short.write_text("".join(short.read_text().splitlines(keepends=True)[:7000]))
    write_swim(tmp_path / "exp" / "freq" / "30" / "1.7Hz.mat", 0.05, 1.7, cycles=4.0)
    (tmp_path / "exp" / "freq" / "30" / "1.2Hz.mat").write_text("spoilt")
    result = validate(ROBOT, tmp_path, workers=1)
    reasons = {skipped.case.rsplit("/", 1)[1]: skipped.reason for skipped in result.skipped}
    assert "cycle 8 ends at 8 s" in reasons[short.name]
    assert "not extrapolated" in reasons["1.7Hz.mat"]
    assert "MATLAB" in reasons["1.2Hz.mat"]
    assert len(result.simulations) == 1 and len(reasons) == 3


@from_ci
def test_constants_are_matched_without_the_fraction_that_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Simulations of a frame that is heavier by a quarter: each fraction says so, and predicts the other."""
    monkeypatch.setattr(matched, "CONSTANTS", {"frame mass": matched.CONSTANTS["frame mass"]})
    heavier = matched.CONSTANTS["frame mass"](robot(), 1.25)
    for percent in (10.0, 30.0):
        write_simulation(tmp_path / "sim" / "freq" / f"{percent:g}", Gait(percent, 1.0, 0.5), robot=heavier)
    result = validate(robot(), tmp_path, workers=1)
    found = matched.matched_without(result)
    assert [part.egain_percent for part in found.parts] == [10.0, 30.0]
    for part in found.parts:
        assert part.factors["frame mass"] == pytest.approx(1.25, abs=0.03)
        assert part.left_out_rmse_mps < 0.1e-3
    assert found.rmse_mps["simulations"] < 0.1e-3 < 0.3e-3 < result.speed_rmse_mps["simulations"]
    waves = found.within_cycle_rms_m["simulations"]
    assert 10.0 * waves < result.within_cycle_rms_m["simulations"]
    alone = replace(result, simulations=result.simulations[:1])
    with pytest.raises(InputError, match="1 EGaIn fractions, needed are 2"):
        matched.matched_without(alone)


def test_groups_add_up_to_their_parents() -> None:
    rms = by_group([("a/freq/1", 3.0), ("a/freq/2", 4.0), ("a/phase/3", 0.0)])
    assert rms["a/freq/1"] == 3.0
    assert rms["a/freq"] == pytest.approx(math.sqrt(12.5))
    assert rms["a"] == pytest.approx(math.sqrt(25.0 / 3.0))


def test_a_figure_that_is_missing_does_not_hold() -> None:
    assert not Requirement("speed_rmse_mps", "simulations/freq", 1.0, math.nan).held


def test_second_differences_see_noise_and_no_slope() -> None:
    places = [0.1 * k for k in range(10)]
    assert second_differences(places, [3.0 * x for x in places], None) == pytest.approx([0.0] * 8)
    assert len(second_differences(places, [1.0] * 10, 1.0)) == 10  # round the end of the cycle
    assert second_differences([0.4, 0.5, 0.7], [1.0, 2.0, 3.0], None) == []  # uneven
    rng = np.random.default_rng(1)
    found = [
        d for _ in range(200) for d in second_differences(places, rng.normal(0.0, 0.004, 10).tolist(), None)
    ]
    assert float(np.sqrt(np.mean(np.square(found)))) == pytest.approx(0.004, rel=0.08)


def swim_result(group: str, gait: Gait, speed_mps: float, name: str = "x") -> ExperimentResult:
    steady = SteadySpeed(speed_mps, 0.001, 3)
    return ExperimentResult(Case(name, group, gait, Path(name)), steady, 0.0, "measured file", None, None)


def test_repeats_count_distinct_swims_of_one_gait() -> None:
    gait, other = Gait(10.0, 0.4, 0.5), Gait(10.0, 0.8, 0.5)
    noise = noise_of(
        [
            swim_result("experiments/freq/10", gait, 0.020),
            swim_result("experiments/phase/10_0.4Hz", gait, 0.024),
            swim_result("experiments/freq/10", other, 0.045),
            swim_result("experiments/phase/10_0.8Hz", other, 0.045),  # the same file in two folders
        ]
    )
    assert noise.repeated == 1
    assert noise.repeats == pytest.approx(0.004 / math.sqrt(2.0))
    assert noise.neighbours == {} and noise.within_swim["experiments"] == pytest.approx(0.001)


@from_ci
def test_the_command_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "data"
    write_simulation(data / "sim" / "freq" / "10", GAIT, scale=0.9)
    write_swim(data / "exp" / "freq" / "10" / "1.0Hz.mat", 0.05, 1.0, cycles=4.0)
    page = tmp_path / "r.html"
    command = ["validate", str(data), "--robot", "frog2022", "--workers", "1"]
    assert run_command([*command, "--report", str(page), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["simulations"][0]["group"] == "simulations/freq/10"
    assert {"case", "reference_mps", "model_mps"} <= set(result["experiments"][0])
    assert result["rmse_mps"]["simulations"] == pytest.approx(0.1 * model_swim(GAIT).speed_mps, rel=1e-3)
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 4 and "MISSED" in text
    assert run_command([*command, "--check"]) == 1
    assert run_command(["validate", str(tmp_path / "none")]) == 2


@from_ci
def test_the_robot_of_the_simulations_is_the_paper_s(frog2022_dir: Path) -> None:
    """Measured: 0.20 mm/s over frequency, 0.18 over phase offset, 0.06 mm within a cycle."""
    result = validate(load_robot("frog2022-sim"), frog2022_dir, workers=count(2, 2))
    assert all(requirement.held for requirement in result.requirements)
    assert result.single_groups_above == []
    assert result.speed_rmse_mps["simulations"] < 0.3e-3
    assert result.within_cycle_rms_m["simulations"] < 0.1e-3


@from_ci
def test_the_model_is_the_paper_s(frog2022_dir: Path) -> None:
    """Issue 4: 1.2 mm/s over frequency, 0.5 over phase offset, 0.3 mm within a cycle.

    Measured: 0.68, 0.38, 0.26; within a cycle the sweep over phase at 0.8 Hz misses it with 0.36.
    """
    result = validate(ROBOT, frog2022_dir, workers=count(2, 2))
    missed = [r for r in result.requirements if not r.held]
    assert [r.group for r in missed if r.what == "speed_rmse_mps"] == []
    assert result.within_cycle_rms_m["simulations"] < 0.3e-3
    assert result.within_cycle_rms_m["simulations/phase"] < 0.32e-3
    rmse, authors = result.speed_rmse_mps, result.authors_rmse_mps
    assert rmse["experiments"] == pytest.approx(authors["experiments"], abs=0.5e-3)
    assert len(result.simulations) >= 50 and len(result.experiments) >= 36
    assert {case.profile for case in result.simulations} == {"measured file"}
    assert all("30/1." in skipped.case for skipped in result.skipped)
