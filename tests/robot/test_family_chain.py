"""Robots of other shapes go the whole way with no line of code changed: simulation to closed loop."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.conftest import from_ci
from tests.der.single import simulate_action

from frogkick.cli.main import run_command
from frogkick.der import Rods, prepare
from frogkick.effects.swims import simulate_actions
from frogkick.robot import Action, Robot, load_robot
from frogkick.tables.image import read_image
from frogkick_codegen.toolchain import FLAGS, zig

OTHERS = ("streamlined", "hexapod")
MIRRORED = {"streamlined": ("CD", "EF", "GH"), "hexapod": ("CD", "EF", "GH", "IJ")}
SYMMETRIC = {"streamlined": "AB", "hexapod": "ABK"}
FORWARD_TO_MIRROR = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])


@pytest.fixture(scope="module", params=OTHERS)
def rods(request: pytest.FixtureRequest) -> Rods:
    return prepare(load_robot(request.param))


def stroke(rods: Rods, action: Action, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    return np.array(simulate_action(rods.robot, velocity, action, rods.robot.period_s, rods=rods))


def mirror(robot: Robot, mask: int) -> int:
    """The mask of the limbs on the other side, found by their corners alone."""
    places = [robot.frame.corners_m[limb.corner] for limb in robot.limbs]
    return sum(
        1 << other
        for limb, (x, y) in enumerate(places)
        for other, place in enumerate(places)
        if mask >> limb & 1 and place == (x, -y)
    )


def test_symmetric_strokes_swim_straight(rods: Rods) -> None:
    for name in SYMMETRIC[rods.robot.id]:
        moved = stroke(rods, rods.robot.action(name), (0.02, 0.0, 0.0))
        assert moved[0] > 0.02 * 0.3 * rods.robot.period_s
        assert moved[[1, 2, 4, 5]] == pytest.approx(0.0, abs=1e-9)


def test_mirrored_strokes_mirror(rods: Rods) -> None:
    robot = rods.robot
    for one, other in MIRRORED[robot.id]:
        left, right = robot.action(one), robot.action(other)
        assert mirror(robot, left.first_mask) == right.first_mask
        assert mirror(robot, left.second_mask) == right.second_mask
        moved = stroke(rods, left, (0.02, 0.01, -0.2))
        mirrored = stroke(rods, right, (0.02, -0.01, 0.2))
        assert mirrored == pytest.approx(FORWARD_TO_MIRROR * moved, abs=1e-7)
        assert abs(moved[2]) > 1e-3 or one == "E"


def test_the_streamlined_hull_is_the_faster_one_of_the_same_mass() -> None:
    square, slender = load_robot("frog2022"), load_robot("streamlined")
    assert slender.mass_kg == pytest.approx(square.mass_kg, rel=1e-12)
    speeds = [simulate_actions(robot, ["B"] * 6).speed_mps for robot in (square, slender)]
    assert speeds[1] > 1.2 * speeds[0]


def json_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert run_command([*arguments, "--json"]) == 0, capsys.readouterr().err
    output = json.loads(capsys.readouterr().out)
    assert isinstance(output, dict)
    return output


@from_ci
def test_six_limbs_from_the_file_to_the_closed_loop(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Library, table, emitted C, both firmware targets, checks on the virtual chip, a run along a path."""
    robot = load_robot("hexapod")
    lib, fkt, emitted = tmp_path / "lib.h5", tmp_path / "hex.fkt", tmp_path / "emitted"
    output = json_of(
        capsys, "library", "build", "hexapod", "--states", "6", "--sampling", "visited", "--workers", "1",
        "--out", str(lib),
    )  # fmt: skip
    assert output["transitions"] == 72
    json_of(capsys, "tables", "build", str(lib), "--test-states", "4", "--out", str(fkt))
    tables = read_image(fkt)
    assert (tables.robot_id, tables.limbs, len(tables.actions), len(tables.states)) == ("hexapod", 6, 12, 6)
    assert [(a.first_mask, a.second_mask) for a in tables.actions] == [
        (a.first_mask, a.second_mask) for a in robot.actions
    ]

    json_of(capsys, "codegen", str(fkt), "--out", str(emitted))
    program = tmp_path / "example"
    zig("host").run([*FLAGS, f"-I{emitted}", *sorted(emitted.glob("*.c")), "-o", program], folder=tmp_path)
    assert subprocess.run([program], capture_output=True, check=False).returncode == 0

    json_of(
        capsys, "firmware", "build", "--target", "native", "--tables", str(fkt), "--out", str(tmp_path / "n")
    )
    bench = json_of(
        capsys, "firmware", "build", "--target", "bench", "--tables", str(fkt), "--out", str(tmp_path / "b")
    )
    assert bench["flash_bytes"]
    json_of(capsys, "firmware", "test", "--tables", str(fkt))
    same = json_of(
        capsys, "parity", "--tables", str(fkt), "--states", "1000", "--chip-states", "32",
        "--loop-decisions", "40",
    )  # fmt: skip
    assert {"python-native": 0, "python-chip": 0, "native-chip": 0}.items() <= same["mismatches"].items()
    assert {"python-native": 0, "native-chip": 0}.items() <= same["loop_mismatches"].items()

    path = tmp_path / "ahead.csv"
    path.write_text("x,y\n0,0\n0.12,0\n")
    ran = json_of(
        capsys, "run", "--robot", "pool", "--tables", str(fkt), "--path", str(path), "--simulated-time", "40",
        "--out", str(tmp_path / "run.h5"),
    )  # fmt: skip
    assert ran["completed"] is True
    assert ran["limit_violations"] == 0
    assert float(str(ran["mean_distance_m"])) < 0.05
