"""Tables of some pages for the robot: a small one, smoothed, at other states than its own."""

from __future__ import annotations

import numpy as np

from frogkick.tables.image import Tables
from frogkick.tables.packing import pack_nearest
from frogkick.tables.sealing import Metadata

_BESIDE = 0.3  # of the states' spread in each velocity
_OFF = 0.02  # part of each motion


def spread_table(tables: Tables, seed: int, states: int = 300) -> bytes:
    """The image of such a table, of kind nearest; at other states for each seed.

    What an action does is taken as linear in the velocity, fitted to all states of the small table: the few
    that it has are too far apart for a planner to rely on each by itself. And a little off everywhere.
    """
    dice = np.random.default_rng(seed)
    scale, unit = tables.velocity_scale.astype(np.float64), tables.motion_scale.astype(np.float64)
    known = tables.states * scale
    moves = tables.transitions * np.concatenate([unit, scale])
    fitted = np.linalg.lstsq(_terms(known), moves.reshape(len(known), -1), rcond=None)[0]
    begin = known[dice.integers(len(known), size=states)]
    begin = begin + _BESIDE * known.std(axis=0) * dice.standard_normal(begin.shape)
    begin = np.clip(begin, known.min(axis=0), known.max(axis=0))
    made = (_terms(begin) @ fitted).reshape(states, *moves.shape[1:])
    made *= dice.uniform(1.0 - _OFF, 1.0 + _OFF, made.shape)
    about = Metadata(
        tables.robot_id,
        tables.provenance,
        tables.period_us,
        tables.pulse_us,
        tables.second_delay_us,
        tables.limbs,
        [(row.name, row.first_mask, row.second_mask) for row in tables.actions],
        [float(each) for each in scale],
    )
    return pack_nearest(about, begin, made[..., :3], made[..., 3:])


def _terms(velocity: np.ndarray) -> np.ndarray:
    return np.column_stack([np.ones(len(velocity)), velocity])
