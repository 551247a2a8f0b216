"""The C look-up on this machine, without the search: for parity of tables alone, and quickly built."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from frogkick.core.arrays import AnyArray, Float32, Int32, Int64
from frogkick.core.shared_library import load
from frogkick.tables.image import TableError, Tables
from frogkick.tables.layout import LIMBS_MAX
from frogkick_codegen.native import build_shared, native_entries, planner_files
from frogkick_codegen.toolchain import FLAGS, Compiler


def native_tables_files() -> dict[str, bytes]:
    """``native_tables.c``, and the header that it needs."""
    entries = Path(__file__).with_name("native_tables.c")
    return {entries.name: entries.read_bytes()} | native_entries("native_inputs.h")


TABLE_SOURCES = ("lookup.c", "math.c", "nearest.c", "tables.c", "tables_check.c", "wear.c")


class LookedUp(NamedTuple):
    """What a table says of k states: rows (k,), motions (k, a, 3) float32, dynamics (k, a, 3 + LIMBS_MAX)."""

    rows: Int64
    motions: Float32
    dynamics: Int64


class NativeTables:
    """The table's C as this machine's code."""

    def __init__(
        self,
        files: Mapping[str, bytes] | None = None,
        compiler: Compiler | None = None,
        flags: Sequence[str] = FLAGS,
        library: Path | None = None,
    ) -> None:
        """Build (or find) the library and load it; arguments and errors as for ``build_shared``.

        Args:
            files: planner files; the package's own where it is None.
            library: one that is built already, with these entries; nothing else is looked at then.
        """
        self._ffi, self._library = load(library or self._built(files, compiler, flags))

    @staticmethod
    def _built(files: Mapping[str, bytes] | None, compiler: Compiler | None, flags: Sequence[str]) -> Path:
        given = planner_files() if files is None else files
        every = {
            name: content
            for name, content in given.items()
            if name.endswith(".h") or name in TABLE_SOURCES or name not in planner_files()
        }
        every |= native_tables_files()
        return build_shared("fk_tables", every, compiler, flags)

    def open_status(self, image: bytes) -> int:
        """Return what ``fk_tables_open`` says of an image: 0 or a negative fk_error_t."""
        return int(self._library.fk_native_nearest(*self._image(image), self._ffi.NULL, 0, self._ffi.NULL))

    def bounds(self, image: bytes) -> tuple[np.float32, np.float32]:
        """Return stroke_max_m and turn_max_rad of a table."""
        found = np.zeros(2, dtype=np.float32)
        self._check(self._library.fk_native_bounds(*self._image(image), self._into("float[]", found)))
        return found[0], found[1]

    def robot_status(self, image: bytes, robot_id: bytes) -> int:
        """Return what ``fk_tables_check_robot`` says of a robot's id, or why the image does not open."""
        return int(self._library.fk_native_robot(*self._image(image), robot_id))

    def action(self, image: bytes, index: int) -> tuple[str, int, int]:
        """Return an action's name and masks as ``fk_tables_action`` reads them."""
        row = np.zeros(3, dtype=np.uint8)
        self._check(self._library.fk_native_action(*self._image(image), index, self._into("uint8_t[]", row)))
        return chr(row[0]), int(row[1]), int(row[2])

    def null_statuses(self, image: bytes) -> list[int]:
        """Return what the functions of a table say where one of their pointers is null."""
        statuses = np.zeros(6, dtype=np.int32)
        self._check(self._library.fk_native_nulls(*self._image(image), self._into("int32_t[]", statuses)))
        return [int(status) for status in statuses]

    def velocity_codes(self, velocities: npt.ArrayLike, codes_per_velocity: np.float32) -> Int32:
        """Return ``fk_velocity_code`` of each velocity."""
        given = np.ascontiguousarray(velocities, dtype=np.float32)
        codes = np.zeros(len(given), dtype=np.int32)
        self._library.fk_native_codes(
            self._ffi.from_buffer("float[]", given),
            len(given),
            float(codes_per_velocity),
            self._into("int32_t[]", codes),
        )
        return codes

    def nearest(self, image: bytes, codes: npt.ArrayLike) -> Int64:
        """Return the row of each of (k, 3) velocity codes."""
        asked = np.ascontiguousarray(codes, dtype=np.int32)
        rows = np.zeros(len(asked), dtype=np.uint32)
        self._check(
            self._library.fk_native_nearest(
                *self._image(image),
                self._ffi.from_buffer("int32_t[]", asked),
                len(asked),
                self._into("uint32_t[]", rows),
            )
        )
        return rows.astype(np.int64)

    def look_up(self, tables: Tables, codes: npt.ArrayLike, limb_use: npt.ArrayLike) -> LookedUp:
        """Look up (k, 3) velocity codes with (k, LIMBS_MAX) limb uses, every action, worn as ``tables``."""
        asked = np.ascontiguousarray(codes, dtype=np.int32)
        used = np.ascontiguousarray(limb_use, dtype=np.uint16)
        shape = (len(asked), len(tables.actions))
        rows = np.zeros(len(asked), dtype=np.uint32)
        motions = np.zeros((*shape, 3), dtype=np.float32)
        after = np.zeros((*shape, 3), dtype=np.int32)
        use_after = np.zeros((*shape, LIMBS_MAX), dtype=np.uint16)
        self._check(
            self._library.fk_native_lookup(
                *self._image(tables.image),
                self._ffi.from_buffer("int32_t[]", asked),
                self._ffi.from_buffer("uint16_t[]", used),
                self._ffi.new("uint16_t[]", tables.lost.tolist() + [0] * (LIMBS_MAX - tables.limbs)),
                len(asked),
                self._into("uint32_t[]", rows),
                self._into("float[]", motions),
                self._into("int32_t[]", after),
                self._into("uint16_t[]", use_after),
            )
        )
        dynamics = np.concatenate([after, use_after], axis=2).astype(np.int64)
        return LookedUp(rows.astype(np.int64), motions, dynamics)

    def _image(self, image: bytes) -> tuple[Any, int]:
        return self._ffi.from_buffer("uint8_t[]", image), len(image)

    def _into(self, kind: str, array: AnyArray) -> Any:
        return self._ffi.from_buffer(kind, array, require_writable=True)

    def _check(self, status: int) -> None:
        if status != 0:
            raise TableError(f"the C refuses the table image (fk_error_t {status}): make it again")
