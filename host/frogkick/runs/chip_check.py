"""Tests of a firmware image on the virtual chip: commands, strokes, limits, stack and computing time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from frogkick.link.frames import pack_frame
from frogkick.link.layout import Value, link_layout
from frogkick.paths import shape
from frogkick.pool.chip.image import load_image, unwanted
from frogkick.pool.chip.stack import StackAnalysis
from frogkick.pool.monitor import Pulse, pulses_of, violations
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot
from frogkick.runs.decision import LIMB_USE_FIELDS, STATE_FIELDS
from frogkick.runs.session import Session
from frogkick.tables.image import Tables

DEPTHS = (1, 2, 3, 4)
PULSE_TOLERANCE_S = 2e-6
PLAN_TIMEOUT_S = 30.0  # four levels of 32 actions take long


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
                self.report.plan_ms[str(depth)] = round(cycles / 64e3, 4)
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
