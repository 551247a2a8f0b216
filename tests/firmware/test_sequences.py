"""Random command sequences to the bench firmware on the virtual chip, and hangs: an onlooker judges pins."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from tests.conftest import count
from tests.core import onlooker
from tests.core.onlooker import SEEN, Limits, broken, judge
from tests.runs import rig

from frogkick.link.frames import Frame, hello, pack_frame, path_frames
from frogkick.link.layout import Value, link_layout
from frogkick.link.wire import BYTE_S
from frogkick.paths import shape
from frogkick.pool.chip.power import Timer
from frogkick.pool.virtual_robot import VirtualRobot

COMMANDS = 10
CYCLES = 64  # of the chip in a microsecond: the onlooker's clock
STATUS, FAULT = link_layout().status, link_layout().fault


class Stranger:
    """Sends a chip what it likes, and writes down what an onlooker sees of it, in cycles."""

    def __init__(self, seed: int) -> None:
        port = rig.port("virtual")
        assert isinstance(port, VirtualRobot)
        self.port, self.rng = port, np.random.default_rng(seed)
        self.time_s, self.sequence, self.fixes = 0.002, 0, 0
        self.sent: list[bytes] = []
        self.seen: list[tuple[float, int, int]] = [(0.0, onlooker.POWER_ON, 0)]
        self.clock_s = 0.0  # when the robot's clock was 0
        self.faults = self.resets = 0
        self.commands = 0

    def note(self, time_s: float, kind: int, value: int = 0) -> None:
        self.seen.append((time_s, kind, value))

    def rows(self) -> np.ndarray:
        """What was seen, in order of time."""
        ordered = sorted(enumerate(self.seen), key=lambda one: (self._when(one[1]), one[0]))
        return np.array(
            [(round(time_s * 1e6 * CYCLES), kind, value) for _, (time_s, kind, value) in ordered], dtype=SEEN
        )

    def _when(self, row: tuple[float, int, int]) -> float:
        # A fix is known from when it comes, not from its picture on: it stands behind what was seen before.
        return self._came.get(row, row[0])

    _came: dict[tuple[float, int, int], float]

    def live(self, for_s: float) -> list[Frame]:
        self.time_s = max(self.time_s + for_s, self.port.chip.time_us * 1e-6)
        self.port.advance(self.time_s)
        for edge in self.port.edges():
            self.note(edge.time_s, onlooker.HIGH if edge.level else onlooker.LOW, edge.limb)
        frames = self.port.frames()
        for time_s, frame in frames:
            if frame.kind == "event" and frame.name == "ENDED":
                self.note(time_s, onlooker.ENDED)
        while self.resets < len(self.port.chip.resets):
            self.note(self.port.chip.resets[self.resets] * 1e-6, onlooker.RESET)
            self.resets += 1
        return [frame for _, frame in frames]

    def ask(
        self, name: str, values: dict[str, Value] | None = None, rows: object = (), again: bytes = b""
    ) -> None:
        """Send a command, wait for its answer, note what an onlooker makes of both."""
        self.sequence = (self.sequence + 1) & 0xFF
        encoded = again or pack_frame(name, "command", self.sequence, values, rows)
        self.commands += 1
        if not again:
            self.sent.append(encoded)
            if name == "ARM":
                # With its last byte it has reached the robot, which may have disarmed itself meanwhile.
                self.note(self.time_s + len(encoded) * BYTE_S, onlooker.ARM)
        self.port.send(encoded, self.time_s)
        if self.rng.random() < 0.1:
            self.port.send(encoded, self.time_s)  # doubled by the radio
        for _ in range(200):
            for frame in self.live(0.001):
                if frame.kind == "answer" and (
                    again or (frame.name, frame.sequence) == (name, self.sequence)
                ):
                    if not again:
                        self.hear(frame)
                    return
        raise AssertionError(f"no answer to {name} at {self.time_s:.3f} s")

    def hear(self, frame: Frame) -> None:
        values, is_ok = frame.values, frame.values["status"] == 0
        if frame.name in ("DISARM", "STOP"):
            self.note(self.time_s, {"DISARM": onlooker.DISARM, "STOP": onlooker.STOP}[frame.name])
        elif frame.name == "START" and is_ok:
            # The run began before its answer; no pulse of it comes before its first decision.
            self.note(self.time_s, onlooker.STARTED)
        elif frame.name == "FIX" and is_ok:
            row = (self.clock_s + int(values["capture_us"]) * 1e-6, onlooker.FIX, 0)
            self._came[row] = self.time_s
            self.seen.append(row)
        elif frame.name == "STATUS":
            self.faults += int(values["fault"]) != FAULT["NONE"]

    def find_clock(self) -> None:
        """The robot's clock against the chip's, to the cycle: TIMER0 is that clock."""
        self.ask("HELLO", hello())
        (timer,) = (one for one in self.port.chip.peripherals if one.name == "TIMER0")
        assert isinstance(timer, Timer)
        self.clock_s = timer.zero_cycle / CYCLES * 1e-6
        before_s = self.time_s
        self.port.send(pack_frame("STATUS", "command", 200, {}), before_s)
        status = None
        while status is None:
            status = next((f for f in self.live(0.0005) if f.name == "STATUS" and f.kind == "answer"), None)
        assert before_s < self.clock_s + int(status.values["now_us"]) * 1e-6 < self.time_s

    def sequence_of_commands(self) -> None:
        rng = self.rng
        for _ in range(COMMANDS):
            self.live(float(rng.choice([0.0, 0.001, 0.03, 0.08, 0.16, 0.5])))
            choice = rng.random()
            if choice < 0.2:
                self.ask("ARM")
            elif choice < 0.5:
                self.ask("STROKE", {"action": int(rng.integers(0, len(rig.tables().actions) + 1))})
            elif choice < 0.6:
                self.ask("START", {"delay_us": int(rng.choice([0, 20_000, 300_000]))})
            elif choice < 0.8:
                self.fixes += 1
                path = shape("line")
                self.ask("FIX", {
                    "fix_sequence": self.fixes & 0xFFFF, "quality": 1,
                    "capture_age_us": int(rng.choice([0, 20_000, 300_000, 450_000])),
                    "x_m": float(path.x_m[5]), "y_m": float(path.y_m[5]) + float(rng.normal(0, 1e-4)),
                    "heading_rad": float(path.tangent_rad[5]),
                })  # fmt: skip
            elif choice < 0.85:
                self.ask("DISARM")
            elif choice < 0.9:
                self.ask("STOP")
            elif choice < 0.94 and self.sent:
                self.ask("again", again=self.sent[-1 - int(rng.integers(0, min(8, len(self.sent))))])
            else:
                self.ask("STATUS")

    def hang(self) -> None:
        """In the middle of whatever it does; a second later it has begun anew."""
        self.live(float(self.rng.uniform(0.0, 0.2)))
        self.port.chip.hang()
        self.live(1.1)
        self.sent.clear()
        self.begin()

    def begin(self) -> None:
        self.find_clock()
        path = shape("line")
        points = list(
            zip(map(float, path.x_m), map(float, path.y_m), map(float, path.tangent_rad), strict=True)
        )
        for values, rows in path_frames(points):
            self.ask("PATH", values, rows)
        self.ask("ARM")


@functools.cache
def run(sequences: int, seed: int) -> tuple[dict[str, int], Stranger]:
    """Play so many sequences to one chip, with a hang after some: what the onlooker counts."""
    stranger = Stranger(seed)
    stranger._came = {}
    stranger.live(0.1)
    stranger.begin()
    for number in range(sequences):
        stranger.sequence_of_commands()
        if number % 15 == 14:
            stranger.hang()
    stranger.live(0.2)
    limits = Limits.of(rig.robot())
    scaled = Limits(
        pulse=limits.pulse * CYCLES, rest=limits.rest * CYCLES, window=limits.window * CYCLES,
        on=limits.on * CYCLES, together=limits.together, fresh=limits.fresh * CYCLES,
        lost=limits.lost * CYCLES, late=0,
    )  # fmt: skip
    return judge(scaled, stranger.rows()), stranger


def test_no_sequence_breaks_a_limit_on_the_chip() -> None:
    sequences = count(60, 3000, 15)
    found, stranger = run(sequences, 1)
    print(f"{sequences} sequences, {stranger.commands} commands, {stranger.resets} resets: {found}")
    assert not broken(found), broken(found)
    assert stranger.faults == 0, "no pulse began later than the guard allows for"
    assert stranger.resets == sequences // 15
    assert found["pulses"] > sequences / 2 and found["pulses in a run"] > 0


@pytest.mark.parametrize("limit", ["rest", "pulse", "armed"])
def test_an_onlooker_with_stricter_limits_complains(limit: str) -> None:
    """The same run against limits that the robot does not keep to: the onlooker does see these pins."""
    _, stranger = run(15, 2)
    rows = stranger.rows()
    own = Limits.of(rig.robot())
    far = 10**9
    numbers = {"pulse": far, "rest": 0, "window": far, "on": far, "together": 8, "fresh": far, "lost": far}
    numbers = {name: value * CYCLES for name, value in numbers.items()} | {"together": 8, "late": 0}
    if limit == "rest":
        numbers["rest"] = 3 * own.rest * CYCLES
    elif limit == "pulse":
        numbers["pulse"] = 70_000 * CYCLES
    else:
        rows = rows[rows["kind"] != onlooker.ARM]
    assert set(broken(judge(Limits(**numbers), rows))) & {limit}
