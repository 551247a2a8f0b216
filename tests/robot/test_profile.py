"""Fitting measured limb profiles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from frogkick.errors import InputError
from frogkick.robot import load_robot
from frogkick.robot.profile import fit_profile
from frogkick.robot.profile_files import fit_profile_folder, read_measured_profile, write_profiles


def made_up(noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 1.25, 300)
    k = 128.0 - 90.0 / (1 + np.exp(-(t - 0.03) / 0.006)) + 88.0 / (1 + np.exp(-(t - 0.4) / 0.08))
    return t, k + noise * np.random.default_rng(3).normal(size=t.size)


def test_a_known_profile_is_recovered() -> None:
    t, k = made_up(noise=0.2)
    profile = fit_profile(t, k, 10.0, 0.8)
    assert profile.rms_per_m < 1.0
    clean = made_up()[1]
    assert np.sqrt(np.mean((profile.curvature_per_m(t) - clean) ** 2)) < 1.0


def test_bad_measurements_are_refused() -> None:
    t, k = made_up()
    with pytest.raises(InputError, match="two equal rows"):
        fit_profile(t[:-1], k, 10.0, 0.8)
    with pytest.raises(InputError, match="non-finite"):
        fit_profile(t, np.where(t > 1.0, np.nan, k), 10.0, 0.8)
    with pytest.raises(InputError, match="do not increase"):
        fit_profile(t[::-1], k, 10.0, 0.8)
    with pytest.raises(InputError, match="a stroke lowers it"):
        fit_profile(t, np.full_like(t, 120.0), 10.0, 0.8)
    with pytest.raises(InputError, match=r"holds no <EGaIn/10>"):
        fit_profile_folder("nowhere")


def test_files_that_are_no_profiles_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "1" / "7.mat"
    file.parent.mkdir()
    file.write_bytes(b"not matlab" * 40)
    with pytest.raises(InputError, match="cannot be read"):
        fit_profile_folder(tmp_path)


def test_the_stored_coefficients_are_those_of_the_measurements(frog2022_dir: Path, tmp_path: Path) -> None:
    robot = load_robot("frog2022")
    assert len(robot.profiles) == len(list((frog2022_dir / "profile").glob("*/*.mat")))
    worst = 0.0
    for profile in robot.profiles:
        name = f"{round(profile.egain_percent / 10)}/{round(profile.frequency_hz * 10)}.mat"
        t, k = read_measured_profile(frog2022_dir / "profile" / name)
        rms = float(np.sqrt(np.mean((profile.curvature_per_m(t) - k) ** 2)))
        assert rms == pytest.approx(profile.rms_per_m, abs=0.01)
        worst = max(worst, rms)
    assert worst < 1.5
    profile = next(p for p in robot.profiles if (p.egain_percent, p.frequency_hz) == (10.0, 0.7))
    again = fit_profile(*read_measured_profile(frog2022_dir / "profile" / "1" / "7.mat"), 10.0, 0.7)
    t = np.linspace(0.0, profile.duration_s, 500)
    assert np.abs(again.curvature_per_m(t) - profile.curvature_per_m(t)).max() < 0.05
    write_profiles([again], tmp_path / "p.toml", "a test")
    assert "Origin: a test" in (tmp_path / "p.toml").read_text()
