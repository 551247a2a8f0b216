"""The camera of the simulated pool: late and noisy position fixes, with optional faults."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np

from frogkick.core.arrays import Float64
from frogkick.core.errors import InputError
from frogkick.core.poses import Fix, wrap_angle


@dataclass(frozen=True)
class Camera:
    """Rate, delay, noise and faults of the fixes. The defaults were measured on the paper's recorded runs."""

    rate_hz: float = 15.0  # fixes per second (every second frame of a 30 Hz camera was logged)
    # from capture to arrival at the robot; the recorded label-to-motion time of 0.07 to 0.09 s
    delay_s: float = 0.08
    position_noise_m: float = 0.2e-3  # standard deviation of each coordinate, measured at rest
    heading_noise_rad: float = float(np.deg2rad(0.2))  # standard deviation of the heading, measured at rest
    jitter_s: float = 0.0  # largest additional delay, uniformly distributed
    lost: float = 0.0  # share of pictures without a fix
    # share of fixes that arrive twice, the second time up to 0.2 s later with an unchanged age
    doubled: float = 0.0
    held: float = 0.0  # share of fixes that arrive after those of the next two pictures
    outliers: float = 0.0  # share of wrong fixes
    outlier_m: float = 0.5  # largest error of a wrong fix in each coordinate; its heading is random

    def __post_init__(self) -> None:
        limits = {
            "rate_hz": (1.0, 120.0),
            "delay_s": (0.0, 1.0),
            "position_noise_m": (0.0, 0.1),
            "heading_noise_rad": (0.0, 1.0),
            "jitter_s": (0.0, 2.0),
            "outlier_m": (0.0, 10.0),
            **dict.fromkeys(("lost", "doubled", "held", "outliers"), (0.0, 1.0)),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(
                    f"camera {name} is {value}, allowed is {low} to {high}: give a number in that range"
                )


def noise_of_run(seed: int, path_name: str, points: int) -> np.random.Generator:
    """Random generator for a run along a path.

    With one seed, runs along different paths have different noise, because identification assumes the fixes
    of several runs to be independent. Runs along one path have the same noise, so that they can be compared.
    """
    return np.random.default_rng([seed, zlib.crc32(f"{path_name} {points}".encode())])


def measure(
    camera: Camera, sequence: int, capture_s: float, pose_world: Float64, rng: np.random.Generator
) -> Fix:
    """The fix of a true pose (3,) in a picture of pool time ``capture_s``; three draws from ``rng``."""
    sigma = np.array([camera.position_noise_m, camera.position_noise_m, camera.heading_noise_rad])
    noisy = np.asarray(pose_world, dtype=np.float64) + sigma * rng.standard_normal(3)
    noisy[2] = wrap_angle(noisy[2])
    return Fix(capture_s, camera.delay_s, *noisy.astype(np.float32).tolist(), sequence=sequence & 0xFFFF)


def deliver(camera: Camera, fix: Fix, rng: np.random.Generator) -> list[Fix]:
    """The fixes that arrive for a measured one: none, one (late or wrong), or two.

    A camera without jitter and faults draws nothing from ``rng``.
    """
    if not (camera.jitter_s or camera.lost or camera.doubled or camera.held or camera.outliers):
        return [fix]
    lost, doubled, held, wrong = rng.random(4) < (camera.lost, camera.doubled, camera.held, camera.outliers)
    late_s = camera.jitter_s * rng.random() + (2.5 / camera.rate_hz if held else 0.0)
    off_m, turn_rad = rng.uniform(-camera.outlier_m, camera.outlier_m, 2), rng.uniform(-np.pi, np.pi)
    again_s = rng.uniform(0.0, 0.2)
    if lost:
        return []
    came = replace(fix, delay_s=fix.delay_s + late_s)
    if wrong:
        came = replace(came, x_m=fix.x_m + off_m[0], y_m=fix.y_m + off_m[1], heading_rad=turn_rad)
    return [came, replace(came, capture_s=came.capture_s + again_s)] if doubled else [came]
