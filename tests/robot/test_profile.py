"""Fitting measured limb profiles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import frogkick

from frogkick.core.errors import InputError
from frogkick.robot import load_robot, parse_robot
from frogkick.robot.profile import (
    HalvesProfile,
    actuation,
    fit_halves,
    fit_profile,
    read_mat,
    write_profiles,
)


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
    with pytest.raises(InputError, match="lowest at its end"):
        fit_profile(t, 120.0 - 50.0 * t, 10.0, 0.8)


def test_files_that_are_no_profiles_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "7.mat"
    file.write_bytes(b"not matlab" * 40)
    with pytest.raises(InputError, match="cannot be read"):
        read_mat(file, "mean")


def test_the_stored_coefficients_are_those_of_the_measurements(frog2022_dir: Path, tmp_path: Path) -> None:
    robot = load_robot("frog2022")
    assert len(robot.profiles) == len(list((frog2022_dir / "profile").glob("*/*.mat")))
    worst = 0.0
    for profile in robot.profiles:
        name = f"{round(profile.egain_percent / 10)}/{round(profile.frequency_hz * 10)}.mat"
        t, k = read_mat(frog2022_dir / "profile" / name, "mean")
        rms = float(np.sqrt(np.mean((profile.curvature_per_m(t) - k) ** 2)))
        assert rms == pytest.approx(profile.rms_per_m, abs=0.01)
        worst = max(worst, rms)
    assert worst < 1.5
    profile = next(p for p in robot.profiles if (p.egain_percent, p.frequency_hz) == (10.0, 0.7))
    again = fit_profile(*read_mat(frog2022_dir / "profile" / "1" / "7.mat", "mean"), 10.0, 0.7)
    t = np.linspace(0.0, profile.duration_s, 500)
    assert np.abs(again.curvature_per_m(t) - profile.curvature_per_m(t)).max() < 0.05
    write_profiles([again], tmp_path / "p.toml", "a test")
    assert "Origin: a test" in (tmp_path / "p.toml").read_text()


def arc_tip(curvature_per_m: np.ndarray, length_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Where arcs end that begin along x, by adding up short pieces."""
    along = np.linspace(0.0, length_m, 4001)
    angle = curvature_per_m[:, None] * 0.5 * (along[1:] + along[:-1])
    step = np.diff(along)
    return (np.cos(angle) * step).sum(axis=1), (np.sin(angle) * step).sum(axis=1)


def csv_of(file: Path, **columns: np.ndarray) -> Path:
    rows = zip(*columns.values(), strict=True)
    file.write_text("\n".join([",".join(columns), *(",".join(map(repr, map(float, row))) for row in rows)]))
    return file


def test_a_measured_stroke_becomes_a_robot_s_profile(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the command, from curvatures and from the tip's place; the robot's file names what comes out."""
    t, k = made_up(noise=0.2)
    x, y = arc_tip(-k, 0.0355)  # another limb curls the other way
    files = (
        csv_of(tmp_path / "k.csv", time_s=t, curvature_per_m=k),
        csv_of(tmp_path / "tip.csv", time_s=t * 1.25, tip_x_m=x, tip_y_m=y),
    )
    done = frogkick(
        capsys, "robot", "fit-stroke", *files, "--length-m", "0.0355", "--out", tmp_path / "strokes.toml",
        "--picture", tmp_path / "fit.png", "--json",
    )  # fmt: skip
    assert done.code == 0, done.stderr
    assert [row["frequency_hz"] for row in done.json["profiles"]] == [0.64, 0.8]
    assert all(row["rms_per_m"] < 1.0 and row["drop_per_m"] > 85.0 for row in done.json["profiles"])
    assert (tmp_path / "fit.png").read_bytes()[:4] == b"\x89PNG"
    mine = tmp_path / "mine.toml"
    keys = 'base = "frog2022"\nprofiles_file = "strokes.toml"\negain_percent = 0.0\n'
    mine.write_text(f"{keys}profile_frequency_hz = 0.8\n")
    drop = load_robot(mine).actuation().drop_per_m
    assert drop == pytest.approx(k[0] - k.min(), abs=3.0)


def test_a_stroke_that_ends_a_picture_early_serves_its_period(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """0 to 2.49167 s at 120 pictures a second: 0.4013 Hz, and the robot's period is 2.5 s."""
    files = []
    for name, period_s in (("slow", 2.5), ("fast", 0.8)):
        t = np.arange(0.0, period_s, 1.0 / 120.0)
        k = 60.0 - 48.0 * (1.0 - np.exp(-((t / 0.06) ** 2))) * np.where(
            t < 0.16, 1.0, np.exp(-(t - 0.16) / (0.18 * period_s))
        )
        files.append(csv_of(tmp_path / f"{name}.csv", time_s=t, curvature_per_m=k))
    out, mine = tmp_path / "strokes.toml", tmp_path / "mine.toml"
    keys = 'base = "frog2022"\nprofiles_file = "strokes.toml"\negain_percent = 0.0\nperiod_s = 2.5\n'

    def fitted(*more: str) -> list[float]:
        done = frogkick(capsys, "robot", "fit-stroke", *files, "--out", out, *more, "--json")
        assert done.code == 0, done.stderr
        return [row["frequency_hz"] for row in done.json["profiles"]]

    assert fitted() == [0.4013, 1.263]
    mine.write_text(f"{keys}profile_frequency_hz = 0.4\n")
    early = load_robot(mine).actuation()
    assert load_robot(mine).at_period(0.8).actuation().duration_s == pytest.approx(0.8, rel=0.02)
    for far_hz in (0.39, 1.3):
        mine.write_text(f"{keys}profile_frequency_hz = {far_hz}\n")
        with pytest.raises(InputError, match=r"measured are 0 %: 0\.4013-1\.263 Hz"):
            load_robot(mine)
    assert fitted("--frequency-hz", "0.4", "--frequency-hz", "1.25") == [0.4, 1.25]
    mine.write_text(f"{keys}profile_frequency_hz = 0.4\n")
    exact = load_robot(mine).actuation()
    assert (early.duration_s, early.drop_per_m) == (exact.duration_s, exact.drop_per_m)
    refused = frogkick(capsys, "robot", "fit-stroke", *files, "--out", out, "--frequency-hz", "0.4")
    assert refused.code == 2
    assert "2 stroke files and 1 frequencies: give --frequency-hz once for each file" in refused.stderr


@pytest.mark.parametrize(
    ("text", "more", "says"),
    [
        ("", (), "is empty"),
        ("time,k\n0,1\n", (), "has no column 'time_s'"),
        ("time_s,k\n0,1\n", (), "has no column 'curvature_per_m'"),
        ("time_s,curvature_per_m\n", (), "has no rows"),
        ("time_s,curvature_per_m\n0,x\n", (), "line 2: could not convert string to float: 'x'"),
        ("time_s,curvature_per_m\n0,1\n1,2\n", (), "20 or more"),
        ("time_s,curvature_per_m\n-1,1\n1,2\n", (), "begins at -1 s"),
        ("time_s,curvature_per_m\n0,1\n1,2\n", ("--frequency-hz", "-2"), "-2.0 strokes a second"),
        ("time_s,tip_x_m,tip_y_m\n0,1,1\n", (), "the limb's length is None"),
        ("time_s,tip_x_m,tip_y_m\n0,1,1\n", ("--length-m", "0"), "the limb's length is 0.0"),
    ],
)
def test_files_that_hold_no_stroke_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, more: tuple[str, ...], says: str
) -> None:
    (tmp_path / "k.csv").write_text(text)
    out = tmp_path / "strokes.toml"
    done = frogkick(capsys, "robot", "fit-stroke", tmp_path / "k.csv", "--out", out, *more)
    assert done.code == 2 and says in done.stderr and done.stderr.count("\n") == 1, done.stderr
    assert not out.exists()


