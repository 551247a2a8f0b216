"""The C planner as its headers declare it, pointer by pointer; with gcov's counters where they are wanted."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tests.codegen.native_tables import NativeTables, native_tables_files

from frogkick.core.shared_library import ffi_of, load
from frogkick.core.weights import WEIGHTS
from frogkick.planner.plan import PathLike, PlanConfig
from frogkick_codegen import declared
from frogkick_codegen.native import build_shared, planner_files
from frogkick_codegen.toolchain import FLAGS, other

COVERAGE_DIR = os.environ.get("FK_PLANNER_COVERAGE_DIR")
"""Set by test_planner_coverage for its own runs: build with gcov's counters, into that folder."""


def source_files() -> dict[str, bytes]:
    """Every file of the library by name: planner, the host's flat entries, the shim."""
    shim = Path(__file__).parent / "planner_shim.c"
    return planner_files() | native_tables_files() | {"planner_shim.c": shim.read_bytes()}


FFI = ffi_of(tuple(declared.declarations(source_files())))


@cache
def library_file() -> Path:
    """The library, built."""
    files = source_files()
    if not COVERAGE_DIR:
        return build_shared("fk_planner_c", files)
    folder, gcc = Path(COVERAGE_DIR), other("gcc")
    assert gcc is not None, "test_planner_coverage looks for gcc before it sets FK_PLANNER_COVERAGE_DIR"
    files[declared.SOURCE] = declared.source(files)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    flags = [flag for flag in FLAGS if flag != "-O2"] + ["-O0", "--coverage", "-fPIC", "-shared"]
    gcc.run([*flags, "-o", "planner.so", *sorted(name for name in files if name.endswith(".c"))], folder)
    return folder / "planner.so"


@cache
def library() -> Any:
    """The library, loaded."""
    return load(library_file())[1]


def native_tables() -> NativeTables:
    """The host's binding of the table's C; from the library that counts, where that is wanted."""
    return NativeTables(library=library_file()) if COVERAGE_DIR else NativeTables()


@dataclass(frozen=True)
class Opened:
    """An open table: its ``fk_tables_t``, and the image that it points into."""

    pointer: Any
    image: Any


def opened(image: bytes) -> Opened:
    """Open an image that must be right."""
    kept, tables = FFI.new("uint8_t[]", image), FFI.new("fk_tables_t *")
    status = library().fk_tables_open(kept, len(image), tables)
    assert status == 0, status
    return Opened(tables, kept)


def path_of(path: PathLike | Sequence[Sequence[float]]) -> Any:
    """An ``fk_path_t`` from a path, or from (x, y, tangent) of each point."""
    if isinstance(path, Sequence):
        points = [tuple(point) for point in path]
    else:
        points = list(zip(path.x_m.tolist(), path.y_m.tolist(), path.tangent_rad.tolist(), strict=True))
    route = FFI.new("fk_path_t *")
    route.count = len(points)
    for index, (x_m, y_m, tangent_rad) in enumerate(points[:100]):
        route.x_m[index], route.y_m[index], route.tangent_rad[index] = x_m, y_m, tangent_rad
    return route


def config_of(config: PlanConfig | None = None, **changes: float) -> Any:
    """An ``fk_plan_config_t`` with some fields changed."""
    given = config or PlanConfig()
    made = FFI.new("fk_plan_config_t *")
    for name in (*WEIGHTS, "transitions_max", "cost", "depth"):
        setattr(made, name, changes.get(name, getattr(given, name)))
    return made


def state_of(limb_use: Mapping[int, int] | None = None, **values: float) -> Any:
    """An ``fk_state_t``: all zero but what is given."""
    state = FFI.new("fk_state_t *")
    for name, value in values.items():
        setattr(state, name, value)
    for limb, used in (limb_use or {}).items():
        state.limb_use[limb] = used
    return state


def plan(tables: Opened, path: Any, config: Any, state: Any) -> tuple[int, Any]:
    """Status and ``fk_plan_t`` of a plan, which is 0xA5 throughout before."""
    made = FFI.new("fk_plan_t *")
    FFI.buffer(made)[:] = b"\xa5" * FFI.sizeof("fk_plan_t")
    return library().fk_plan(tables.pointer, path, config, state, made), made


def codes() -> dict[str, int]:
    """Each error code by its name without ``FK_ERROR_``."""
    found = FFI.typeof("fk_error_t").relements
    return {name.removeprefix("FK_ERROR_"): int(value) for name, value in found.items()}
