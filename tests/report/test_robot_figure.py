"""The picture of a robot shows its parts in their places; and its commands."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.conftest import from_ci

from frogkick.cli.main import run_command
from frogkick.core.errors import InputError
from frogkick.der import prepare
from frogkick.report import style
from frogkick.report.robot_figure import robot_figure
from frogkick.robot import built_in_robots, limb_points, load_robot


@pytest.mark.parametrize("name", built_in_robots())
def test_every_part_is_drawn_at_its_place(name: str) -> None:
    robot = load_robot(name)
    mesh = prepare(robot).mesh
    axes = robot_figure(robot).axes[0]
    # On the page: left of the robot to the left, forward up.
    lines = {line: np.column_stack([line.get_ydata(), line.get_xdata()]) for line in axes.lines}
    left, right = axes.get_xlim()
    assert left > right
    assert "forward (mm)" in axes.get_ylabel()

    def drawn(points_mm: np.ndarray, colour: str) -> bool:
        return any(
            p.shape == points_mm.shape and np.allclose(p, points_mm, atol=1e-9) and line.get_color() == colour
            for line, p in lines.items()
        )

    offset = np.array(robot.frame.corners_m[0]) - mesh.rest_m[0]
    nodes_mm = 1e3 * (mesh.rest_m + offset)
    assert drawn(nodes_mm[[*range(mesh.frame_nodes), 0]], style.DESIRED)
    fall = robot.actuation().drop_per_m
    texts = [text.get_text() for text in axes.texts]
    for index, limb in enumerate(robot.limbs):
        assert drawn(1e3 * limb_points(robot.frame, limb), style.TRUE)
        assert drawn(1e3 * limb_points(robot.frame, limb, fall), style.ALARM)
        assert any(text.startswith(f"{index} {limb.name}\n") for text in texts)
    assert drawn(1e3 * offset[None, :], "black")
    assert "forward" in texts


def test_the_active_limb_is_straighter_and_points_back() -> None:
    robot = load_robot("frog2022")
    fall = robot.actuation().drop_per_m
    for limb in robot.limbs:
        rest, active = (limb_points(robot.frame, limb, f) for f in (0.0, fall))
        reach = [float(np.hypot(*(points[-1] - points[0]))) for points in (rest, active)]
        assert reach[1] > 1.8 * reach[0]
        assert active[-1, 0] < active[0, 0] - 0.02


@from_ci
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_the_same_robot_gives_the_same_bytes(ending: str, tmp_path: Path) -> None:
    robot = load_robot("streamlined")
    for name in ("one", "two"):
        style.write_picture(robot_figure(robot), tmp_path / f"{name}.{ending}")
    assert (tmp_path / f"one.{ending}").read_bytes() == (tmp_path / f"two.{ending}").read_bytes()


def test_other_kinds_of_pictures_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.png or \.svg or \.pdf"):
        style.write_picture(robot_figure(load_robot("frog2022")), tmp_path / "x.bmp")
    assert list(tmp_path.iterdir()) == []


def test_show_says_what_the_robot_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "hex.png"
    assert run_command(["robot", "show", "hexapod", "--out", str(out), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["id"], output["nodes"], len(output["limbs"]), len(output["actions"])) == (
        "hexapod",
        158,
        6,
        12,
    )
    assert output["limbs"][5]["name"] == "middle_right"
    assert output["limbs"][5]["root_m"] == [0.0, -0.06]
    assert output["actions"][2] == {
        "name": "C",
        "first": ["front_left", "middle_left"],
        "second": ["rear_left"],
    }
    assert output["sizes"]["frame_length_m"] == pytest.approx(0.12)
    assert output["sizes"]["frame_width_m"] == pytest.approx(0.12)
    assert output["mass_kg"] == pytest.approx(load_robot("hexapod").mass_kg)
    assert output["sizes"]["mass_with_water_kg"] > output["mass_kg"]
    assert output["limits"]["limbs_at_once_max"] == 4
    with Image.open(out) as picture:
        assert min(picture.size) > 600


def test_show_warns_on_stderr_and_list_lists(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = load_robot("frog2022").toml
    mine = tmp_path / "mine.toml"
    # Only action A is left: the rear limbs never fire.
    actions = re.findall(r"\[\[action\]\].*?(?=\n\[)", text, flags=re.DOTALL)
    for block in actions[1:]:
        text = text.replace(block, "")
    mine.write_text(text)
    assert run_command(["robot", "show", str(mine)]) == 0
    shown = capsys.readouterr()
    assert "warning: limbs rear_left, rear_right: no action fires it" in shown.err
    assert "limb 2 rear_left: corner 2 at (-45, 45) mm, actions none" in shown.out
    assert run_command(["robot", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["robots"]
    assert [row["name"] for row in listed] == list(built_in_robots())
    assert run_command(["robot", "show", "hexpod"]) == 2
    assert "did you mean 'hexapod'" in capsys.readouterr().err


def test_letters_that_the_font_lacks_are_drawn_without_a_warning(tmp_path: Path) -> None:
    """A file's name is a title, and a warning is an error here."""
    with style.new_figure(2.0, 2.0) as figure:
        figure.suptitle("run \u65e5.h5")
        assert style.png_of(figure).startswith(b"\x89PNG")
        style.write_picture(figure, tmp_path / "a.png")
    assert [each.name for each in tmp_path.iterdir()] == ["a.png"]
