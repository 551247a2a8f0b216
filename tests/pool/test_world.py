"""A pool with effects in it that no model was told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from frogkick.effects import World, make_effect, read_world
from frogkick.pool.camera import Camera
from frogkick.pool.pool import Pool
from frogkick.robot import load_robot

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
