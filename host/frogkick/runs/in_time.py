"""What keeps a run with a real robot from being held up by its own program."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from frogkick.paths import Path
from frogkick.planner.plan import PlanConfig
from frogkick.runs.decision import DecisionTwin
from frogkick.tables.image import Tables

SWITCH_S = 0.002
"""How long a thread that computes keeps others waiting: Python's 5 ms are a quarter of a fix's time."""


@contextmanager
def in_time() -> Iterator[None]:
    """Threads give way to each other soon, and nothing that is there already is looked through for garbage.

    A full collection goes through all that numba, OpenCV and the rest have made: 0.1 s and more.
    """
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before_s)


def warm_up(tables: Tables, path: Path, config: PlanConfig) -> None:
    """Let the twin live through a little on nothing: no fix shall wait while its kernels are made ready.

    All that a run does: fixes before and after a decision, a stroke, another decision that carries it on. The
    first fix after a stroke cost a second of compiling else.
    """
    twin = DecisionTwin(tables, path, config)
    pose = np.array([path.x_m[0], path.y_m[0], path.tangent_rad[0]], dtype=np.float32)
    for sequence in range(12):
        twin.add_fix(200_000 * sequence, pose, sequence)
        if sequence in (3, 10):
            twin.act(200_000 * sequence + 50_000, twin.decide(200_000 * sequence + 50_000).action)
