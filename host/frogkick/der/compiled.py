"""The rods' compiled functions as Python calls them, kept on disk between runs.

numba drops what it kept when the function's own file or closure changes, but not when a file that it calls
into does. So only these outermost functions are kept, and each encloses a stamp of all of this folder's text.
"""

from __future__ import annotations

import hashlib
from importlib import resources
from typing import Any

from numba import njit

from frogkick.der import body, stepping


def _stamp() -> int:
    digest = hashlib.sha256()
    for file in sorted(resources.files(__package__).iterdir(), key=lambda f: f.name):
        if file.name.endswith(".py"):
            digest.update(file.read_bytes())
    return int.from_bytes(digest.digest()[:4], "little")


def _compiled(stamp: int) -> tuple[Any, Any, Any]:
    @njit(cache=True, error_model="numpy")
    def run_steps(  # type: ignore[no-untyped-def]
        mesh, plan, space, x_m, v_mps, a_mps2, step_s, active, factor_every, report, sums
    ):
        return stamp * 0 + stepping.run_steps(
            mesh, plan, space, x_m, v_mps, a_mps2, step_s, active, factor_every, report, sums
        )

    @njit(cache=True, error_model="numpy")
    def set_accelerations(mesh, edges, x_m, v_mps, active, a_mps2):  # type: ignore[no-untyped-def]
        stepping.set_accelerations(mesh, edges, x_m, v_mps, active, a_mps2)
        return stamp

    @njit(cache=True, error_model="numpy")
    def set_sums(mesh, x_m, v_mps, row, sums):  # type: ignore[no-untyped-def]
        body.set_sums(mesh, x_m, v_mps, row, sums)
        return stamp

    return run_steps, set_accelerations, set_sums


SOURCES = _stamp()
"""Stands for what the rods compute: other code, another number."""

run_steps, set_accelerations, set_sums = _compiled(SOURCES)
