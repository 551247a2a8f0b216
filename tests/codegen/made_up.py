"""Made-up tables of both kinds, as files for a firmware."""

from __future__ import annotations

import numpy as np
from tests.planner import synthetic

from frogkick.tables.packing import pack_affine

KINDS = ("nearest", "affine")


ROBOT_SIZE = 0.43
"""Times the made-up motions: as far as the real robot swims in a period."""


def paper_size_image() -> bytes:
    """Return a table of as many states as the paper's, whose motions are as long as the robot's."""
    velocity, motion, end = synthetic.transitions(8503, 9, 1)
    return synthetic.pack(velocity, ROBOT_SIZE * motion, end)


def affine_image(
    states: int = 80,
    actions: int = 9,
    seed: int = 1,
    limbs: int = 4,
    size_of_motion: float = 1.0,
    **changes: object,
) -> bytes:
    """Return the image of a table with corrections and a history that matter."""
    rng = np.random.default_rng(seed)
    velocity, motion, end = synthetic.transitions(states, actions, seed)
    motion = size_of_motion * motion
    base = np.concatenate([motion, end], axis=2)
    size = np.abs(base).max(axis=(0, 1))
    jacobian = rng.normal(0.0, 0.5 * size_of_motion, (states, actions, 6, 3)) * (
        size[:, None] / synthetic.HIGH
    )
    rows = [(chr(ord("A") + i), i % (1 << limbs), (3 * i) % (1 << limbs)) for i in range(actions)]
    parts: dict[str, object] = {
        "velocities": velocity,
        "base": base,
        "jacobian": jacobian,
        "history": rng.normal(0.0, 0.1, (actions, limbs, 6)) * size,
        "use_decay": 0.35,
        "use_gain": 0.4,
    }
    return pack_affine(
        synthetic.metadata(actions, {"limbs": limbs, "action_rows": rows}), **(parts | changes)
    )


def image(kind: str, **changes: object) -> bytes:
    """Return a made-up table of a kind; ``changes`` replace arguments of how it is packed."""
    if kind == "affine":
        return affine_image(**changes)  # type: ignore[arg-type]
    return synthetic.pack(*synthetic.transitions(300, 9, 1), **changes)
