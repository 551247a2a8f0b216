"""Tests of a firmware image on the virtual chip: commands, strokes, limits, stack, planner, cycles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from frogkick.core.arrays import AnyArray, Float32, Int32, Int64, UInt16
from frogkick.link.frames import pack_frame
from frogkick.link.layout import Value, link_layout
from frogkick.paths import shape
from frogkick.planner.kernel import PLAN_ROW
from frogkick.planner.plan import PathLike, PlanConfig, path_rows
from frogkick.pool.chip import ChipError, CostModel, VirtualChip
from frogkick.pool.chip.image import Layouts, load_image, unwanted
from frogkick.pool.chip.stack import StackAnalysis
from frogkick.pool.chip.uncounted import UncountedCalls
from frogkick.pool.monitor import Pulse, pulses_of, violations
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot
from frogkick.runs.decision import LIMB_USE_FIELDS, STATE_FIELDS
from frogkick.runs.session import Session
from frogkick.tables.image import Tables
from frogkick.tables.layout import ACTIONS_MAX, LIMBS_MAX

DEPTHS = (1, 2, 3, 4)
PULSE_TOLERANCE_S = 2e-6
PLAN_TIMEOUT_S = 30.0  # four levels of 32 actions take long
CYCLES_PER_MS = 64_000


@dataclass
class ChipReport:
    """Result of the tests."""

    checks: dict[str, bool] = field(default_factory=dict)  # name -> passed
    # plan_ms, plan_cycles: computing time of a plan at the path's start for each depth ("1" to "4"), by the
    # cycle model of the virtual chip
    plan_ms: dict[str, float] = field(default_factory=dict)
    plan_cycles: dict[str, int] = field(default_factory=dict)
    stack_bytes: int = 0  # deepest use of the stack
    stack_bound_bytes: int = 0  # upper bound of it over all paths through the machine code
    stack_chain: tuple[str, ...] = ()  # functions on the path with that bound, from reset on

    @property
    def passed(self) -> bool:
        """Whether all checks passed."""
        return all(self.checks.values())


def check_on_chip(
    elf: Path,
    tables: Tables,
    robot: Robot,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> ChipReport:
    """Test a firmware image on the virtual chip.

    Args:
        elf: image of the target "bench", which should contain the tables and keep the robot's limits.
        progress: called with tests done and all tests.

    Raises:
        LinkError: the image does not answer.
        ChipError: the image does what the chip does not allow.
    """
    trial = _Trial(elf, tables, robot)
    steps = [trial.hello, trial.disarmed, trial.refusals, trial.stroke, trial.cut, trial.plans]
    steps += [trial.contents, trial.stack]
    for number, step in enumerate(steps, start=1):
        step()
        progress(number, len(steps))
    return trial.report


class _Trial:
    def __init__(self, elf: Path, tables: Tables, robot: Robot) -> None:
        self.elf = elf
        self.tables = tables
        self.robot = robot
        self.report = ChipReport()
        self.port = VirtualRobot(elf, len(robot.limbs), heat_known=False)
        self.session = Session(self.port)

    def _check(self, name: str, holds: bool) -> None:
        self.report.checks[name] = holds

    def _status(self, name: str, values: dict[str, Value] | None = None) -> str:
        return link_layout().status_name(int(self.session.ask(name, values)["status"]))

    def _pulses(self) -> list[Pulse]:
        return pulses_of(self.session.edges, self.session.time_s)

    def _wait(self, seconds: float) -> None:
        self.session.step(self.session.time_s + seconds)

    def hello(self) -> None:
        answer = self.session.handshake(self.tables)
        self._check("says who it is", answer["limbs"] == len(self.robot.limbs))

    def disarmed(self) -> None:
        status = self.session.request("STATUS")
        self._check("boots disarmed", status["state"] == link_layout().state["DISARMED"])
        self._check("no stroke while disarmed", self._status("STROKE", {"action": 0}) == "STATE")
        self._wait(0.3)
        self._check("no pulse while disarmed", not self.session.edges)

    def refusals(self) -> None:
        before = int(self.session.request("STATUS")["frames_bad"])
        damaged = bytearray(pack_frame("ARM", "command", 1))
        damaged[2] ^= 0x01 if damaged[2] != 0x01 else 0x02
        self.port.send(bytes(damaged), self.session.time_s)
        after = self.session.request("STATUS")
        self._check("a damaged frame is counted", int(after["frames_bad"]) == before + 1)
        self._check("a damaged frame does nothing", after["state"] == link_layout().state["DISARMED"])
        self.session.request("ARM")
        self._check("START without a path is refused", self._status("START", {"delay_us": 0}) == "NO_PATH")
        self.session.request("DISARM")
        out_of_limits = self._status("PARAM", {"parameter": 1, "value": 9.0})
        self._check("a parameter out of limits is refused", out_of_limits == "VALUE")

    def stroke(self) -> None:
        """An action with limbs in both groups gives two pulses of the right length in turn."""
        rows = [i for i, row in enumerate(self.tables.actions) if row.first_mask and row.second_mask]
        action = rows[0] if rows else 0
        row = self.tables.actions[action]
        self.session.request("ARM")
        self.session.request("STROKE", {"action": action})
        self._wait(self.robot.guard.rest_min_s)
        self._check("no pulse before limbs of unknown heat have rested", not self.session.edges)
        self.session.rest(lambda _line: None)
        self.session.request("ARM")
        self._check("a stroke is taken when armed", self._status("STROKE", {"action": action}) == "OK")
        self._wait(1.0)
        pulses = self._pulses()
        mask = sum(1 << limb for limb in {pulse.limb for pulse in pulses})
        self._check("the right limbs were on", mask == row.first_mask | row.second_mask)
        pulse_s = self.tables.pulse_us * 1e-6
        are_right = [abs(pulse.end_s - pulse.start_s - pulse_s) <= PULSE_TOLERANCE_S for pulse in pulses]
        self._check("pulses last as the table says", bool(pulses) and all(are_right))
        # A second stroke at once: the limbs have not rested long enough.
        self._wait(0.0)
        refused = int(self.session.request("STATUS")["pulses_refused"])
        self.session.request("STROKE", {"action": action})
        self._wait(0.2)
        self.session.request("STROKE", {"action": action})
        self._wait(1.0)
        refused_now = int(self.session.request("STATUS")["pulses_refused"])
        self._check("the guard refuses a limb that has not rested", refused_now > refused)
        self._check("limits kept on the pins", not violations(self.robot, self._pulses()))

    def cut(self) -> None:
        self._wait(6.0)
        state = self.session.request("STATUS")["state"]
        self._check("an armed robot that hears nothing disarms", state == link_layout().state["DISARMED"])
        self.session.request("ARM")
        before = len(self._pulses())
        action = next(index for index, row in enumerate(self.tables.actions) if row.first_mask)
        self.session.request("STROKE", {"action": action})
        self._wait(0.02)
        self.session.request("DISARM")
        off_s = self.session.time_s
        self._wait(0.5)
        last = self._pulses()[before:]
        self._check("DISARM ends a pulse at once", bool(last) and all(p.end_s <= off_s for p in last))

    def plans(self) -> None:
        path = shape("ellipse")
        self.session.send_path(path)
        state = (float(path.x_m[0]), float(path.y_m[0]), float(path.tangent_rad[0]), 0.02, 0.0, 0.1)
        values: dict[str, Value] = {
            **dict(zip(STATE_FIELDS, state, strict=True)),
            **dict.fromkeys(LIMB_USE_FIELDS, 0),
            "along_points": 0.0,
        }
        for depth in DEPTHS:
            before = self.port.chip.busy_cycles
            self.session.request("STATUS")
            between = self.port.chip.busy_cycles
            answer = self.session.ask("PLAN", {**values, "depth": depth}, timeout_s=PLAN_TIMEOUT_S)
            cycles = self.port.chip.busy_cycles - between - (between - before)
            status = int(answer["status"])
            if status == 0:
                self.report.plan_cycles[str(depth)] = cycles
                self.report.plan_ms[str(depth)] = round(cycles / CYCLES_PER_MS, 4)
        self._check("plans at every depth", len(self.report.plan_ms) == len(DEPTHS))

    def contents(self) -> None:
        found = unwanted(load_image(self.elf).symbols)
        self._check("no 64-bit division, soft float, double, libm or heap", not found)

    def stack(self) -> None:
        self.report.stack_bytes = self.port.chip.stack_high_water_bytes()
        bound = StackAnalysis(self.elf).bound()
        self.report.stack_bound_bytes = bound.total_bytes
        self.report.stack_chain = tuple(name for name, _ in bound.chain)
        self._check("stack within its bound", 0 < self.report.stack_bytes <= bound.total_bytes)
        self._check(
            "bound of the stack within its reserve", bound.total_bytes <= self.port.chip.stack_reserved_bytes
        )


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
        self._tables, self._path, self._config, self._state, self._plan = map(self._room, names)
        words = [self.chip.flash.word(self.chip.symbol(f"fk_table_image{end}")) for end in ("", "_bytes")]
        status, self.open_cycles = self.chip.call("fk_tables_open", *words, self._tables)
        if status != 0:
            raise ChipError(
                f"the image refuses its own table (fk_error_t {status - (1 << 32)}): build it again"
            )
        self._settings = np.zeros((), dtype=self._types["fk_plan_config_t"])

    def _room(self, name: str) -> int:
        """Address of unused RAM for a structure."""
        address = self._free
        self._free += self._types[name].itemsize + 7 & ~7
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
