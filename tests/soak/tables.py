"""Tables of some pages for the same robot: each state of a small one some times, a little beside itself."""

from __future__ import annotations

import numpy as np

from frogkick.planner.image import Tables
from frogkick.planner.packing import pack_nearest

_TIMES = 6
_BESIDE = 30  # codes of velocity


def spread_table(tables: Tables, seed: int) -> bytes:
    """The image of such a table, of kind nearest; another one for each seed."""
    dice = np.random.default_rng(seed)
    states = np.repeat(tables.states.astype(np.int64), _TIMES, axis=0)
    states += dice.integers(-_BESIDE, _BESIDE, states.shape, endpoint=True)
    moves = np.repeat(tables.transitions.astype(np.float64), _TIMES, axis=0)
    moves *= dice.uniform(0.99, 1.01, moves.shape)
    return pack_nearest(
        tables.robot_id,
        tables.provenance,
        tables.period_us,
        tables.pulse_us,
        tables.second_delay_us,
        tables.limbs,
        [(row.name, row.first_mask, row.second_mask) for row in tables.actions],
        [float(scale) for scale in tables.velocity_scale],
        states * tables.velocity_scale.astype(np.float64),
        moves[..., :3] * tables.motion_scale.astype(np.float64),
        moves[..., 3:] * tables.velocity_scale.astype(np.float64),
    )
