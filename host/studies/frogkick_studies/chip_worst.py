"""The dearest of very many decisions on the chip, without running them all there.

A decision's cycles are, block by block of the planner's code, how often the block runs times what it takes;
what the instruction cache happens to hold adds a little. How often is counted for every state, by the same C
built for this machine. What a block takes is fitted to states that the virtual chip has run, and the fit's
error is measured on others that it has run. The states that cost most by this model then go to the virtual
chip, so every time that is told was counted there: the model chooses, and bounds what was not run.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from frogkick.planner.plan import PathLike, PlanConfig
from frogkick.runs.chip_planner import TimedStates
from frogkick_codegen.native_blocks import BlockCounter

Float64 = npt.NDArray[np.float64]
_RIDGE = 1e-3
"""Of a block's largest part of a decision: many blocks always run together, and share what they take."""
_BATCH = 2000


@dataclass(frozen=True, eq=False)
class CycleModel:
    """Cycles of a decision from the blocks that it runs; ``cycles_per_block``: (blocks,) float64."""

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
    runs: list[tuple[PathLike, TimedStates, npt.NDArray[np.int64]]],
    depth: int,
) -> CycleModel:
    """Fit what each block takes.

    Args:
        image: the table's.
        config: of the planner; its depth is not used.
        runs: path, states and the (k,) cycles that the chip took.
        depth: of all runs.

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


def dearest(predicted: Float64, beyond: npt.NDArray[np.float32], number: int) -> npt.NDArray[np.int64]:
    """Return the places of about ``number`` states: the dearest of all, and the dearest of each reach."""
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
