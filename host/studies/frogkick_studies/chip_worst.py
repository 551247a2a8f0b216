"""The most expensive of very many decisions on the chip, without running them all there.

The cycles of a decision are, over the blocks of the planner's code, the executions of a block times its cost;
the content of the instruction cache adds a little. The executions are counted for each state by the same C on
this computer. The costs of the blocks are fitted to states that the virtual chip has run, and the fit's error
is measured on other such states. The most expensive states by this model are then run on the virtual chip, so
every reported time was counted there: the model selects states, and bounds those that were not run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from frogkick.core.arrays import Float32, Float64, Int64
from frogkick.planner.plan import PathLike, PlanConfig
from frogkick.runs.chip_planner import TimedStates
from frogkick_codegen.native import BlockCounter

_RIDGE = 1e-3
"""Ridge of the fit, relative to a block's largest share: many blocks always run together."""
_BATCH = 2000


@dataclass(frozen=True, eq=False)
class CycleModel:
    """Cycles of a decision from its blocks; ``cycles_per_block``: (blocks,) float64."""

    cycles_per_block: Float64

    def predict(self, image: bytes, path: PathLike, config: PlanConfig, timed: TimedStates) -> Float64:
        """Return the cycles of each decision, (k,), at the configuration's depth."""
        counter = BlockCounter()
        parts = [timed.part(at, _BATCH) for at in range(0, len(timed.states), _BATCH)]
        return np.concatenate(
            [_blocks(counter, image, path, config, part) @ self.cycles_per_block for part in parts]
        )


def fit_cycles(
    image: bytes,
    config: PlanConfig,
    runs: Sequence[tuple[PathLike, TimedStates, Int64]],
    depth: int,
) -> CycleModel:
    """Fit the cost of each block.

    Args:
        image: table image.
        config: configuration of the planner; its depth is not used.
        runs: path, states and the (k,) cycles on the chip.
        depth: depth of all runs.

    Returns:
        The model of least relative squares.
    """
    counter, settings = BlockCounter(), dataclasses.replace(config, depth=depth)
    blocks = np.concatenate([_blocks(counter, image, path, settings, timed) for path, timed, _ in runs])
    cycles = np.concatenate([one for _, _, one in runs]).astype(np.float64)
    parts = blocks / cycles[:, np.newaxis]
    size = parts.max(axis=0)
    size[size == 0.0] = 1.0
    parts = parts / size
    matrix = parts.T @ parts + _RIDGE**2 * np.eye(len(size))
    return CycleModel(np.linalg.solve(matrix, parts.sum(axis=0)) / size)


def dearest(predicted: Float64, beyond: Float32, number: int) -> Int64:
    """Return the indices of about ``number`` states: the most expensive of all, and of each reach."""
    kinds = np.unique(beyond)
    order = np.argsort(-predicted, kind="stable")
    each = max(1, number // (2 * len(kinds)))
    found = [order[: number - each * len(kinds)]]
    found += [order[beyond[order] == kind][:each] for kind in kinds]
    return np.unique(np.concatenate(found))


def _blocks(
    counter: BlockCounter, image: bytes, path: PathLike, config: PlanConfig, timed: TimedStates
) -> Float64:
    counted = counter.count(image, path, config, timed.states, timed.limb_use, timed.along_points)
    return counted.astype(np.float64)
