"""A pool with effects that no model contains."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.runs import rig

import frogkick as fk
from frogkick.core.errors import ConvergenceError, InputError
from frogkick.effects import World, make_effect, read_world
from frogkick.front.bench import why_unfinished
from frogkick.pool.pool import Camera, Pool
from frogkick.robot import load_robot
from frogkick.runs.summary import no_fresh_fix

ROBOT = load_robot("frog2022")


def swum(world: World, camera: Camera = Camera(), seed: int = 1) -> Pool:  # noqa: B008 - frozen
    pool = Pool(ROBOT, (0.0, 0.0, 0.0), camera, np.random.default_rng(seed), world)
    for limb in range(4):
        pool.actuate(limb, 0.1)
    pool.fixes = pool.advance(1.5)
    return pool


def test_a_world_without_effects_is_the_plain_pool_to_the_bit() -> None:
    plain, empty = swum(World()), Pool(ROBOT, (0.0, 0.0, 0.0), Camera(), np.random.default_rng(1))
    for limb in range(4):
        empty.actuate(limb, 0.1)
    fixes = empty.advance(1.5)
    assert np.array_equal(plain.truth.pose_world, empty.truth.pose_world)
    assert [fix.pose_world.tolist() for fix in plain.fixes] == [fix.pose_world.tolist() for fix in fixes]


def test_effects_act_on_the_robot_the_water_and_the_camera(tmp_path: Path) -> None:
    plain = swum(World())
    weak = swum(World((make_effect({"name": "limb_wear", "gain": 0.6}, tmp_path),)))
    assert weak.truth.pose_world[-1][0] < 0.8 * plain.truth.pose_world[-1][0]
    current = swum(World((make_effect({"name": "steady_current", "y_mps": 0.02}, tmp_path),)))
    assert current.truth.pose_world[-1][1] > plain.truth.pose_world[-1][1] + 1e-3
    exact = Camera(position_noise_m=0.0, heading_noise_rad=0.0)
    scaled = swum(World((make_effect({"name": "camera_scale", "scale": 1.1}, tmp_path),)), exact)
    for fix in scaled.fixes:
        row = int(np.argmin(np.abs(np.array(scaled.truth.time_s) - fix.capture_s)))
        assert fix.pose_world[0] == pytest.approx(1.1 * scaled.truth.pose_world[row][0], abs=1e-6)


def test_a_dropped_fix_is_lost_and_its_number_with_it(tmp_path: Path) -> None:
    (tmp_path / "dark.py").write_text(
        "class Dark:\n    def fix(self, fix, rng):\n        return None if rng.random() < 0.5 else fix\n"
    )
    (tmp_path / "world.toml").write_text('[[effect]]\nfile = "dark.py"\n')
    pool = swum(read_world(tmp_path / "world.toml"))
    numbers = [fix.sequence for fix in pool.fixes]
    assert 3 < len(numbers) < 18
    assert numbers == sorted(set(numbers))


def acting(on: str, key: str, formula: str, **values: tuple[float, str]) -> World:
    """A world with one law; its numbers have values and units."""
    parameters = {
        name: {"value": value, "unit": unit, "low": 0.0, "high": 1e6}
        for name, (value, unit) in values.items()
    }
    table = {"name": "law", "on": on, key: formula, "parameters": parameters}
    return World((make_effect(table, Path()),))


def test_water_that_is_much_too_fast_is_refused_with_its_limit() -> None:
    with pytest.raises(InputError, match="move the water at 5 m/s where the robot starts, 1 m/s is the most"):
        swum(acting("flow", "y_mps", "speed", speed=(5.0, "m/s")))
    swum(acting("flow", "y_mps", "speed", speed=(0.9, "m/s")))


def test_where_the_rods_fail_the_effects_of_the_world_are_named() -> None:
    with pytest.raises(ConvergenceError, match=r", and the effects of the world \(law\): the water moves at"):
        swum(acting("flow", "x_mps", "rate * time_s", rate=(1e4, "m/s^2")))


def test_a_run_without_fixes_says_what_to_check(tmp_path: Path) -> None:
    """A robot without fixes refuses START.

    A robot whose fixes mislead it says how many of them it refused.
    """
    (tmp_path / "dark.py").write_text("class Dark:\n    def fix(self, fix, rng):\n        return None\n")
    (tmp_path / "dark.toml").write_text('[[effect]]\nfile = "dark.py"\n')
    check = r"one of the last 2 s is needed: check the effects of --world that change, delay or drop fixes"

    def run(world: World | Path, plan: str = "onboard") -> fk.Run:
        return fk.run(rig.small_table(), robot="pool", world=world, plan=plan, time_limit_s=4.0)

    with pytest.raises(fk.FrogkickError, match=f"refuses START: no position fix came, and {check}"):
        run(tmp_path / "dark.toml")
    assert why_unfinished(run(tmp_path / "dark.toml", "host")).startswith("no position fix came; ")
    (tmp_path / "dark.py").write_text(
        "class Brief:\n    def fix(self, fix, rng):\n        return fix if fix.capture_s < 0.3 else None\n"
    )
    brief = run(tmp_path / "dark.toml")
    assert why_unfinished(brief).startswith("position fixes stopped coming")
    assert re.fullmatch(
        rf"its newest position fix is 4\.7\d s old, and {check}", no_fresh_fix(brief, 5.0, 2.0)
    )
    astray = run(acting("fix", "x_m", "speed * time_s", speed=(0.9, "m/s")))
    assert astray.ended == "position fixes lost"
    assert re.fullmatch(
        r"the robot refused its last (\d\d) position fixes, \1 as OUTLIER: they are too far from where the "
        r"robot can be, and from one another by more than 20 mm and 0\.15 m/s: .*",
        why_unfinished(astray),
    )
