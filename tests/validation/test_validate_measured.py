"""Reading the paper's data: names to gaits, speeds, profiles, and files that are no use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from tests.validation.paper_data import write_swim

from frogkick.core.errors import InputError
from frogkick.effects.swims import Gait
from frogkick.robot import load_robot
from frogkick.validation.measured import (
    find_cases,
    read_profiles,
    read_simulation,
    read_speeds,
    read_swim,
    steady_speed,
)

ROBOT = load_robot("frog2022")


def touch(root: Path, *names: str) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("x")


@pytest.mark.parametrize(
    ("name", "gait", "group"),
    [
        (
            "sim/freq/30/simDER_phaseDelay_0.500000_frequency_1.300000_EGaIn_30.000000.txt",
            Gait(30.0, 1.3, 0.5),
            "simulations/freq/30",
        ),
        (
            "sim/phase/20_0dot6Hz/simDER_phaseDelay_0.900000_frequency_0.600000_EGaIn_20.000000.txt",
            Gait(20.0, 0.6, 0.9),
            "simulations/phase/20_0.6Hz",
        ),
        ("exp/freq/0/0.4Hz.mat", Gait(0.0, 0.4, 0.5), "experiments/freq/0"),
        ("exp/freq/50/2Hz.mat", Gait(50.0, 2.0, 0.5), "experiments/freq/50"),
        ("exp/phase/10_0.8Hz/00.mat", Gait(10.0, 0.8, 0.0), "experiments/phase/10_0.8Hz"),
        ("exp/phase/30_1dot2Hz/7.mat", Gait(30.0, 1.2, 0.7), "experiments/phase/30_1.2Hz"),
        ("exp/phase/30_1.2Hz/0.35.mat", Gait(30.0, 1.2, 0.35), "experiments/phase/30_1.2Hz"),
    ],
)
def test_a_file_s_name_says_its_gait(tmp_path: Path, name: str, gait: Gait, group: str) -> None:
    touch(tmp_path, name)
    (case,), skipped = find_cases(tmp_path)
    assert (case.gait, case.group, case.name, skipped) == (gait, group, name, [])


@pytest.mark.parametrize(
    "name",
    ["sim/freq/10/notes.txt", "exp/freq/10/fast.mat", "exp/phase/10_0.8Hz/10.mat", "exp/freq/10/0Hz.mat"],
)
def test_a_name_without_a_gait_is_skipped_with_a_reason(tmp_path: Path, name: str) -> None:
    touch(tmp_path, name, "exp/freq/10/0.5Hz.mat")
    cases, (skipped,) = find_cases(tmp_path)
    assert len(cases) == 1 and skipped.case == name and "name" in skipped.reason


def test_a_folder_without_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no case"):
        find_cases(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        find_cases(tmp_path / "nowhere")


def test_steady_speed_is_the_line_s_slope_with_the_scatter_of_cycles(tmp_path: Path) -> None:
    file = tmp_path / "0.5Hz.mat"
    write_swim(file, 0.03, 0.5, cycles=4.1)
    steady = steady_speed(*read_swim(file), 0.5)
    assert steady.speed_mps == pytest.approx(0.03, rel=1e-9)
    assert steady.cycles == 4 and steady.sd_mps == pytest.approx(0.0, abs=1e-9)
    write_swim(file, 0.03, 0.5, cycles=1.5)
    assert steady_speed(*read_swim(file), 0.5).sd_mps is None


def test_the_scatter_of_cycles_is_that_of_their_mean() -> None:
    """Cycles at 20, 40, 20, 40 mm/s: standard deviation 11.5, of the mean of four half of that."""
    time_s = np.arange(0.0, 4.0 + 1e-9, 0.01)
    distance_m = np.interp(time_s, [0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.02, 0.06, 0.08, 0.12])
    assert steady_speed(time_s, distance_m, 1.0).sd_mps == pytest.approx(0.005774, abs=1e-6)


@pytest.mark.parametrize(
    "text", ["", "time x y\n", "0.001 0\n0.002 0\n", "0.002 0 0\n0.001 0 0\n", "0.001 0 nan\n0.002 0 0\n"]
)
def test_a_bad_simulation_is_an_input_error(tmp_path: Path, text: str) -> None:
    file = tmp_path / "run.txt"
    file.write_text(text)
    with pytest.raises(InputError, match=r"run\.txt"):
        read_simulation(file)


def test_a_bad_swim_is_an_input_error(tmp_path: Path) -> None:
    file = tmp_path / "swim.mat"
    t = np.arange(20.0)
    for content in ({"t": t}, {"t": t, "distance": t[:-1]}, {"t": t[::-1], "distance": t}, {"distance": t}):
        savemat(file, content)
        with pytest.raises(InputError, match=r"swim\.mat"):
            read_swim(file)
    file.write_bytes(b"MATLAB 7.3 or whatever this is" * 9)
    with pytest.raises(InputError, match=r"swim\.mat"):
        read_swim(file)


def test_tabulated_speeds(tmp_path: Path) -> None:
    file = tmp_path / "speeds.csv"
    assert read_speeds(file) == []
    file.write_text("egain_percent,frequency_hz,phase_offset,speed_mm_per_s\n10,0.8,0.3,39.5\n")
    assert read_speeds(file) == [(Gait(10.0, 0.8, 0.3), pytest.approx(0.0395))]
    file.write_text("egain_percent,frequency_hz,phase_offset,speed_mm_per_s\n10,0.8,0.3,fast\n")
    with pytest.raises(InputError, match="line 2"):
        read_speeds(file)


def test_profiles_come_from_files_and_otherwise_from_the_robot(tmp_path: Path) -> None:
    profile = next(p for p in ROBOT.profiles if (p.egain_percent, p.frequency_hz) == (10.0, 0.8))
    time_s = np.linspace(0.0, 1.25, 200)
    softer = 128.0 - 0.5 * (128.0 - profile.curvature_per_m(time_s))
    (tmp_path / "1").mkdir()
    savemat(tmp_path / "1" / "8.mat", {"t": time_s, "mean": softer})
    (tmp_path / "1" / "9.mat").write_text("spoilt")
    savemat(tmp_path / "1" / "mean.mat", {"t": time_s, "mean": softer})
    profiles, skipped = read_profiles(tmp_path, ROBOT.profiles)
    assert profiles.source(Gait(10.0, 0.8, 0.5)) == "measured file"
    assert profiles.source(Gait(10.0, 0.9, 0.5)) == "cached coefficients"
    assert profiles.source(Gait(10.0, 0.85, 0.5)) == "interpolated"
    assert sorted(s.case.rsplit("/", 1)[1] for s in skipped) == ["9.mat", "mean.mat"]
    fitted = next(p for p in profiles.profiles if (p.egain_percent, p.frequency_hz) == (10.0, 0.8))
    assert float(np.ptp(fitted.curvature_per_m(time_s))) == pytest.approx(float(np.ptp(softer)), rel=0.03)
    assert len(profiles.profiles) == len(ROBOT.profiles)


def test_the_tabulated_speeds_are_the_slopes_of_the_swims(frog2022_dir: Path) -> None:
    """Every swim with a row in the table: the authors tabulate what steady_speed computes."""
    tabulated = read_speeds(frog2022_dir / "exp" / "speeds.csv")
    cases, _ = find_cases(frog2022_dir)
    found = 0
    for case in cases:
        rows = [speed for gait, speed in tabulated if gait == case.gait]
        if case.group.startswith("experiments") and rows:
            speed = steady_speed(*read_swim(case.file), case.gait.frequency_hz).speed_mps
            assert min(abs(speed - row) for row in rows) < 2e-7, case.name
            found += 1
    assert found >= 30
