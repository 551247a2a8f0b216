"""Libraries whose transitions are known functions of velocity and limb use: nothing is simulated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frogkick.library import Library
from frogkick.library.store import library_of
from frogkick.library.surface import History, limb_use
from frogkick.library.transitions import HISTORY, RESTED, Transitions
from frogkick.robot import load_robot

ROBOT = load_robot("frog2022")
ACTIONS, LIMBS = len(ROBOT.actions), len(ROBOT.limbs)
FloatArray = NDArray[np.float64]

REACH = np.array([0.04, 0.03, 0.5])  # of velocities
SIZE = np.array([0.04, 0.02, 0.3, 0.03, 0.02, 0.3])  # of what happens from them


class Known:
    """A system linear (1) or quadratic (2) in velocity, or with waves in it (3); limb use may add to it."""

    def __init__(self, seed: int, degree: int, history: History | None = None) -> None:
        rng = np.random.default_rng(seed)
        self.constant = rng.uniform(-0.3, 0.3, (ACTIONS, 6)) * SIZE
        self.slope = rng.uniform(-0.3, 0.3, (ACTIONS, 6, 3)) * SIZE[:, None] / REACH
        self.bend = rng.uniform(-0.1, 0.1, (ACTIONS, 6, 3, 3)) * (degree > 1)
        self.bend *= SIZE[:, None, None] / np.outer(REACH, REACH)
        self.wave = rng.uniform(-0.05, 0.05, (ACTIONS, 6, 3)) * SIZE[:, None] * (degree > 2)
        self.history = history

    def rows(self, velocities: FloatArray, previous: NDArray[np.int64]) -> FloatArray:
        """(n, a, 6) what happens."""
        reported = self.constant + np.einsum("avx,nx->nav", self.slope, velocities)
        reported = reported + np.einsum("avxy,nx,ny->nav", self.bend, velocities, velocities)
        reported = reported + np.einsum("avx,nx->nav", self.wave, np.sin(3.0 * velocities / REACH))
        if self.history is not None:
            use = limb_use(ROBOT, previous, self.history.decay, self.history.gain)
            reported = reported + np.einsum("nl,alv->nav", use, self.history.effect)
        return np.asarray(reported)

    def library(self, states: int, seed: int) -> Library:
        """A library of it; with random earlier actions where limb use has an effect."""
        rng = np.random.default_rng(seed)
        velocities = rng.uniform(-1.0, 1.0, (states, 3)) * REACH
        previous = np.full((states, HISTORY), RESTED)
        if self.history is not None:
            previous = rng.integers(0, ACTIONS, (states, HISTORY))
        rows = self.rows(velocities, previous)
        recorded = np.empty((*rows.shape[:2], 0, 6), dtype=np.float32)
        return library_of(ROBOT, "box", seed, Transitions(velocities, previous, rows, recorded, ()))
