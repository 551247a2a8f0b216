"""The camera over the simulated pool: late, noisy position fixes at a constant rate, and worse ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from frogkick.core.errors import InputError
from frogkick.core.poses import Fix, wrap_angle


@dataclass(frozen=True)
class Camera:
    """What the fixes are like. Defaults: rate and noise measured on the paper's recorded runs.

    Attributes:
        rate_hz: fixes per second (every second frame of a 30 Hz camera was logged).
        delay_s: from capture to arrival at the robot; the recorded label-to-motion time of 0.07 to 0.09 s.
        position_noise_m: standard deviation of each coordinate, measured at rest.
        heading_noise_rad: standard deviation of the heading, measured at rest.
        jitter_s: a fix comes later by up to this, evenly; beyond a picture's time fixes overtake each other.
        lost: part of the pictures that give no fix.
        doubled: part of the fixes whose frame comes twice, the second time up to 0.2 s later and with the age
            that it had the first time, so that it looks younger than it is.
        held: part of the fixes that come only after the next two pictures' ones.
        outliers: part of the fixes that are plainly wrong.
        outlier_m: such a fix is off by up to this in each coordinate; its heading is any.
    """

    rate_hz: float = 15.0
    delay_s: float = 0.08
    position_noise_m: float = 0.2e-3
    heading_noise_rad: float = float(np.deg2rad(0.2))
    jitter_s: float = 0.0
    lost: float = 0.0
    doubled: float = 0.0
    held: float = 0.0
    outliers: float = 0.0
    outlier_m: float = 0.5

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
                raise InputError(f"camera {name} is {value}, allowed is {low} to {high}")


def measure(
    camera: Camera,
    sequence: int,
    capture_s: float,
    pose_world: npt.NDArray[np.float64],
    rng: np.random.Generator,
) -> Fix:
    """The fix that the camera makes of a true pose.

    Args:
        camera: rate, delay and noise.
        sequence: number of the fix.
        capture_s: pool time of the picture.
        pose_world: (3,) true x_m, y_m, heading_rad.
        rng: source of the noise; three draws a fix.
    """
    sigma = np.array([camera.position_noise_m, camera.position_noise_m, camera.heading_noise_rad])
    noisy = np.asarray(pose_world, dtype=np.float64) + sigma * rng.standard_normal(3)
    noisy[2] = wrap_angle(noisy[2])
    return Fix(capture_s, camera.delay_s, *noisy.astype(np.float32).tolist(), sequence=sequence & 0xFFFF)


def deliver(camera: Camera, fix: Fix, rng: np.random.Generator) -> list[Fix]:
    """What comes of a fix on its way: nothing, itself (late or wrong), or itself twice.

    Args:
        camera: how bad the way is; one without jitter and faults lets every fix through and draws nothing.
        fix: as measured.
        rng: source of the faults.
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
