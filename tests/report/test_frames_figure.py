"""The picture of frames and units: the same as in the documentation, and true to the robot that it draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.cli.commands import frogkick
from tests.conftest import REPOSITORY

from frogkick.report.frames_figure import POSE, frames_figure
from frogkick.robot import load_robot

TRACKED = REPOSITORY / "host/pictures/frames.png"


def test_the_tracked_picture_is_what_the_command_draws(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "frames.png"
    output = frogkick(capsys, "robot", "frames", "--out", out, "--json")
    assert output.code == 0 and output.json["units"]["angle"] == "rad"
    with Image.open(out) as made, Image.open(TRACKED) as kept:
        assert np.array_equal(np.asarray(made), np.asarray(kept)), "frogkick robot frames --out " + str(
            TRACKED
        )


def test_left_is_left_and_limbs_are_where_the_robot_has_them() -> None:
    """Seen from above, x to the right and y up: counter-clockwise is counter-clockwise."""
    axes = frames_figure().axes[0]
    assert axes.get_xlim()[0] < axes.get_xlim()[1] and axes.get_ylim()[0] < axes.get_ylim()[1]
    named = {text.get_text(): np.array(text.get_position()) for text in axes.texts}
    robot = load_robot("frog2022")
    c, s = np.cos(POSE[2]), np.sin(POSE[2])
    for limb in robot.limbs:
        forward, left = np.array([[c, s], [-s, c]]) @ (named[limb.name] - np.array(POSE[:2]))
        root = robot.frame.corners_m[limb.corner]
        assert (forward > 0, left > 0) == (root[0] > 0, root[1] > 0), limb.name
    ahead = np.array([[c, s], [-s, c]]) @ (named["x, forward"] - np.array(POSE[:2]))
    beside = np.array([[c, s], [-s, c]]) @ (named["y, left"] - np.array(POSE[:2]))
    assert ahead[0] > 0.2 and abs(ahead[1]) < 1e-9 and beside[1] > 0.2 and abs(beside[0]) < 1e-9


def test_a_name_that_is_no_picture_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = frogkick(capsys, "robot", "frames", "--out", tmp_path / "frames.txt")
    assert output.code == 2 and "does not end in .png or .svg or .pdf" in output.stderr
    assert list(tmp_path.iterdir()) == []
