"""The compiled functions of the rods that Python calls, cached on disk.

Only these outermost functions are cached: see frogkick.core.compiled.
"""

from __future__ import annotations

from typing import Any

from frogkick.core.compiled import BARE, cached_njit, stamp_of
from frogkick.der import body, stepping


def _compiled(stamp: int) -> tuple[Any, Any, Any]:
    @cached_njit(**BARE)
    def run_steps(  # type: ignore[no-untyped-def]
        mesh, symbolic, work, nodes, step_s, active, water, factor_every, report, sums
    ):
        return stamp * 0 + stepping.run_steps(
            mesh, symbolic, work, nodes, step_s, active, water, factor_every, report, sums
        )

    @cached_njit(**BARE)
    def set_accelerations(mesh, work, nodes, active, water):  # type: ignore[no-untyped-def]
        stepping.set_accelerations(mesh, work, nodes, active, water)
        return stamp

    @cached_njit(**BARE)
    def set_sums(mesh, x_m, v_mps, row, sums):  # type: ignore[no-untyped-def]
        body.set_sums(mesh, x_m, v_mps, row, sums)
        return stamp

    return run_steps, set_accelerations, set_sums


run_steps, set_accelerations, set_sums = _compiled(stamp_of("frogkick.der"))
