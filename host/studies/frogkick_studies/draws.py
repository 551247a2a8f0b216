"""Random numbers of planted worlds."""

from __future__ import annotations

from typing import Any

import numpy as np

Table = dict[str, Any]
"""An ``[[effect]]`` table of a world."""

LIMBS = ("front_left", "front_right", "rear_left", "rear_right")


def sign(rng: np.random.Generator) -> float:
    """1 or -1."""
    return float(rng.choice([-1.0, 1.0]))


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform, rounded as it is told."""
    return float(np.round(rng.uniform(low, high), 5))


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """As likely in each factor of two: for strengths."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")
