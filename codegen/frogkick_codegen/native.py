"""The C planner on this machine: a shared library, built once for its content, bound without its headers.

``BlockCounter`` counts how often each basic block runs for a decision.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from frogkick.core.arrays import AnyArray, Float32, UInt16
from frogkick.core.files import cache_folder, one_at_a_time
from frogkick.core.shared_library import load
from frogkick.planner.kernel import PLAN_ROW
from frogkick.planner.plan import PathLike, PlanConfig, path_rows, query_rows
from frogkick.tables.image import TableError
from frogkick_codegen import declared
from frogkick_codegen.toolchain import FLAGS, FLOAT_RULES, WARNINGS, Compiler, ToolchainError, zig

PLANNER_HEADERS = ("fk_planner.h", "fk_tables.h", "fk_internal.h", "fk_route.h", "fk_search.h", "fk_trig.h")
PLANNER_SOURCES = (
    "cost.c", "lookup.c", "math.c", "nearest.c", "path.c", "plan.c", "route.c", "search_beam.c", "tables.c",
    "tables_check.c", "tree.c", "wear.c",
)  # fmt: skip


def planner_files() -> dict[str, bytes]:
    """Return the C planner's own files by name."""
    folder = resources.files("frogkick_codegen") / "planner"
    return {name: (folder / name).read_bytes() for name in (*PLANNER_HEADERS, *PLANNER_SOURCES)}


def build_shared(
    name: str, files: Mapping[str, bytes], compiler: Compiler | None = None, flags: Sequence[str] = FLAGS
) -> Path:
    """Build C files into a shared library, once for the same content, flags and compiler.

    Builds of files with the same names wait for each other in one folder, where zig compiles only what has
    changed: a core with one other file takes a twelfth of the time. A whole library is renamed into place, so
    that no process loads half of one.

    Args:
        name: stem of the library's file name.
        files: file name -> content; the ``.c`` are compiled, all stand in one folder.
        compiler: for this machine; zig where it is None.
        flags: compiler flags.

    Returns:
        The library, in the user's cache folder; it carries its declarations (``core.shared_library.load``).
    """
    driver = zig() if compiler is None else compiler
    suffix = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
    digest = hashlib.sha256(Path(declared.__file__).read_bytes())
    for text in (driver.version, *driver.target_flags, *flags, sys.platform, platform.machine()):
        digest.update(text.encode() + b"\0")
    for file in sorted(files):
        digest.update(file.encode() + b"\0" + len(files[file]).to_bytes(8, "little") + files[file])
    folder = cache_folder("native")
    library = folder / f"{name}-{digest.hexdigest()[:32]}{suffix}"
    if library.exists():
        return library
    try:
        every = {**files, declared.SOURCE: declared.source(files)}
        texts = chr(0).join([driver.name, *driver.target_flags, *flags, *sorted(every)])
        with one_at_a_time(folder, f"build-{hashlib.sha256(texts.encode()).hexdigest()[:16]}") as work:
            if library.exists():  # whoever was waited for has built it
                return library
            for file, content in every.items():
                here = work / file
                if not here.exists() or here.read_bytes() != content:
                    here.write_bytes(content)
            sources = sorted(file for file in every if file.endswith(".c"))
            pic = () if sys.platform == "win32" else ("-fPIC",)
            driver.run([*flags, *pic, "-shared", "-o", library.name, *sources], folder=work)
            os.replace(work / library.name, library)
    except OSError as error:
        raise ToolchainError(
            f"cannot build in {str(folder)!r} ({error.strerror}): set FROGKICK_CACHE_DIR to a writable folder"
        ) from error
    return library


def native_entries(name: str) -> dict[str, bytes]:
    folder = resources.files("frogkick_codegen") / "templates"
    return {each: (folder / each).read_bytes() for each in (name, "native_inputs.h")}


def _problem(ffi: Any, image: bytes, path: PathLike, config: PlanConfig) -> tuple[Any, ...]:
    """What both libraries take first: table, path, configuration."""
    points = path_rows(path)
    return (
        *(ffi.from_buffer("uint8_t[]", image), len(image)),
        *(ffi.from_buffer("float[]", points), points.shape[1]),
        *(ffi.from_buffer("float[]", config.weights()), config.cost, config.transitions_max),
    )


