"""Error of a table on unseen states: look-ups against simulations."""

from __future__ import annotations

from typing import Any

import numpy as np

from frogkick.core.arrays import Float64, Int64
from frogkick.core.compiled import kept, stamp_of
from frogkick.core.poses import wrap_angle
from frogkick.library.store import Library
from frogkick.planner.lookup import DYNAMICS, arrays_of, dynamics_after, find_row, motion_of, velocity_code
from frogkick.tables.image import Tables


def error_on(tables: Tables, unseen: Library) -> dict[str, float]:
    """Root mean square error of a table's transitions on the complete states of a library.

    Returns:
        ``position_m``, ``heading_rad`` at the period's end, and ``velocity_mps``, ``omega_rad_s`` there.
    """
    whole = unseen.whole_states()
    found = looked_up(tables, unseen.initial_velocity_body[whole], unseen.previous_actions[whole])
    return rms_gap(found - unseen.rows()[whole])


def rms_gap(gap: Float64) -> dict[str, float]:
    """Root mean square of differences (n, a, 6), by quantity."""
    turn = wrap_angle(gap[..., 2])

    def rms(*columns: Float64) -> float:
        return float(np.sqrt(np.mean(np.sum(np.square(columns), axis=0))))

    return {
        "position_m": rms(gap[..., 0], gap[..., 1]),
        "heading_rad": rms(turn),
        "velocity_mps": rms(gap[..., 3], gap[..., 4]),
        "omega_rad_s": rms(gap[..., 5]),
    }


def looked_up(tables: Tables, velocities: Float64, previous: Int64) -> Float64:
    """Transitions that the robot's planner looks up in a table.

    Args:
        tables: the table.
        velocities: (n, 3) forward, left (m/s), turn rate (rad/s), body frame.
        previous: (n, s) earlier actions, newest first, then RESTED.

    Returns:
        (n, a, 6) displacements (m, m, rad) and velocities at the end, SI units.
    """
    found = np.empty((len(velocities), len(tables.actions), 6))
    _look_up_many(arrays_of(tables), velocities.astype(np.float32), previous, found)
    return found


def _compiled(stamp: int) -> Any:
    @kept()
    def look_up_many(table, velocities, previous, found):  # type: ignore[no-untyped-def]
        one = np.float32(1)
        now, after = np.zeros(DYNAMICS, dtype=np.int64), np.zeros(DYNAMICS, dtype=np.int64)
        motion = np.zeros(3, dtype=np.float32)
        for k in range(len(velocities)):
            now[:] = 0
            for place in range(previous.shape[1] - 1, -1, -1):
                if previous[k, place] >= 0:  # a limb's use does not depend on the row
                    dynamics_after(table, np.int64(0), now, np.int64(previous[k, place]), after)
                    now[3:] = after[3:]
            for axis in range(3):
                now[axis] = velocity_code(velocities[k, axis], one / table.velocity_scale[axis])
            row = find_row(table, now)
            for action in range(found.shape[1]):
                motion_of(table, row, now, action, motion)
                dynamics_after(table, row, now, action, after)
                for axis in range(3):
                    found[k, action, axis] = motion[axis]
                    found[k, action, 3 + axis] = np.float32(after[axis]) * table.velocity_scale[axis]
        return stamp

    return look_up_many


_look_up_many = _compiled(stamp_of("frogkick.planner"))
