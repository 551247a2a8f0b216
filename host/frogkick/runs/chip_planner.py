"""The planner of a bench image on the virtual chip: its decisions and their cycles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from frogkick.core.arrays import AnyArray, Float32, Int32, Int64, UInt16
from frogkick.planner.kernel import PLAN_ROW
from frogkick.planner.plan import PathLike, PlanConfig, path_rows
from frogkick.pool.chip import ChipError, CostModel, VirtualChip
from frogkick.pool.chip.image import Layouts
from frogkick.pool.chip.uncounted import UncountedCalls
from frogkick.tables.image import Tables
from frogkick.tables.layout import ACTIONS_MAX, LIMBS_MAX

CYCLES_PER_MS = 64_000
_BEYOND = (1.0, 3.0, 30.0, 1000.0)
"""Multiples of the table's range for velocities, and of the path's surroundings for poses, in turn."""

_BOOT_STEP_US = 100_000.0
_BOOT_STEPS_MAX = 100
_POSE_MEMBERS = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps", "omega_rad_s")


@dataclass(frozen=True, eq=False)
class TimedStates:
    """States to time."""

    states: Float32  # (k, 6) float32: x, y, heading in the world, velocity in the body
    limb_use: UInt16  # (k, 8) uint16
    along_points: Float32  # (k,) float32: last place along the path, points
    beyond: Float32  # (k,) float32: multiple of the table's range that the velocity is from

    def part(self, at: int, count: int) -> TimedStates:
        """``count`` states from an index on."""
        return self.chosen(np.arange(at, min(at + count, len(self.states))))

    def chosen(self, places: Int64) -> TimedStates:
        """The states at some indices."""
        return TimedStates(*(getattr(self, entry.name)[places] for entry in fields(self)))


class ChipPlanner:
    """Calls ``fk_plan`` of an image with its own table. The image's debug information gives the structures'
    layout.

    Attributes:
        chip: the chip, booted and asleep.
        open_cycles: cycles of opening the table.
    """

    def __init__(self, elf: Path, cost: CostModel | None = None) -> None:
        """Boot an image and open its table.

        Raises:
            InputError: not an image for this chip.
            ChipError: it does not boot, or refuses its table.
        """
        self.chip = VirtualChip(elf, cost)
        self._uncounted: UncountedCalls | None = None
        self._types = Layouts(elf)
        for step in range(1, _BOOT_STEPS_MAX + 1):
            self.chip.run_until(step * _BOOT_STEP_US)
            if self.chip.sleeping:
                break
        self._free = self.chip.symbol("fk_bss_end") + 7 & ~7
        names = ("fk_tables_t", "fk_path_t", "fk_plan_config_t", "fk_state_t", "fk_plan_t")
        self._tables, self._path, self._config, self._state, self._plan = map(self.room, names)
        words = [self.chip.flash.word(self.chip.symbol(f"fk_table_image{end}")) for end in ("", "_bytes")]
        status, self.open_cycles = self.chip.call("fk_tables_open", *words, self._tables)
        if status != 0:
            raise ChipError(
                f"the image refuses its own table (fk_error_t {status - (1 << 32)}): build it again"
            )
        self._settings = np.zeros((), dtype=self._types["fk_plan_config_t"])

    def room(self, name: str, count: int = 1) -> int:
        """Address of unused RAM for ``count`` structures of a type."""
        address = self._free
        self._free += count * self._types[name].itemsize + 7 & ~7
        return address

    def configure(self, path: PathLike, config: PlanConfig) -> None:
        """Set path and configuration but the depth, which ``plan`` takes for each state."""
        rows = path_rows(path)
        value = np.zeros((), dtype=self._types["fk_path_t"])
        value["count"] = rows.shape[1]
        for member, row in zip(("x_m", "y_m", "tangent_rad"), rows, strict=True):
            value[member][: rows.shape[1]] = row
        self.chip.ram_write(self._path, value.tobytes())
        for member in self._settings.dtype.names or ():
            self._settings[member] = getattr(config, member)

    def wear(self, lost: Sequence[int]) -> None:
        """Plan for limbs that have lost these shares, 0 to 32767. Without wear curves nothing changes."""
        kind = np.dtype(self._types["fk_tables_t"])
        tables: AnyArray = np.frombuffer(self.chip.ram_read(self._tables, kind.itemsize), kind).copy()
        if tables["wear_knots"][0] == 0:
            return
        shares, shift = self._free, self._free + 2 * LIMBS_MAX
        self._free = shift + 12 * ACTIONS_MAX + 7 & ~7
        self.chip.ram_write(shares, np.resize(np.array(lost, dtype="<u2"), LIMBS_MAX).tobytes())
        self.chip.call("fk_wear_shift", self._tables, shares, shift)
        tables["worn"] = shift
        self.chip.ram_write(self._tables, tables.tobytes())

    def plan(
        self,
        states: Float32,
        depths: Int32,
        limb_use: UInt16 | None = None,
        along_points: Float32 | None = None,
        progress: Callable[[int], None] = lambda _done: None,
        counted: bool = True,
    ) -> tuple[AnyArray, Int64]:
        """Plan from many states.

        Args:
            states: (k, 6) float32.
            depths: (k,) depth of the search.
            limb_use: (k, 8) recent use of each limb; None: all rested.
            along_points: (k,) last place along the path, in points; None: its start.
            progress: called with the number of states done.
            counted: False: the same instructions, but without counting cycles: much faster.

        Returns:
            (k,) ``PLAN_ROW`` and (k,) cycles of 64 MHz; no cycles where they are not counted.
        """
        core: VirtualChip | UncountedCalls = self.chip
        if not counted:
            core = self._uncounted = self._uncounted or UncountedCalls(self.chip)
            core.ram_write(self._path, self.chip.ram_read(self._path, self._types["fk_path_t"].itemsize))
        asked = np.zeros(len(states), dtype=self._types["fk_state_t"])
        for member, column in zip(_POSE_MEMBERS, states.T, strict=True):
            asked[member] = column
        if limb_use is not None:
            asked["limb_use"] = limb_use
        if along_points is not None:
            asked["along_points"] = along_points
        plans = np.zeros(len(states), dtype=self._types["fk_plan_t"])
        status = np.zeros(len(states), dtype=np.uint32)
        cycles: list[int] = []
        pointers = (self._tables, self._path, self._config, self._state, self._plan)
        for index in range(len(states)):
            self._settings["depth"] = depths[index]
            core.ram_write(self._config, self._settings.tobytes())
            core.ram_write(self._state, asked[index].tobytes())
            if isinstance(core, VirtualChip):
                status[index], taken = core.call("fk_plan", *pointers)
                cycles.append(taken)
            else:
                status[index] = core.call("fk_plan", *pointers)
            if status[index] == 0:
                data = core.ram_read(self._plan, plans.itemsize)
                plans[index] = np.frombuffer(data, dtype=plans.dtype)[0]
            progress(index + 1)
        rows = np.zeros(len(states), dtype=PLAN_ROW)
        for name in PLAN_ROW.names or ():
            if name in (plans.dtype.names or ()) and name != "predicted":
                rows[name] = plans[name]
        rows["status"] = status.view(np.int32)
        for column, member in enumerate(_POSE_MEMBERS):
            rows["predicted"][:, column] = plans["predicted"][member]
        rows["predicted_limb_use"] = plans["predicted"]["limb_use"]
        return rows, np.array(cycles, dtype=np.int64)


def states_for_timing(tables: Tables, path: PathLike, count: int, rng: np.random.Generator) -> TimedStates:
    """Random states around a path, with velocities within the table's range and beyond."""
    rows = path_rows(path).astype(np.float64)
    scale = tables.velocity_scale.astype(np.float64)
    low, high = tables.states.min(axis=0) * scale, tables.states.max(axis=0) * scale
    far = np.resize(_BEYOND, count)
    states = np.empty((count, 6))
    near = rng.integers(0, rows.shape[1], count)
    reach = 0.2 * np.minimum(far, 30.0)
    for axis in (0, 1):
        states[:, axis] = rows[axis, near] + reach * rng.uniform(-1.0, 1.0, count)
    states[:, 2] = rng.uniform(-np.pi, np.pi, count)
    states[:, 3:] = rng.uniform(low, high, (count, 3)) * far[:, np.newaxis]
    limb_use = rng.integers(0, 32768, (count, LIMBS_MAX)).astype(np.uint16)
    limb_use[:, tables.limbs :] = 0
    limb_use[rng.random(count) < 0.25] = 0
    along = np.clip(near - rng.exponential(0.03 * rows.shape[1], count), 0, rows.shape[1] - 1)
    return TimedStates(states.astype(np.float32), limb_use, along.astype(np.float32), far.astype(np.float32))
