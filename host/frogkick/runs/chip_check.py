"""Firmware on trial: boots it, tries commands, strokes and limits, measures stack and computing time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from frogkick.link.frames import pack_frame
from frogkick.link.layout import Value, link_layout
from frogkick.paths import shape
from frogkick.pool.chip.image import load_image
from frogkick.pool.chip.stack import StackAnalysis
from frogkick.pool.chip.symbols import unwanted
from frogkick.pool.monitor import Pulse, pulses_of, violations
from frogkick.pool.virtual_robot import VirtualRobot
from frogkick.robot import Robot
from frogkick.runs.decision import LIMB_USE_FIELDS
from frogkick.runs.session import Session
from frogkick.tables.image import Tables

DEPTHS = (1, 2, 3, 4)
PULSE_TOLERANCE_S = 2e-6
PLAN_TIMEOUT_S = 30.0  # four levels of 32 actions take long


@dataclass
class ChipReport:
    """What the trial found.

    Attributes:
        checks: name -> passed.
        plan_ms, plan_cycles: computing time of one plan for each depth ("1" to "4") from the path's start, at
            the cycle model of the virtual chip.
        stack_bytes: deepest use of the painted stack.
        stack_bound_bytes: the most that any path through the machine code can use.
        stack_chain: the functions on that path, from reset on.
    """

    checks: dict[str, bool] = field(default_factory=dict)
    plan_ms: dict[str, float] = field(default_factory=dict)
    plan_cycles: dict[str, int] = field(default_factory=dict)
    stack_bytes: int = 0
    stack_bound_bytes: int = 0
    stack_chain: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Every check held."""
        return all(self.checks.values())


def check_on_chip(
    elf: Path,
    tables: Tables,
    robot: Robot,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> ChipReport:
    """Try a firmware image on the virtual chip.

    Args:
        elf: image of the target "bench".
        tables: what it should carry.
        robot: whose limits it should keep.
        progress: called with checks done and to do.

    Raises:
        LinkError: it does not answer.
        ChipError: it did what the chip does not allow.
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
        told = self.session.handshake(self.tables)
        self._check("says who it is", told["limbs"] == len(self.robot.limbs))

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
        self._check("START without a path is refused", self._start_without_path() == "NO_PATH")
        self._check(
            "a parameter out of limits is refused",
            self._status("PARAM", {"parameter": 1, "value": 9.0}) == "VALUE",
        )

    def _start_without_path(self) -> str:
        self.session.request("ARM")
        told = self._status("START", {"delay_us": 0})
        self.session.request("DISARM")
        return told

    def stroke(self) -> None:
        """An action with limbs in both groups: two pulses of the right length, one after the other."""
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
        mask = 0
        for pulse in pulses:
            mask |= 1 << pulse.limb
        self._check("the right limbs were on", mask == row.first_mask | row.second_mask)
        pulse_s = self.tables.pulse_us * 1e-6
        self._check(
            "pulses last as the table says",
            bool(pulses) and all(abs(p.end_s - p.start_s - pulse_s) <= PULSE_TOLERANCE_S for p in pulses),
        )
        # At once again: the limbs have not rested long enough, so the guard refuses.
        self._wait(0.0)
        refused = int(self.session.request("STATUS")["pulses_refused"])
        self.session.request("STROKE", {"action": action})
        self._wait(0.2)
        self.session.request("STROKE", {"action": action})
        self._wait(1.0)
        self._check(
            "the guard refuses a limb that has not rested",
            int(self.session.request("STATUS")["pulses_refused"]) > refused,
        )
        self._check("limits kept on the pins", not violations(self.robot, self._pulses()))

    def cut(self) -> None:
        self._wait(6.0)
        state = self.session.request("STATUS")["state"]
        self._check("an armed robot that hears nothing disarms", state == link_layout().state["DISARMED"])
        self.session.request("ARM")
        before = len(self._pulses())
        self.session.request("STROKE", {"action": self._any_first()})
        self._wait(0.02)
        self.session.request("DISARM")
        off_s = self.session.time_s
        self._wait(0.5)
        last = self._pulses()[before:]
        self._check("DISARM ends a pulse at once", bool(last) and all(p.end_s <= off_s for p in last))

    def _any_first(self) -> int:
        return next(i for i, row in enumerate(self.tables.actions) if row.first_mask)

    def plans(self) -> None:
        path = shape("ellipse")
        self.session.send_path(path)
        pose = {
            "x_m": float(path.x_m[0]),
            "y_m": float(path.y_m[0]),
            "heading_rad": float(path.tangent_rad[0]),
        }
        for depth in DEPTHS:
            begun = self.port.chip.busy_cycles
            self.session.request("STATUS")
            idle = self.port.chip.busy_cycles - begun
            begun = self.port.chip.busy_cycles
            values: dict[str, Value] = {
                "depth": depth,
                "vx_mps": 0.02,
                "vy_mps": 0.0,
                "omega_rad_s": 0.1,
                **dict.fromkeys(LIMB_USE_FIELDS, 0),
                "along_points": 0.0,
                **pose,
            }
            status = int(self.session.ask("PLAN", values, timeout_s=PLAN_TIMEOUT_S)["status"])
            cycles = self.port.chip.busy_cycles - begun - idle
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
