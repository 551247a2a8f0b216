"""Whether a new table is better: in its predictions of held-out periods, and in closed loop."""

from __future__ import annotations

import math

import numpy as np

from frogkick.core.poses import PredictionError
from frogkick.front.retune_tables import Tracked

BETTER = 0.98
"""The error of the new table must be at most this share of the old one's, in position or in heading."""

HELD_OUT_MIN = 5  # minimum number of held-out periods with a measured end

WORSE, WORSE_FROM_M = 1.05, 1e-3
"""A table is worse in closed loop if the distances from the paths are larger by this factor, in the geometric
mean over the runs, and by more than their standard error. Differences far below the length do not count."""


def by_noise(noise_floor: PredictionError, periods: int) -> tuple[float, float]:
    """By how much the errors of position (m) and heading (rad) over some periods differ by chance.

    It is the standard error of a root mean square of the noise floor, which the noise of the fixes causes.
    """
    position_m, heading_rad = (floor / math.sqrt(2.0 * max(periods, 1)) for floor in noise_floor.pair)
    return position_m, heading_rad


def is_better(
    before: PredictionError, after: PredictionError, noise_floor: PredictionError | None = None
) -> bool:
    """Whether neither position nor heading error is larger, and one of them is clearly smaller.

    An error that is larger by no more than ``by_noise`` counts as equal.
    """
    by_chance = (0.0, 0.0) if noise_floor is None else np.nan_to_num(by_noise(noise_floor, after.count))
    pairs = list(zip(before.pair, after.pair, strict=True))
    return (
        after.count >= HELD_OUT_MIN
        and all(now <= then + chance for (then, now), chance in zip(pairs, by_chance, strict=True))
        and any(now < BETTER * then for then, now in pairs)
    )


def worse_in_loop(before: Tracked, after: Tracked) -> str:
    """Why a table is worse than the one before it on the same paths, with the same noise; "" if it is not."""
    if after.completed != before.completed:
        fewer = f"{after.completed} of {after.runs} runs completed, {before.completed} with the old one"
        return fewer if after.completed < before.completed else ""
    grown = np.log(
        [
            (now.mean_distance_m + WORSE_FROM_M) / (then.mean_distance_m + WORSE_FROM_M)
            for then, now in zip(before.each, after.each, strict=True)
        ]
    )
    if not len(grown):
        return ""
    chance = float(grown.std(ddof=1)) / math.sqrt(len(grown)) if len(grown) > 1 else 0.0
    if float(grown.mean()) <= max(math.log(WORSE), chance):
        return ""
    return (
        f"{1e3 * after.mean_distance_m:.1f} mm from the paths, {1e3 * before.mean_distance_m:.1f} mm with "
        "the old one"
    )


def no_better(
    before: PredictionError, after: PredictionError, noise_floor: PredictionError, worse_in_loop: str
) -> str:
    """Why a new table is no better; "" if it is."""
    if is_better(before, after, noise_floor):
        return worse_in_loop and (
            f"the new table predicts better, but follows paths worse in a simulated pool with the identified "
            f"effects ({worse_in_loop}): the robot keeps its old table"
        )
    if after.count < HELD_OUT_MIN:
        return f"the tables could be compared on {after.count} held-out periods: {HELD_OUT_MIN} are needed"
    chance = np.nan_to_num(by_noise(noise_floor, after.count))
    grown = [
        f"the {name} error grew by {scale * (now - then):.2g} {unit}, of which {scale * by:.2g} may be chance"
        for name, then, now, by, scale, unit in zip(
            ("position", "heading"), before.pair, after.pair, chance, (1e3, math.degrees(1.0)),
            ("mm", "degrees"), strict=True,
        )
        if now > then + by
    ]  # fmt: skip
    why = "; ".join(grown) or f"neither error fell by {100.0 * (1.0 - BETTER):.0f} %"
    return (
        f"the new table is no better on held-out periods ({before} with the old one, {after} with the new "
        f"one; {why}): the robot keeps its old table"
    )
