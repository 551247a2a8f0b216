"""The real-time guard: it keeps the program from delaying a run with a real robot."""

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
"""Longest time that a computing thread keeps others waiting; Python's 5 ms are a quarter of a fix period."""


@contextmanager
def real_time_guard() -> Iterator[None]:
    """Switch threads sooner, and exclude existing objects from garbage collection.

    A full collection visits all objects of numba, OpenCV and other packages, which takes 0.1 s and more.
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
    """Compile the twin's kernels by a short artificial run, so that no fix waits for them.

    The run has fixes before and after a decision, a stroke, and another decision. Without it the first fix
    after a stroke takes a second of compiling.
    """
    twin = DecisionTwin(tables, path, config)
    pose = np.array([path.x_m[0], path.y_m[0], path.tangent_rad[0]], dtype=np.float32)
    for sequence in range(12):
        twin.add_fix(200_000 * sequence, pose, sequence)
        if sequence in (3, 10):
            twin.act(200_000 * sequence + 50_000, twin.decide(200_000 * sequence + 50_000).action)
