"""How far a table errs on states that are not in it: one look-up against one simulation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from frogkick.der import prepare
from frogkick.errors import ConvergenceError
from frogkick.library.sampling import sample_velocities
from frogkick.library.transitions import simulate_transitions
from frogkick.planner.image import Tables
from frogkick.robot import Robot

FloatArray = NDArray[np.float64]

_AT_ONCE = 16


def table_error(
    tables: Tables,
    robot: Robot,
    states: int,
    seed: int,
    sampling: str = "box",
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> dict[str, float]:
    """Root mean square error of a table's transitions on unseen initial velocities.

    Args:
        tables: the table.
        robot: what to simulate for the truth.
        states: unseen velocities.
        seed: of their sampling; not the library's own.
        sampling: as for ``sample_velocities``.
        progress: called with states done and to do.

    Returns:
        ``position_m``, ``heading_rad`` at the period's end, and ``velocity_mps``, ``omega_rad_s`` there.

    Raises:
        ConvergenceError: a simulation failed.
    """
    rods = prepare(robot)
    velocities = sample_velocities(robot, states, seed, sampling)
    truth = np.empty((states, len(robot.actions), 6))
    for first in range(0, states, _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        truth[some], failed = simulate_transitions(rods, velocities[some])
        if failed:
            raise ConvergenceError(
                f"unseen state {first + failed[0].state} cannot be simulated: {failed[0].reason}"
            )
        progress(min(first + _AT_ONCE, states), states)
    gap = looked_up(tables, velocities) - truth
    gap[..., 2] = np.arctan2(np.sin(gap[..., 2]), np.cos(gap[..., 2]))

    def rms(*columns: int) -> float:
        return float(np.sqrt((gap[..., list(columns)] ** 2).sum(axis=-1).mean()))

    return {
        "position_m": rms(0, 1),
        "heading_rad": rms(2),
        "velocity_mps": rms(3, 4),
        "omega_rad_s": rms(5),
    }


def looked_up(tables: Tables, velocities: FloatArray) -> FloatArray:
    """(n, a, 6) transitions of the nearest state to each of (n, 3) body velocities, in SI units."""
    scale = tables.velocity_scale.astype(np.float64)
    codes = velocities / scale
    apart = ((codes[:, None, :] - tables.states[None, :, :]) ** 2).sum(axis=2)
    rows = tables.transitions[apart.argmin(axis=1)].astype(np.float64)
    return np.concatenate(
        [rows[..., :3] * tables.motion_scale.astype(np.float64), rows[..., 3:] * scale], axis=-1
    )