class NativeLibrary:
    """The C planner as this machine's code."""

    def __init__(
        self,
        files: Mapping[str, bytes] | None = None,
        compiler: Compiler | None = None,
        flags: Sequence[str] = FLAGS,
    ) -> None:
        """Build (or find) the library and load it. ``files``: the planner's; None: the package's own."""
        every = dict(planner_files() if files is None else files)
        every |= native_entries("native_batch.c")
        path = build_shared("fk_planner", every, compiler, flags)
        try:
            self._ffi, self._library = load(path)
        except OSError as error:
            raise ToolchainError(f"built library {path.name!r} does not load ({error}): remove it") from error
        row = {name: field.offset for name, field in self._ffi.typeof("fk_native_row_t").fields}
        if row != {name: field[1] for name, field in (PLAN_ROW.fields or {}).items()}:
            raise ToolchainError(f"native rows have their fields at {row}, the host at others: update both")

    def open_status(self, image: bytes) -> int:
        """Return what ``fk_tables_open`` says of an image: 0 or a negative fk_error_t."""
        return int(self._library.fk_native_open(self._ffi.from_buffer("uint8_t[]", image), len(image)))

    def plan_batch(
        self,
        image: bytes,
        path: PathLike,
        config: PlanConfig,
        states: npt.ArrayLike,
        depths: npt.ArrayLike | None = None,
        limb_use: npt.ArrayLike | None = None,
        along_points: npt.ArrayLike = 0.0,
        lost: npt.ArrayLike | None = None,
    ) -> AnyArray:
        """Plan from many states, as ``frogkick.planner.plan.plan_batch`` does, in C.

        Args:
            image: a whole table image; TableError, with its fk_error_t, where the C refuses it.
            path, config, states, depths, limb_use, along_points: as there.
            lost: (8,) share that each limb has lost, 0 to 32767; None: none.
        """
        levels, queries, used, along = query_rows(config, states, depths, limb_use, along_points)
        rows = np.zeros(len(queries), dtype=PLAN_ROW)
        status = self._library.fk_native_plan_batch(
            *_problem(self._ffi, image, path, config),
            self._floats(queries),
            self._ffi.from_buffer("uint16_t[]", used),
            self._floats(along),
            self._ffi.from_buffer("int32_t[]", levels.astype(np.int32)),
            self._ffi.NULL if lost is None else self._ffi.new("uint16_t[8]", np.asarray(lost).tolist()),
            len(queries),
            self._ffi.cast("void *", rows.ctypes.data),
        )
        if status != 0:
            raise TableError(f"the C planner refuses the table image (fk_error_t {status}): make it again")
        return rows

    def sincos(self, angles_rad: npt.ArrayLike) -> tuple[Float32, Float32]:
        """Return ``fk_sincos`` of each angle: (sines, cosines), float32."""
        angles = np.ascontiguousarray(angles_rad, dtype=np.float32)
        sines, cosines = np.empty_like(angles), np.empty_like(angles)
        outputs = (self._floats(sines, write=True), self._floats(cosines, write=True))
        self._library.fk_native_sincos(self._floats(angles), angles.size, *outputs)
        return sines, cosines

    def wrap_angle(self, angles_rad: npt.ArrayLike) -> Float32:
        """Return ``fk_wrap_angle`` of each angle, float32."""
        angles = np.ascontiguousarray(angles_rad, dtype=np.float32)
        wrapped = np.empty_like(angles)
        self._library.fk_native_wrap(self._floats(angles), angles.size, self._floats(wrapped, write=True))
        return wrapped

    def crc32(self, content: bytes, start: int = 0) -> int:
        """Return ``fk_crc32`` of some bytes."""
        return int(
            self._library.fk_native_crc32(start, self._ffi.from_buffer("uint8_t[]", content), len(content))
        )

    def _floats(self, array: Float32, write: bool = False) -> Any:
        return self._ffi.from_buffer("float[]", array, require_writable=write)


_FLAGS = ("-std=c99", "-O1", "-fno-vectorize", "-fno-unroll-loops", *WARNINGS, *FLOAT_RULES)
_COUNTED = "-fsanitize-coverage=trace-pc-guard"
"""clang's flag that counts basic blocks; zig's compiler has it. Its calls go to native_blocks.c."""


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
        """Count how often each block runs for each state: (k, blocks). TableError where the C refuses one.

        The arguments are those of ``plan_batch``; the depth is the configuration's.
        """
        ffi = self._ffi
        blocks = np.zeros((len(states), self._library.fk_native_blocks()), dtype=np.uint32)
        statuses = np.zeros(len(states), dtype=np.int32)
        status = self._library.fk_native_blocks_plan(
            *_problem(ffi, image, path, config),
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