def halves(t: np.ndarray) -> np.ndarray:
    """Logistics that fall from 125 to 40 1/m at 0.1 s and rise to 124 1/m."""

    def rise(t: np.ndarray, start: float, end: float, centre: float, width: float) -> np.ndarray:
        at, first, last = (1.0 / (1.0 + np.exp(-(x - centre) / width)) for x in (t, start, end))
        return np.asarray((at - first) / (last - first))

    down = 125.0 - 85.0 * rise(t, 0.0, 0.1, 0.03, 0.008)
    return np.where(t < 0.1, down, 40.0 + 84.0 * rise(t, 0.1, 1.25, 0.4, 0.09))


def test_the_paper_s_form_meets_the_measured_ends() -> None:
    t = np.linspace(0.0, 1.25, 301)
    t[np.abs(t - 0.1).argmin()] = 0.1
    k = halves(t)
    profile = fit_halves(t, k, 10.0, 0.8, 130.0)
    assert (profile.start_per_m, profile.straightest_s) == (125.0, 0.1)
    assert profile.centre_s == pytest.approx((0.03, 0.4), rel=1e-3)
    assert profile.width_s == pytest.approx((0.008, 0.09), rel=1e-3)
    assert np.abs(profile.curvature_per_m(t) - k).max() < 0.01
    stroke = actuation([profile], 10.0, 0.8)
    at = np.arange(len(stroke.activation)) * stroke.step_s
    assert at[-1] == pytest.approx(1.25)
    assert np.abs(130.0 - stroke.drop_per_m * stroke.activation - halves(at)).max() < 0.02
    with pytest.raises(InputError, match=r"is 125 1/m at most, the robot's limbs 120 1/m at rest"):
        fit_halves(t, k, 10.0, 0.8, 120.0)


def test_profiles_in_the_paper_s_form_are_those_of_the_measurements(frog2022_dir: Path) -> None:
    robot = load_robot("frog2022-sim")
    assert len(robot.profiles) == len(load_robot("frog2022").profiles)
    for profile in robot.profiles:
        assert isinstance(profile, HalvesProfile)
        name = f"{round(profile.egain_percent / 10)}/{round(profile.frequency_hz * 10)}.mat"
        t, k = read_mat(frog2022_dir / "profile" / name, "mean")
        assert profile.curvature_per_m(t)[[0, -1]] == pytest.approx(k[[0, -1]], abs=1e-3)
        assert profile.curvature_per_m(t).min() == pytest.approx(k.min(), abs=1e-3)


def test_half_of_the_paper_s_form_is_refused() -> None:
    text = load_robot("frog2022-sim").toml
    for old, new in (("start_per_m = 123.116", ""), ("straightest_s = 0.125208681", "straightest_s = 9.0")):
        assert old in text
        with pytest.raises(InputError, match="give two terms, a start above 0 and a time within duration_s"):
            parse_robot(text.replace(old, new), "a robot")
