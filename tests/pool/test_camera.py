"""The camera's fixes: limits, noise, times."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import count

from frogkick.errors import InputError
from frogkick.pool.camera import Camera, measure


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("rate_hz", [0.99, 120.1, 0.0, -15.0]),
        ("delay_s", [-0.01, 1.01]),
        ("position_noise_m", [-1e-9, 0.11]),
        ("heading_noise_rad", [-1e-9, 1.01]),
    ],
)
def test_values_out_of_limits_are_named(name: str, values: list[float]) -> None:
    for value in [*values, np.nan, np.inf]:
        with pytest.raises(InputError, match=f"camera {name} is {value}"):
            Camera(**{name: value})


def test_noise_is_what_the_camera_says() -> None:
    rng = np.random.default_rng(8)
    camera = Camera(position_noise_m=1e-3, heading_noise_rad=0.02)
    true = np.array([0.1, -0.2, 3.14])
    many = count(4000, 40_000)
    errors = np.array([measure(camera, 0, 0.0, true, rng).pose_world - true for _ in range(many)])
    errors[:, 2] = np.angle(np.exp(1j * errors[:, 2]))
    sigma = np.array([1e-3, 1e-3, 0.02])
    assert (np.abs(errors.mean(axis=0)) < 5 * sigma / np.sqrt(many) + 1e-7).all()
    assert (np.abs(errors.std(axis=0) / sigma - 1) < 5 / np.sqrt(2 * many)).all()


def test_a_fix_is_what_the_link_carries() -> None:
    fix = measure(Camera(delay_s=0.08), 65_537, 2.5, np.array([1.0, 2.0, 10.0]), np.random.default_rng(1))
    assert fix.sequence == 1 and fix.arrival_s == 2.58 and fix.capture_s == 2.5
    assert fix.pose_world.dtype == np.float32 and abs(fix.pose_world[2]) <= np.float32(np.pi)


def test_a_camera_without_noise_gives_the_truth() -> None:
    camera = Camera(position_noise_m=0.0, heading_noise_rad=0.0)
    pose = np.array([0.25, -0.5, 0.75])
    assert (measure(camera, 0, 0.0, pose, np.random.default_rng(1)).pose_world == pose).all()
