"""Truncates a library to another period by its recorded motions, without a simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from frogkick.core.errors import InputError
from frogkick.core.poses import body_from_world
from frogkick.der.strokes import cubic
from frogkick.library.store import Library, library_of, read_library, read_recorded
from frogkick.robot import Robot


def truncate_library(path: Path | str, robot: Robot) -> Library:
    """The library of a robot with another period, from one that was recorded up to that period.

    Displacements and velocities at the new period are on the cubic through two recorded poses and velocities.

    Args:
        path: a library.
        robot: the library's robot with another period; settings that do not move it may differ too.

    Raises:
        InputError: see read_library; another robot, a period that was not recorded, or states amid strokes.
    """
    library, recorded = read_library(path), read_recorded(path)
    if _moves_like(robot) != _moves_like(library.robot()):
        raise InputError(
            f"robot {robot.id!r} is not the one of library {str(path)!r} with another period only: "
            "build a library for it"
        )
    if library.has_history():
        raise InputError(
            f"library {str(path)!r} has states amid strokes {library.period_s:g} s apart: build one for "
            f"{robot.period_s:g} s, or cut one of --sampling box"
        )
    times, period = recorded.time_s, robot.period_s
    if not len(times) or not times[0] <= period <= times[-1]:
        range_s = f"{times[0]:g}-{times[-1]:g} s are" if len(times) else "nothing is"
        raise InputError(
            f"period {period:g} s cannot be cut from library {str(path)!r}, where {range_s} recorded: build "
            "one"
        )
    left = int(np.clip(np.searchsorted(times, period, side="right") - 1, 0, len(times) - 2))
    ends = recorded.motion[:, :, left : left + 2].astype(np.float64)
    pose, rate = ends[..., :3], body_from_world(-ends[..., 2], ends[..., 3:])
    length = np.asarray(times[left + 1] - times[left])
    share = np.asarray((period - times[left]) / length)
    at, slope = cubic(pose[:, :, 0], pose[:, :, 1], rate[:, :, 0], rate[:, :, 1], length, share)
    rows = np.concatenate([at, body_from_world(at[..., 2], slope)], axis=-1)
    return library_of(
        robot, library.sampling, library.seed, library.initial_velocity_body, rows,
        library.previous_actions, library.failed,
    )  # fmt: skip


def _moves_like(robot: Robot) -> tuple[object, ...]:
    """Everything that decides how a robot moves in water after an action."""
    return (
        robot.frame,
        robot.limbs,
        robot.actions,
        robot.second_delay_s,
        robot.profiles,
        robot.egain_percent,
        robot.profile_frequency_hz,
        robot.water_density_kg_per_m3,
    )
