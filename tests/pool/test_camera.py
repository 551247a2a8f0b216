"""The camera's fixes: limits, noise, times."""

from __future__ import annotations

import numpy as np
import pytest
from tests.conftest import count

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix
from frogkick.pool.pool import Camera, Pool, deliver, measure
from frogkick.robot import load_robot


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("rate_hz", [0.99, 120.1, 0.0, -15.0]),
        ("delay_s", [-0.01, 1.01]),
        ("position_noise_m", [-1e-9, 0.11]),
        ("heading_noise_rad", [-1e-9, 1.01]),
        ("jitter_s", [-1e-9, 2.01]),
        ("lost", [-1e-9, 1.01]),
        ("doubled", [-1e-9, 1.01]),
        ("held", [-1e-9, 1.01]),
        ("outliers", [-1e-9, 1.01]),
        ("outlier_m", [-1e-9, 10.1]),
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


FIX = Fix(2.0, 0.08, 0.1, 0.2, 0.3, sequence=7)


def test_a_camera_without_faults_draws_nothing() -> None:
    rng = np.random.default_rng(1)
    before = rng.bit_generator.state
    assert deliver(Camera(), FIX, rng) == [FIX]
    assert rng.bit_generator.state == before


@pytest.mark.parametrize("name", ["lost", "doubled", "held", "outliers"])
@pytest.mark.parametrize("part", [0.0, 0.2, 1.0])
def test_faults_come_as_often_as_the_camera_says(name: str, part: float) -> None:
    rng, many = np.random.default_rng(3), count(2000, 50_000)
    camera = Camera(rate_hz=10.0, jitter_s=1e-9, **{name: part})
    came = [deliver(camera, FIX, rng) for _ in range(many)]
    faults = {
        "lost": [not fixes for fixes in came],
        "doubled": [len(fixes) == 2 for fixes in came],
        "held": [bool(fixes) and fixes[0].arrival_s > FIX.arrival_s + 0.24 for fixes in came],
        "outliers": [bool(fixes) and (fixes[0].pose_world != FIX.pose_world).any() for fixes in came],
    }
    for fault, seen in faults.items():
        expected = part if fault == name else 0.0
        assert abs(np.mean(seen) - expected) <= 5 * np.sqrt(expected * (1 - expected) / many), fault


def test_what_each_fault_does() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        first, again = deliver(Camera(doubled=1.0), FIX, rng)
        assert (first.sequence, again.sequence) == (FIX.sequence, FIX.sequence)
        assert (first.arrival_s, first.capture_s) == (FIX.arrival_s, FIX.capture_s)
        assert (first.pose_world == FIX.pose_world).all()
        assert 0.0 <= again.arrival_s - first.arrival_s <= 0.2
        # The same age at another time: it looks younger than it is.
        assert again.arrival_s - again.capture_s == pytest.approx(first.arrival_s - first.capture_s)
        assert (again.pose_world == FIX.pose_world).all()
        (late,) = deliver(Camera(jitter_s=0.3), FIX, rng)
        assert FIX.arrival_s <= late.arrival_s <= FIX.arrival_s + 0.3 and late.capture_s == FIX.capture_s
        (wrong,) = deliver(Camera(outliers=1.0, outlier_m=0.4), FIX, rng)
        assert (np.abs(wrong.pose_world[:2] - FIX.pose_world[:2]) <= 0.4 + 1e-6).all()
        assert abs(wrong.pose_world[2]) <= np.float32(np.pi)


def test_fixes_of_a_bad_camera_arrive_in_their_order() -> None:
    robot = load_robot("frog2022")
    camera = Camera(rate_hz=20.0, jitter_s=0.3, lost=0.2, doubled=0.2, held=0.2, outliers=0.1)
    pool = Pool(robot, (0.0, 0.0, 0.0), camera, np.random.default_rng(2))
    fixes = [(at_s, fix) for at_s in np.arange(0.1, 6.0, 0.1) for fix in pool.advance(float(at_s))]
    arrivals = [fix.arrival_s for _, fix in fixes]
    assert arrivals == sorted(arrivals)
    assert all(at_s - 0.1 - 1e-9 <= fix.arrival_s <= at_s + 1e-9 for at_s, fix in fixes)
    numbers = [fix.sequence for _, fix in fixes]
    assert numbers != sorted(numbers), "some overtook others"
    assert len(set(numbers)) < len(numbers), "some came twice"
    assert len(set(numbers)) < len(pool.truth.time_s) - 10, "some were lost"


def test_a_time_that_is_a_picture_s_but_for_rounding_is_the_picture_s() -> None:
    """A decision may fall on a picture but for rounding, and the rods take no step of 1e-15 s."""
    pool = Pool(load_robot("frog2022"), (0.0, 0.0, 0.0), Camera(rate_hz=5.0), np.random.default_rng(2))
    pool.actuate(0, 0.0)
    for at_s in (0.2, 0.4, 0.6000000000000002, 0.8, 0.9999999999999998, 1.0):
        pool.advance(at_s)
    for limb, start_s, text in (
        (0, 0.5, "fire now or later"), (0, np.inf, "fire now or later"), (0, np.nan, "fire now or later"),
        (-1, 1.1, "is -1: give 0 to 3"), (4, 1.1, "is 4: give 0 to 3"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=text):
            pool.actuate(limb, start_s)
    with pytest.raises(InputError, match="finite"):
        pool.put((0.0, np.nan, 0.0))
    pool.advance(np.nextafter(1.2, 0.0))
    pool.advance(np.nextafter(1.2, 2.0))
    pose, velocity = pool.state()
    assert np.isfinite(pose).all() and np.hypot(*velocity[:2]) > 0.0
    assert len(pool.truth.time_s) == 6
