"""How often each basic block of the C planner runs for a decision, counted on this machine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from frogkick.core.arrays import Float32, UInt16
from frogkick.core.shared_library import load
from frogkick.planner.plan import PathLike, PlanConfig, path_rows
from frogkick.tables.image import TableError
from frogkick_codegen.native import build_shared, native_entries, planner_files
from frogkick_codegen.toolchain import FLOAT_RULES, WARNINGS

_FLAGS = ("-std=c99", "-O1", "-fno-vectorize", "-fno-unroll-loops", *WARNINGS, *FLOAT_RULES)
_COUNTED = "-fsanitize-coverage=trace-pc-guard"
"""The compiler that comes as a wheel knows it; its calls go to native_blocks.c."""


class BlockCounter:
    """The C planner, built to count its blocks."""

    def __init__(self) -> None:
        """Build (or find) the library and load it; errors as for ``build_shared``."""
        files = planner_files() | native_entries("native_blocks.c")
        self._ffi, self._library = load(build_shared("fk_blocks", files, flags=(*_FLAGS, _COUNTED)))

    def count(
        self,
        image: bytes,
        path: PathLike,
        config: PlanConfig,
        states: Float32,
        limb_use: UInt16,
        along_points: Float32,
    ) -> npt.NDArray[np.uint32]:
        """Count the blocks of decisions.

        Args:
            image: a whole table image.
            path, config: as for ``plan_batch``; the depth is the configuration's.
            states, limb_use, along_points: (k, 6), (k, 8), (k,) as there.

        Returns:
            (k, blocks) how often each block ran for each state.

        Raises:
            TableError: the C refuses the image, the path, the configuration or a state.
        """
        ffi, points = self._ffi, path_rows(path)
        blocks = np.zeros((len(states), self._library.fk_native_blocks()), dtype=np.uint32)
        statuses = np.zeros(len(states), dtype=np.int32)
        status = self._library.fk_native_blocks_plan(
            ffi.from_buffer("uint8_t[]", image),
            len(image),
            ffi.from_buffer("float[]", points),
            points.shape[1],
            ffi.from_buffer("float[]", config.weights()),
            config.cost,
            config.transitions_max,
            config.depth,
            ffi.from_buffer("float[]", np.ascontiguousarray(states, dtype=np.float32)),
            ffi.from_buffer("uint16_t[]", np.ascontiguousarray(limb_use, dtype=np.uint16)),
            ffi.from_buffer("float[]", np.ascontiguousarray(along_points, dtype=np.float32)),
            len(states),
            ffi.from_buffer("uint32_t[]", blocks, require_writable=True),
            ffi.from_buffer("int32_t[]", statuses, require_writable=True),
        )
        refused = status or next((int(one) for one in statuses if one), 0)
        if refused:
            raise TableError(f"the C planner refuses what its blocks are counted of (fk_error_t {refused})")
        return blocks
