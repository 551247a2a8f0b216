"""Effects in a robot's own file: what the model knows, in its library too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.conftest import count, from_ci

from frogkick.core.errors import InputError
from frogkick.effects import effects_of, rods_of
from frogkick.library import build_library, read_library
from frogkick.library.sampling import rigid_starts
from frogkick.library.transitions import simulate_task
from frogkick.robot import Robot, load_robot, mirror_of
from frogkick.robot.load import BUILT_IN, parse_robot

PLAIN = load_robot("frog2022")


def robot_with(effects: str, folder: Path) -> Robot:
    (folder / "frog2022.profiles.toml").write_text((BUILT_IN / "frog2022.profiles.toml").read_text())
    (folder / "worn.toml").write_text((BUILT_IN / "frog2022.toml").read_text() + effects)
    return load_robot(folder / "worn.toml")


def moved(robot: Robot, action: str) -> np.ndarray:
    """(6,) transition of an action from rest."""
    (task,) = rigid_starts(robot, np.zeros((1, 3))).tasks
    return simulate_task(rods_of(robot), task).rows[0, [a.name for a in robot.actions].index(action)]


def test_a_worn_limb_in_the_file_changes_the_transitions_that_fire_it(tmp_path: Path) -> None:
    worn = robot_with('\n[[effect]]\nname = "limb_wear"\nlimb = "rear_left"\ngain = 0.7\n', tmp_path)
    assert worn.sha256 != PLAIN.sha256
    assert mirror_of(PLAIN) is not None and mirror_of(worn) is None
    assert moved(worn, "A") == pytest.approx(moved(PLAIN, "A"), abs=1e-9)  # the front limbs only
    assert abs(moved(worn, "B")[2]) > 0.02 > abs(moved(PLAIN, "B")[2])


@from_ci
def test_history_and_resistance_act_over_several_strokes(tmp_path: Path) -> None:
    fading = robot_with(
        '\n[[effect]]\nname = "limb_memory"\nloss = 0.4\n[[effect]]\nname = "yaw_drag"\nlinear_nms = 1e-3\n',
        tmp_path,
    )
    ends = {}
    for name, robot in (("plain", PLAIN), ("fading", fading)):
        out = tmp_path / f"{name}.h5"
        build_library(robot, count(12, 12, 6), 3, 1, out, sampling="visited", record_s=0.0)
        ends[name] = read_library(out).velocity_body_end
    assert np.isfinite(ends["fading"]).all()
    spread = [np.abs(ends[name][..., 2]).max() for name in ("plain", "fading")]
    assert spread[1] < 0.8 * spread[0]  # a robot that resists turning ends its periods turning more slowly


def test_a_file_s_text_comes_back_with_its_effects(tmp_path: Path) -> None:
    text = '\n[[effect]]\nname = "drag_scale"\nframe = 1.5\nlimbs = 2.0\n'
    robot = robot_with(text, tmp_path)
    again = parse_robot(robot.toml, "again")
    assert again.sha256 == robot.sha256 and again.effects == robot.effects
    (effect,) = effects_of(again)
    assert (effect.value("frame"), effect.value("limbs")) == (1.5, 2.0)
    assert rods_of(robot).mesh.edge_drag_normal[0] == pytest.approx(
        1.5 * rods_of(PLAIN).mesh.edge_drag_normal[0]
    )


def test_an_effect_that_did_not_come_along_is_named(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "class Mine:\n    def stroke(self, stroke, history, rng):\n        pass\n"
    )
    robot = robot_with('\n[[effect]]\nfile = "mine.py"\n', tmp_path)
    assert effects_of(robot)[0].title == "Mine"
    with pytest.raises(InputError, match=r"'mine.py', whose folder is not known"):
        effects_of(parse_robot(robot.toml, "text"))
    wrong = robot_with('\n[[effect]]\nname = "limb_wear"\nlimb = "tail"\n', tmp_path)
    with pytest.raises(InputError, match="no limb 'tail'"):
        rods_of(wrong)


def test_mass_at_the_centre_turns_more_easily_and_swims_alike() -> None:
    centred = replace(PLAIN, frame=replace(PLAIN.frame, centre_mass_share=0.5))
    plain, other = rods_of(PLAIN).mesh, rods_of(centred).mesh
    assert other.mass_kg.sum() == pytest.approx(plain.mass_kg.sum(), rel=1e-12)
    inertia = [float(mesh.mass_kg @ (mesh.rest_m**2).sum(axis=1)) for mesh in (plain, other)]
    assert 0.45 < inertia[1] / inertia[0] < 0.6
    assert abs(moved(centred, "E")[2]) > 1.3 * abs(moved(PLAIN, "E")[2])
    assert moved(centred, "B")[0] == pytest.approx(moved(PLAIN, "B")[0], rel=0.02)
