"""A data folder in the paper's layout, made from the model itself: what validation must find is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import savemat

from frogkick.der import prepare
from frogkick.effects.swims import Gait
from frogkick.robot import Robot, load_robot
from frogkick.validation.gaits import GaitSwim, swim_gaits

GAIT = Gait(10.0, 1.0, 0.5)


def model_swim(gait: Gait, robot: Robot | None = None) -> GaitSwim:
    """What the model, or another robot, gives for a gait."""
    robot = robot or load_robot("frog2022")
    (swum,) = swim_gaits(prepare(robot), robot.profiles, [gait])
    assert isinstance(swum, GaitSwim)
    return swum


def simulation_name(gait: Gait) -> str:
    """As the authors name an exported run."""
    return (
        f"simDER_phaseDelay_{gait.phase:f}_frequency_{gait.frequency_hz:f}_EGaIn_{gait.egain_percent:f}.txt"
    )


def write_simulation(
    folder: Path, gait: Gait, scale: float = 1.0, wave_m: float = 0.0, robot: Robot | None = None
) -> Path:
    """Export the model's own run as the authors do, with its distances scaled and a wave on top.

    The wave is a sine of one period a cycle, so it changes no speed over whole cycles.
    """
    swum = model_swim(gait, robot)
    time_s = np.arange(1, round(8e3 / gait.frequency_hz) + 1) / 1e3
    forward_m = scale * np.interp(time_s, swum.time_s, swum.forward_m)
    forward_m += wave_m * np.sin(2.0 * np.pi * gait.frequency_hz * time_s)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / simulation_name(gait)
    np.savetxt(file, np.column_stack([time_s, 0.0 * time_s, forward_m]), fmt="%.10g")
    return file


def write_swim(
    file: Path, speed_mps: float, frequency_hz: float, cycles: float, surge_m: float = 0.0
) -> None:
    """A measured swim at 60 frames/s: a steady speed and a surge in each cycle."""
    time_s = np.arange(0.0, cycles / frequency_hz, 1.0 / 60.0)
    distance_m = speed_mps * time_s + surge_m * np.sin(2.0 * np.pi * frequency_hz * time_s)
    file.parent.mkdir(parents=True, exist_ok=True)
    savemat(file, {"t": time_s[None, :], "distance": 1e3 * distance_m[:, None]})
